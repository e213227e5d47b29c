"""Which of several logged commands drives a machine, judged with a model that may lose what drives
lose.
"""

from collections.abc import Mapping

import numpy as np

from dropo.core.contracts.problem import Problem
from dropo.core.services.registry import find
from dropo.data.outliers.input_choice import InputChoice, choose_input
from dropo.diagnosis.search.library import declared, robot_of

LOSSES = ("joint_friction", "joint_armature")
"""What a torque on a joint is spent on before the link feels it: a first model lacks it, and would
trust the wrong one.
"""
SECONDS = 0.1  # of a window, where the problem states no horizon


def choose_problem_input(problems: Mapping[str, Problem]) -> InputChoice:
    """The best of one problem under each of several commands, by name; dry friction and rotor
    inertia of every joint are fitted too.
    """
    first = next(iter(problems.values()))
    simulator = robot_of(first)
    losses = [
        instance for name in LOSSES for instance in find("effects", name)(simulator.effect_context)
    ]
    simulator = simulator.with_effects(
        [
            instance
            for instance in losses
            if instance.target is not None and not declared(simulator, instance)
        ]
    )
    start = np.clip(simulator.nominal, simulator.space.low, simulator.space.high)
    seconds = max(SECONDS, first.length * simulator.control_step)
    data = {name: problem.trajectories for name, problem in problems.items()}
    return choose_input(simulator, data, start, simulator.control_step, seconds=seconds)
