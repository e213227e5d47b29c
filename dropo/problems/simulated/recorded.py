"""Problems on data that the simulated machines record: all masses are to be found."""

from dropo.core.contracts.problem import Problem
from dropo.problems.simulated.hidden import hide

SEED = 61


def half_cheetah(threads: int = 0) -> Problem:
    """The masses of Gymnasium's half-cheetah, from 30 runs under random commands."""
    return _recorded("half-cheetah", threads)


def walker2d(threads: int = 0) -> Problem:
    """The masses of Gymnasium's walker, from 44 runs in a closed loop that end where it falls."""
    return _recorded("walker2d", threads)


def torque_arm(threads: int = 0) -> Problem:
    """The masses of an arm with two hinges and torque motors, from 26 runs in a closed loop."""
    return _recorded("torque-arm", threads)


def position_arm(threads: int = 0) -> Problem:
    """The masses of an arm with three hinges and position servos, from 26 runs."""
    return _recorded("position-arm", threads)


def _recorded(name: str, threads: int) -> Problem:
    return hide(name, (), seed=SEED, threads=threads)
