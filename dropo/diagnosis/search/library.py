"""Every effect that a problem's robot may have, but for those that its declared parameters already
are.
"""

import copy
from collections.abc import Sequence

import numpy as np

from dropo.core.contracts.effect import EffectInstance, instances_of
from dropo.core.contracts.problem import Problem
from dropo.core.records.trajectories import Ints
from dropo.core.services.errors import BadArgument, Incompatible
from dropo.core.services.registry import names
from dropo.mjmodel.robot_simulator import RobotSimulator


def instances_for(
    problem: Problem, effects: Sequence[str] | None = None, free: Ints | None = None
) -> list[EffectInstance]:
    """The atoms of the named effects, of all where None is named.

    "joint_damping:elbow" names one at one place.

    free: the places of the declared parameters that are fitted; None: all.

    Raises UnknownName for an effect or a place that does not exist, with the nearest valid one.
    """
    simulator = robot_of(problem)
    wanted = (
        [text.partition(":") for text in effects]
        if effects is not None
        else [(name, "", "") for name in names("effects")]
    )
    found: list[EffectInstance] = []
    for name, _, place in wanted:
        every = instances_of(simulator.effect_context, name, place)
        found += [instance for instance in every if not declared(simulator, instance, free)]
    if not found:
        raise BadArgument(
            "No effect is left to look for: all that were named are declared as parameters."
        )
    return found


def robot_of(problem: Problem) -> RobotSimulator:
    """The problem's simulator; Incompatible where it has no model that effects can be added to."""
    simulator = problem.simulator
    if not isinstance(simulator, RobotSimulator):
        raise Incompatible(
            f"{type(simulator).__name__} offers no effects. A diagnosis needs a MuJoCo model."
        )
    return simulator


def declared(simulator: RobotSimulator, instance: EffectInstance, free: Ints | None = None) -> bool:
    """Whether the atom is declared, or changes a number of the model that a declared parameter (one
    of `free`) stands for, at that place alone.
    """
    if instance.label in {own.label for own in simulator.effects}:
        return True
    bindings = [
        binding for i, binding in enumerate(simulator.bindings) if free is None or i in free
    ]
    if instance.model is None or instance.target is None or not bindings:
        return False
    changed = copy.copy(simulator.model)
    instance.model(changed, np.array(instance.trials[0][0]))
    return any(
        not np.array_equal(binding.read(changed), binding.read(simulator.model))
        for binding in bindings
    )
