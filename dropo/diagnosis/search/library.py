"""The effects that a problem's robot may have, but for those that are declared parameters."""

import copy
from collections.abc import Sequence
from types import MappingProxyType

import numpy as np

from dropo.core.contracts.effect import EffectInstance, instances_of
from dropo.core.contracts.problem import Problem
from dropo.core.records.trajectories import Ints
from dropo.core.services.errors import BadArgument, Incompatible
from dropo.core.services.registry import names, plugin_names
from dropo.core.services.validation import Array
from dropo.effects.law import law_of_text
from dropo.mjmodel.robot_simulator import RobotSimulator
from dropo.mjmodel.standing import refuse_unknown_base

LAW = "law"
"""The effect that a formula makes."""
PARTNERS = MappingProxyType({"actuator_delay": "actuator_lag", "actuator_lag": "actuator_delay"})
"""Effects that often come together at one place, with numbers of one kind that share what either
alone stands for: a motor's late force is dead time and lag.
"""


def partner_of(
    instance: EffectInstance, instances: Sequence[EffectInstance]
) -> EffectInstance | None:
    """Return the effect that often comes with another at its place.

    Parameters
    ----------
    instance : EffectInstance
        The other.
    instances : sequence of EffectInstance
        Those that are looked for.

    Returns
    -------
    EffectInstance or None
        None where there is no such effect, or it is not looked for.
    """
    wanted = (PARTNERS.get(instance.effect), instance.target)
    return next((one for one in instances if (one.effect, one.target) == wanted), None)


def instances_for(
    problem: Problem, effects: Sequence[str] | None = None, free: Ints | None = None
) -> list[EffectInstance]:
    """Return the effects to look for in a problem.

    Parameters
    ----------
    problem : Problem
        With a MuJoCo model.
    effects : sequence of str, optional
        Names of effects; "joint_damping:elbow" names one at one place. If None, all.
    free : int array, optional
        Indices of the declared parameters that are fitted; all if None.

    Returns
    -------
    list of EffectInstance
        Each effect at each of its places.

    Raises
    ------
    UnknownName
        If an effect or a place does not exist; the message has the nearest valid one.
    BadArgument
        If all effects that were named are declared as parameters, or of signals that were
        estimated.
    Incompatible
        If the simulator has no model that effects can be added to.
    """
    simulator = robot_of(problem)
    wanted = effects
    if wanted is None:
        wanted = names("effects")
    found: list[EffectInstance] = []
    for text in wanted:
        name, _, place = text.partition(":")
        if name == LAW:
            # Without a formula, one is looked for in what remains.
            found += [law_of_text(simulator.effect_context, place)] if place else []
            continue
        for instance in instances_of(simulator.effect_context, name, place):
            if declared(simulator, instance, free):
                continue
            if place or not of_an_estimate(problem, instance):
                found.append(instance)
    if not found and LAW not in wanted:
        raise BadArgument(
            "No effect is left to look for: all that were named are declared as parameters, or of"
            " sensors whose signals were estimated, not measured."
        )
    return found


def plugin_effects(simulator: RobotSimulator) -> list[str]:
    """List the effects of plug-ins that a robot could have and does not have.

    Parameters
    ----------
    simulator : RobotSimulator
        The robot, with the effects that it has.

    Returns
    -------
    list of str
        Their names, sorted.
    """
    fixed = [instance for instance, _ in simulator.fixed]
    own = {instance.effect for instance in (*simulator.effects, *fixed)}
    return [
        name
        for name in plugin_names("effects")
        if name not in own and instances_of(simulator.effect_context, name)
    ]


def of_an_estimate(problem: Problem, instance: EffectInstance) -> bool:
    """Decide whether an effect is of the sensor of a signal that no sensor measured.

    The errors of an estimate are its estimator's: motion within a control step that it cannot see
    looks like a sensor's gain or delay.

    Parameters
    ----------
    problem : Problem
        Whose signals they are.
    instance : EffectInstance
        The effect, or one that changes with time.

    Returns
    -------
    bool
    """
    _, _, place = str(instance.target).rpartition(":")
    return place in problem.estimated


def robot_of(problem: Problem) -> RobotSimulator:
    """Return a problem's simulator, which effects can be added to.

    Parameters
    ----------
    problem : Problem
        Any.

    Returns
    -------
    RobotSimulator

    Raises
    ------
    Incompatible
        If the simulator has no model that effects can be added to, or the data lack the pose of a
        base that touches something.
    """
    simulator = problem.simulator
    if not isinstance(simulator, RobotSimulator):
        raise Incompatible(
            f"{type(simulator).__name__} offers no effects. A diagnosis needs a MuJoCo model."
        )
    refuse_unknown_base(simulator.model, simulator.layout.observed("qpos"))
    return simulator


def declared(simulator: RobotSimulator, instance: EffectInstance, free: Ints | None = None) -> bool:
    """Decide whether an effect is declared already.

    Parameters
    ----------
    simulator : RobotSimulator
        With its declared parameters and effects.
    instance : EffectInstance
        The effect.
    free : int array, optional
        Indices of the declared parameters that are fitted; all if None.

    Returns
    -------
    bool
        Whether the effect itself is declared, or changes a number of the model, at its one place,
        that a fitted parameter stands for.
    """
    if instance.label in {own.label for own in simulator.effects}:
        return True
    if instance.target is None:
        return False
    changed = changed_parameters(simulator, instance, np.array(instance.trials[0][0]))
    return any(free is None or i in free for i in changed)


def changed_parameters(
    simulator: RobotSimulator, instance: EffectInstance, sizes: Array
) -> dict[int, float]:
    """Return the declared parameters that stand for what an effect does.

    Parameters
    ----------
    simulator : RobotSimulator
        With its declared parameters and effects.
    instance : EffectInstance
        The effect.
    sizes : (q,) array
        Its magnitudes.

    Returns
    -------
    dict of int to float
        Their values with the effect, by index.
    """
    names = simulator.space.names
    found = {}
    for parameter, size in zip(instance.parameters, sizes.tolist(), strict=True):
        if parameter.name in names:
            found[names.index(parameter.name)] = size
    if instance.model is None or not simulator.bindings:
        return found
    changed = copy.copy(simulator.simulated)
    instance.model(changed, sizes)
    for i, binding in enumerate(simulator.bindings):
        before = binding.read(simulator.model)
        after = binding.read(changed)
        if not np.array_equal(after, before):
            found[i] = float(np.mean(after / (before if binding.parameter.relative else 1.0)))
    return found
