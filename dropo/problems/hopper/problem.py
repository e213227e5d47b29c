"""The hopper of the thesis, with data simulated here: four link masses to be found (section 6.2)."""

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
    """Means in [0.5, 2] x truth (section 6.2.1); the masses alone change, inertias and derived
    constants stay, as in the thesis.
    """
    masses = [
        FieldParameter(
            f"{body}_mass",
            TRUTH[f"{body}_mass"] / 2,
            2 * TRUTH[f"{body}_mass"],
            "kg",
            field="body_mass",
            element=body,
            derived=False,
        )
        for body in BODIES
    ]
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
    """The thesis' fit of the four masses to hopper transitions."""
    truth = {parameter: TRUTH[parameter] for parameter in TRUTH}
    return Problem(
        name,
        hopper_simulator(threads),
        data,
        epsilon=epsilon,
        truth=truth,
        everything=everything,
        task=hopping(),
    )


def hopper(threads: int = 0) -> Problem:
    """Four masses of the hopper from 1000 simulated transitions without noise (thesis, table 6.1)."""
    data, _ = simulate(500, 2, rng=np.random.default_rng(61))
    return hopper_problem("hopper", data, 1e-8, threads)


def hopper_noisy(threads: int = 0) -> Problem:
    """The same with Gaussian noise of variance 1e-5 on the next observations (thesis, table 6.1)."""
    data, _ = simulate(500, 2, rng=np.random.default_rng(61), noise_variance=NOISE)
    return hopper_problem("hopper-noisy", data, NOISE, threads)
