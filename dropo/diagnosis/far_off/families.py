"""Effects of one kind at every joint or drive at once, and one kind in the place of another."""

from collections.abc import Sequence

import numpy as np

from dropo.core.contracts.effect import instances_of
from dropo.diagnosis.far_off.model import FarOffModel, reaching
from dropo.diagnosis.regression.equation import coupled_joints
from dropo.diagnosis.search.library import PARTNERS, declared, robot_of
from dropo.mjmodel.joints import joints
from dropo.mjmodel.tendons import fixed_tendons, moved_by_tendons

EVERYWHERE = (None, "hinges", "slides")
"""Targets of effects that act at many places alike."""
ALONG_TENDONS = {
    "joint_armature": "tendon_armature",
    "joint_damping": "tendon_damping",
    "joint_friction": "tendon_friction",
}
"""What stands for an effect of joints where drives move them through tendons."""


def with_families(model: FarOffModel, names: Sequence[str]) -> FarOffModel:
    """Add effects at every place where the model neither has nor declares them.

    Joints that follow others by an equality constraint are no places. Where drives move joints
    through tendons, laws are along these, unless the model has them at the joints.

    Parameters
    ----------
    model : FarOffModel
        Any.
    names : sequence of str
        Names of effects.

    Returns
    -------
    FarOffModel
        New numbers are 0, or what the same effect had everywhere alike, which they replace. The
        same object where there is nothing to add.
    """
    simulator = robot_of(model.problem)
    # What a joint has that follows another acts there as if that had it.
    elsewhere = {*EVERYWHERE, *(follower.name for follower in coupled_joints(simulator))}
    moved = moved_by_tendons(simulator.model)
    by_tendons = {joint.name for joint in joints(simulator.model) if joint.qvel in moved}
    pulled = {line.tendon.name for line in fixed_tendons(simulator.model) if line.driven}
    laws = {one.target for one, _ in model.numbers if one.effect in ALONG_TENDONS}
    if laws & by_tendons:  # regression says that they are at the joints
        by_tendons = pulled = set()
    for name in names:
        taken = {instance.label for instance, _ in model.numbers}
        offered = list(instances_of(simulator.effect_context, name))
        if name in ALONG_TENDONS:
            along = instances_of(simulator.effect_context, ALONG_TENDONS[name])
            offered = [one for one in offered if one.target not in by_tendons]
            offered += [one for one in along if one.target in pulled]
        family = [
            instance
            for instance in offered
            if instance.target not in elsewhere
            and not instance.variant
            and instance.label not in taken
            and not declared(simulator, instance, model.free)
        ]
        if not family:
            continue
        sizes = np.zeros(len(family[0].quantities))
        replaced = []
        for instance, own in model.numbers:
            if instance.effect == name and instance.target in EVERYWHERE:
                sizes = own
                replaced.append(instance.label)
        # The one place that there is has what is everywhere.
        if replaced and len(family) < 2:
            continue
        numbers = [(reaching(instance, sizes), sizes.copy()) for instance in family]
        model = model.without(replaced).with_numbers(numbers)
    return model


def late_otherwise(model: FarOffModel) -> FarOffModel:
    """Exchange every delay of commands for a first-order lag that is as long, and the reverse.

    Parameters
    ----------
    model : FarOffModel
        Any.

    Returns
    -------
    FarOffModel
        The same object where there is neither.
    """
    context = robot_of(model.problem).effect_context
    late = [(one, sizes) for one, sizes in model.numbers if one.effect in PARTNERS]
    if not late:
        return model
    labels = {one.label for one, _ in model.numbers}
    numbers = []
    for one, sizes in late:
        offered = instances_of(context, PARTNERS[one.effect])
        (partner,) = (other for other in offered if other.target == one.target)
        if partner.label in labels:
            return model
        numbers.append((reaching(partner, sizes), sizes))
    return model.without([one.label for one, _ in late]).with_numbers(numbers)
