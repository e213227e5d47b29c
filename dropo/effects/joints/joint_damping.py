"""Viscous damping."""

from collections.abc import Iterator

from dropo.core.contracts.effect import EffectContext, EffectInstance
from dropo.effects.support.model_field import FieldEntry, ModelField, by_kind
from dropo.mjmodel.joints import joints

FIELD = ModelField("joint_damping", "dof_damping", "damping", bound=1000.0)


def joint_damping(context: EffectContext) -> Iterator[EffectInstance]:
    """Viscous damping of a joint, or of all of them alike.

    Parameters
    ----------
    context : EffectContext
        The robot for which instances are offered.

    Yields
    ------
    EffectInstance
        One for each joint, and one for all of a kind alike where there are several [N s/m of
        slides, N m s/rad of hinges].
    """
    for kind, same in by_kind(joints(context.model)):
        entries = [
            FieldEntry(joint.name, (joint.qvel,), 0.5 * float(context.model.dof_M0[joint.qvel]))
            for joint in same
        ]
        yield from FIELD.instances(context.model, entries, same[0].damping, kind)
