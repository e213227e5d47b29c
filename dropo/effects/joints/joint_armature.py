"""Reflected inertia."""

from collections.abc import Iterator

from dropo.core.contracts.effect import EffectContext, EffectInstance
from dropo.effects.support.model_field import FieldEntry, ModelField, by_kind
from dropo.mjmodel.joints import joints

FIELD = ModelField("joint_armature", "dof_armature", "armature", bound=100.0)


def joint_armature(context: EffectContext) -> Iterator[EffectInstance]:
    """The reflected inertia of a joint's rotor and gear, or of all of them alike.

    Parameters
    ----------
    context : EffectContext
        The robot for which instances are offered.

    Yields
    ------
    EffectInstance
        One for each joint, and one for all of a kind alike where there are several [kg of slides,
        kg m^2 of hinges].
    """
    for kind, same in by_kind(joints(context.model)):
        entries = [
            FieldEntry(joint.name, (joint.qvel,), 0.1 * float(context.model.dof_M0[joint.qvel]))
            for joint in same
        ]
        yield from FIELD.instances(context.model, entries, same[0].inertia, kind)
