"""Which of several logged commands drives a machine, with a model that may have motor losses."""

from collections.abc import Mapping

from dropo.core.contracts.effect import instances_of
from dropo.core.contracts.problem import Problem
from dropo.data.outliers.input_choice import InputChoice, choose_input
from dropo.diagnosis.search.library import declared, robot_of

LOSSES = ("joint_friction", "joint_armature")
"""What a joint's torque is spent on before the link feels it: without these, a first model may not
tell commands apart."""


def choose_problem_input(
    problems: Mapping[str, Problem], minimum_seconds: float = 0.1
) -> InputChoice:
    """Choose between one problem's logged commands.

    Dry friction and rotor inertia of every joint are fitted too.

    Parameters
    ----------
    problems : mapping of str to Problem
        One problem under each of several commands, by the command's name.
    minimum_seconds : float
        Horizon of the windows where the problem states a shorter one, or none [s].

    Returns
    -------
    InputChoice
        The commands, best first.

    Raises
    ------
    Incompatible
        If the simulator has no MuJoCo model.
    BadArgument
        If there are fewer than two commands, or their measurements differ.
    """
    first = next(iter(problems.values()))
    simulator = robot_of(first)
    losses = []
    for name in LOSSES:
        for instance in instances_of(simulator.effect_context, name):
            if instance.target is not None and not declared(simulator, instance):
                losses.append(instance)
    simulator = simulator.with_effects(losses)
    space = simulator.space
    start = space.clip(simulator.nominal)
    step = simulator.control_step
    seconds = max(minimum_seconds, first.horizon * step)
    data = {name: problem.trajectories for name, problem in problems.items()}
    return choose_input(simulator, data, start, step, seconds=seconds)
