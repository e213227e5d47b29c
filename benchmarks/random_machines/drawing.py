"""Random machines with their logs, as a problem of the model that lacks what they have."""

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
from design import STEP, random_design
from hidden import random_machine
from logs import Lost, random_log
from worth import worth

from dropo.core.contracts.problem import Problem
from dropo.simulators.mujoco.simulator import MujocoSimulator

Place = tuple[str, str | None]
Numbers = dict[Place, float]
Told = Callable[[Sequence[Place]], Numbers]
"""What a log says of each of some things that are missing [nats]."""


def drawn(seed: int) -> tuple[Problem, str, Numbers, Told]:
    """Draw machines until one can be moved.

    Parameters
    ----------
    seed : int
        Decides everything.

    Returns
    -------
    problem : Problem
        Positions alone.
    drives : str
        Their kind.
    truth : dict
        By effect and place the size of what is missing.
    told : function
        What the log says of what is asked for [nats].
    """
    rng = np.random.default_rng(seed)
    while True:
        design = random_design(rng)
        machine = random_machine(design, rng)
        try:
            log = random_log(design, machine, rng)
        except Lost:
            continue
        simulator = MujocoSimulator(
            design.spec, [], observation=["qpos"], frame_skip=round(log.control / STEP), threads=1
        )
        problem = Problem(f"machine-{seed}", simulator, log.trajectories)
        return problem, design.drives, machine.truth, partial(worth, design, machine, log)
