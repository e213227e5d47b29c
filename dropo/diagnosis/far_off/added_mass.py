"""Mass that a body carries, in the place of what does nearly the same."""

import numpy as np

from dropo.core.contracts.effect import EffectInstance, instances_of
from dropo.core.services.validation import Array
from dropo.diagnosis.far_off.model import GAIN, PAYLOAD, FarOffModel, reaching
from dropo.diagnosis.search.bounds import totals_of
from dropo.diagnosis.search.library import declared, robot_of
from dropo.mjmodel.bodies import mass_centre, moving_bodies, moving_mass
from dropo.mjmodel.joints import joints

OF_ADDED_MASS = (PAYLOAD, "body_mass", "body_com", "body_inertia")
"""Effects of mass that is added to a body: the mass itself, then where it is."""
SPRING = "joint_stiffness"
"""The effect whose torque is that of a weight, where a joint moves little."""


def as_payloads(model: FarOffModel) -> FarOffModel:
    """Let bodies that are heavier carry a point mass whose place is to be found.

    How far it is from the joint decides what else a rotor has. Bodies whose centre of mass moves
    stay as they are.

    Parameters
    ----------
    model : FarOffModel
        Any.

    Returns
    -------
    FarOffModel
        Each mass is at its body's centre. The same object where there is nothing to exchange.
    """
    for instance, sizes in model.numbers:
        if instance.effect != "body_mass" or not sizes[0] > 0:
            continue
        of_body = [one for one, _ in model.numbers if one.target == instance.target]
        same = {one.label: one.effect for one in of_body if one.effect in OF_ADDED_MASS}
        carried = _at_centre(model, str(instance.target), float(sizes[0]))
        if carried is not None and set(same.values()) <= {"body_mass", "body_inertia"}:
            model = model.without(list(same)).with_numbers([carried])
    return model


def for_gain(model: FarOffModel) -> FarOffModel | None:
    """Put a payload in the place of a drive's gain, where the motions of both are alike.

    A weak drive of a single link is to its motions as a heavy link: all forces of its joint grow
    as the drive's own does.

    Parameters
    ----------
    model : FarOffModel
        Any.

    Returns
    -------
    FarOffModel or None
        With the drive as the model came, a payload at the link's centre, and all else of its joint
        larger to suit. None where there are more links, or a mass is added already, or the drive is
        no weaker.
    """
    robot = robot_of(model.problem).model
    links = [name for _, name in moving_bodies(robot)]
    gains = [float(sizes[0]) for one, sizes in model.numbers if one.effect == GAIN]
    if len(links) != 1 or _masses(model) or len(gains) != 1 or not -1 < gains[0] < 0:
        return None
    factor = 1 / (1 + gains[0])
    carried = _at_centre(model, links[0], (factor - 1) * moving_mass(robot))
    if carried is None:
        return None
    effects = [instance for instance, _ in model.numbers]
    grown = model.theta + (factor - 1) * totals_of(model.library, model.theta, effects)
    numbers = []
    for instance, sizes in model.numbers:
        of_forces = all(one.base is not None for one in instance.quantities)
        own = grown[model.library.indices_of[instance.label]] if of_forces else sizes
        own = np.zeros(1) if instance.effect == GAIN else own
        numbers.append((reaching(instance, own), own))
    kept = model.without([instance.label for instance, _ in model.numbers])
    return kept.with_numbers([*numbers, carried])


def is_mass_for_gain(model: FarOffModel, fewer: FarOffModel, left_out: str, made_up: float) -> bool:
    """Tell whether a kind of effects that was left out is of added mass, and a drive's gain makes
    up for it.

    Parameters
    ----------
    model, fewer : FarOffModel
        With and without the effects.
    left_out : str
        Their name.
    made_up : float
        By how much more a gain differs from the model's where it makes up for a mass.

    Returns
    -------
    bool
    """
    if left_out not in OF_ADDED_MASS or not any(sizes[0] > 0 for sizes in _masses(model)):
        return False
    before = {one.label: sizes for one, sizes in model.numbers if one.effect == GAIN}
    after = {one.label: sizes for one, sizes in fewer.numbers if one.effect == GAIN}
    moved = [(np.abs(after[label]) - np.abs(sizes)).max() for label, sizes in before.items()]
    return bool(max(moved, default=0.0) > made_up)


def for_payload(model: FarOffModel, errors: Array, certain: float) -> FarOffModel | None:
    """Put springs in the place of a payload whose mass motions do not tell.

    Where a joint moves little, the weight of what it carries is a spring; its inertia a rotor takes
    back.

    Parameters
    ----------
    model : FarOffModel
        Any.
    errors : (m,) array
        Standard errors of its numbers.
    certain : float
        Number of standard errors from which a mass is told.

    Returns
    -------
    FarOffModel or None
        With a spring of nothing in each joint of the body. None where every payload's mass is told,
        or the body has no joint that may have one more spring.
    """
    simulator = robot_of(model.problem)
    bodies = {name: body for body, name in moving_bodies(simulator.model)}
    labels = {one.label for one, _ in model.numbers}
    for instance, sizes in model.numbers:
        mass = errors[model.library.indices_of[instance.label][0]]
        if instance.effect != PAYLOAD or abs(sizes[0]) > certain * mass:
            continue
        body = bodies[str(instance.target)]
        own = {one.name for one in joints(simulator.model) if one.body == body}
        springs = [
            (one, np.zeros(1))
            for one in instances_of(simulator.effect_context, SPRING)
            if one.target in own and not one.variant and one.label not in labels
            if not declared(simulator, one, model.free)
        ]
        if springs:
            return model.without([instance.label]).with_numbers(springs)
    return None


def _masses(model: FarOffModel) -> list[Array]:
    """The sizes of a model's effects that add mass, the mass first."""
    return [sizes for one, sizes in model.numbers if one.effect in OF_ADDED_MASS[:2]]


def _at_centre(model: FarOffModel, body: str, mass: float) -> tuple[EffectInstance, Array] | None:
    """A payload [kg] at the centre of a body, where it may be anywhere."""
    simulator = robot_of(model.problem)
    bodies = {name: body for body, name in moving_bodies(simulator.model)}
    for instance in instances_of(simulator.effect_context, PAYLOAD):
        if instance.target != body or instance.variant:
            continue
        if declared(simulator, instance, model.free):
            continue
        high = np.array([one.high for one in instance.quantities[1:]])
        centre = np.clip(mass_centre(simulator.model, bodies[body]), -high, high)
        sizes = np.array([mass, *centre])
        return reaching(instance, sizes), sizes
    return None
