"""Problems on data that simulated robots record: the masses of all bodies are to be found."""

from dropo.core.contracts.problem import Problem
from dropo.problems.simulated.hidden import hide

SEED = 61  # of all recordings


def half_cheetah(threads: int = 0) -> Problem:
    """The masses of Gymnasium's half-cheetah, from 30 runs under random commands.

    Parameters
    ----------
    threads : int
        Threads of the simulator; 0 for all cores.

    Returns
    -------
    Problem
    """
    return _recorded("half-cheetah", threads)


def walker2d(threads: int = 0) -> Problem:
    """The masses of Gymnasium's walker, from 44 runs in a closed loop that end where it falls.

    Parameters
    ----------
    threads : int
        Threads of the simulator; 0 for all cores.

    Returns
    -------
    Problem
    """
    return _recorded("walker2d", threads)


def torque_arm(threads: int = 0) -> Problem:
    """The masses of an arm with two hinges and torque motors, from 26 runs in a closed loop.

    Parameters
    ----------
    threads : int
        Threads of the simulator; 0 for all cores.

    Returns
    -------
    Problem
    """
    return _recorded("torque-arm", threads)


def position_arm(threads: int = 0) -> Problem:
    """The masses of an arm with three hinges and position servos, from 26 runs.

    Parameters
    ----------
    threads : int
        Threads of the simulator; 0 for all cores.

    Returns
    -------
    Problem
    """
    return _recorded("position-arm", threads)


def _recorded(name: str, threads: int) -> Problem:
    """The problem on a recording without hidden effects."""
    return hide(name, (), seed=SEED, threads=threads)
