"""Where a joint's stops are."""

from collections.abc import Iterator

from dropo.core.contracts.effect import EffectContext, EffectInstance, Quantity
from dropo.effects.support.model_field import FieldEntry, ModelField
from dropo.mjmodel.joints import joints

FIELD = ModelField("joint_limit", "jnt_range", "stop")


def joint_limit(context: EffectContext) -> Iterator[EffectInstance]:
    """The position of a joint's lower or upper stop.

    Parameters
    ----------
    context : EffectContext
        The robot for which instances are offered.

    Yields
    ------
    EffectInstance
        Two for each joint with stops: the variants "lower" and "upper", each a shift [m or rad].
    """
    for joint in joints(context.model):
        if not context.model.jnt_limited[joint.id]:
            continue
        stops = context.model.jnt_range[joint.id]
        width = float(stops[1] - stops[0])
        probes = tuple(fraction * width for fraction in (-0.05, -0.005, 0.005, 0.05))
        for side, name in enumerate(("lower", "upper")):
            base = float(stops[side])
            shift = Quantity(
                name, joint.length, -0.5 * width, 0.5 * width, probes, smooth=False, base=base
            )
            change = FIELD.change([FieldEntry(joint.name, (joint.id, side), width)])
            yield EffectInstance("joint_limit", joint.name, (shift,), name, model=change)
