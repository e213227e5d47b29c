"""Coulomb friction."""

from collections.abc import Iterator

from dropo.core.contracts.effect import EffectContext, EffectInstance
from dropo.effects.support.model_field import FieldEntry, ModelField, by_kind
from dropo.mjmodel.dynamics.forces import torque_scale
from dropo.mjmodel.joints import joints

FIELD = ModelField("joint_friction", "dof_frictionloss", "frictionloss", bound=50.0)


def joint_friction(context: EffectContext) -> Iterator[EffectInstance]:
    """Coulomb (dry) friction of a joint, or of all of them alike.

    Parameters
    ----------
    context : EffectContext
        The robot for which instances are offered.

    Yields
    ------
    EffectInstance
        One for each joint, and one for all of a kind alike where there are several [N of slides, N
        m of hinges].
    """
    for kind, same in by_kind(joints(context.model)):
        entries = [
            FieldEntry(joint.name, (joint.qvel,), 0.01 * torque_scale(context.model, joint))
            for joint in same
        ]
        yield from FIELD.instances(context.model, entries, same[0].force, kind)
