"""The hopper of the thesis with data simulated here: four link masses to be found (section 6.2)."""

import numpy as np

from dropo.core.contracts.problem import Problem
from dropo.core.records.trajectories import Trajectories
from dropo.mjmodel.fields import FieldParameter
from dropo.problems.hopper.data import simulate
from dropo.problems.hopper.model import BODIES, FRAME_SKIP, TRUTH, hopper_spec
from dropo.problems.hopper.task import hopping
from dropo.simulators.mujoco.simulator import MujocoSimulator

NOISE = 1e-5  # variance of the noisy sets, in each signal's unit squared


def hopper_simulator(threads: int = 0) -> MujocoSimulator:
    """The hopper's simulator, whose four parameters are the masses of its links.

    As in the thesis (section 6.2.1), means are searched in 0.5 to 2 times the truth, and the masses
    alone change: inertias and derived constants stay.

    Parameters
    ----------
    threads : int
        Threads of the simulator; 0 for all cores.

    Returns
    -------
    MujocoSimulator
        Whose observations are those of Gymnasium's hopper, without clipping.
    """
    masses = []
    for body in BODIES:
        name = f"{body}_mass"
        low = TRUTH[name] / 2
        high = 2 * TRUTH[name]
        masses.append(
            FieldParameter(name, low, high, "kg", field="body_mass", element=body, derived=False)
        )
    return MujocoSimulator(
        hopper_spec(),
        masses,
        observation=["qpos[1:]", "qvel"],
        frame_skip=FRAME_SKIP,
        threads=threads,
    )


def hopper_problem(
    name: str,
    data: Trajectories,
    epsilon: float,
    threads: int = 0,
    everything: Trajectories | None = None,
) -> Problem:
    """The thesis' fit of the four masses to hopper transitions.

    Parameters
    ----------
    name : str
        Name of the problem.
    data : Trajectories
        Transitions to be fitted, with 11 observed signals and 3 commands.
    epsilon : float
        Variance of the noise on each signal, in its unit squared.
    threads : int
        Threads of the simulator; 0 for all cores.
    everything : Trajectories or None
        All transitions, where `data` are only the first of them.

    Returns
    -------
    Problem
        With the true masses and the task of hopping.
    """
    return Problem(
        name,
        hopper_simulator(threads),
        data,
        epsilon=epsilon,
        truth=dict(TRUTH),
        everything=everything,
        task=hopping(),
    )


def hopper(threads: int = 0) -> Problem:
    """Four masses of the hopper from 1000 simulated transitions without noise (table 6.1).

    Parameters
    ----------
    threads : int
        Threads of the simulator; 0 for all cores.

    Returns
    -------
    Problem
        With 1000 transitions.
    """
    data, _ = simulate(500, 2, rng=np.random.default_rng(61))
    return hopper_problem("hopper", data, 1e-8, threads)


def hopper_noisy(threads: int = 0) -> Problem:
    """`hopper` with Gaussian noise of variance 1e-5 on the next observations (table 6.1).

    Parameters
    ----------
    threads : int
        Threads of the simulator; 0 for all cores.

    Returns
    -------
    Problem
        With 1000 transitions.
    """
    data, _ = simulate(500, 2, rng=np.random.default_rng(61), noise_variance=NOISE)
    return hopper_problem("hopper-noisy", data, NOISE, threads)
