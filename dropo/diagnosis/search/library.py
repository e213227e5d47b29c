"""Every effect that a problem's robot may have, but for those that its declared parameters already
are.
"""

import copy
from collections.abc import Sequence
from typing import Any

import numpy as np

from dropo.core.contracts.effect import EffectInstance, instances_of
from dropo.core.contracts.problem import Problem
from dropo.core.contracts.simulator import Simulator
from dropo.core.records.trajectories import Ints
from dropo.core.services.errors import BadArgument, Incompatible
from dropo.core.services.registry import names


def instances_for(
    problem: Problem, effects: Sequence[str] | None = None, free: Ints | None = None
) -> list[EffectInstance]:
    """The atoms of the named effects, of all where None is named.

    "joint_damping:elbow" names one at one place.

    free: the places of the declared parameters that are fitted; None: all.

    Raises UnknownName for an effect or a place that does not exist, with the nearest valid one.
    """
    robot = getattr(problem.simulator, "effect_context", None)
    if robot is None:
        raise Incompatible(
            f"{type(problem.simulator).__name__} offers no effects. A diagnosis needs a "
            "MuJoCo model."
        )
    wanted = (
        [text.partition(":") for text in effects]
        if effects is not None
        else [(name, "", "") for name in names("effects")]
    )
    found: list[EffectInstance] = []
    for name, _, place in wanted:
        found += [
            instance
            for instance in instances_of(robot, name, place)
            if not declared(problem.simulator, instance, free)
        ]
    if not found:
        raise BadArgument(
            "No effect is left to look for: all that were named are declared as parameters."
        )
    return found


def declared(simulator: Simulator, instance: EffectInstance, free: Ints | None = None) -> bool:
    """Whether the atom is declared, or changes a number of the model that a declared parameter (one
    of `free`) stands for, at that place alone.
    """
    if instance.label in {own.label for own in getattr(simulator, "effects", ())}:
        return True
    bindings = [
        binding
        for i, binding in enumerate(getattr(simulator, "bindings", ()))
        if free is None or i in free
    ]
    if instance.model is None or instance.target is None or not bindings:
        return False
    changed = copy.copy(simulator.model)  # type: ignore[attr-defined]
    instance.model(changed, np.array(instance.trials[0][0]))
    return any(
        not np.array_equal(binding.read(changed), binding.read(simulator.model))
        for binding in bindings
    )  # type: ignore[attr-defined]


def command_names(simulator: Any) -> list[str]:
    """The name of each action column: its actuator's, else that of the joint that this one drives."""
    model = simulator.model
    given = [
        (model.actuator(int(i)).name, model.joint(int(model.actuator_trnid[i, 0])).name, int(i))
        for i in simulator.controls
    ]
    return [str(name or joint or f"actuator {i}") for name, joint, i in given]
