"""Viscous damping along a tendon."""

from collections.abc import Iterator

from dropo.core.contracts.effect import EffectContext, EffectInstance
from dropo.effects.support.model_field import FieldEntry, ModelField
from dropo.mjmodel.tendons import tendons

FIELD = ModelField("tendon_damping", "tendon_damping", "damping")


def tendon_damping(context: EffectContext) -> Iterator[EffectInstance]:
    """The viscous damping of a tendon, which coupled joints share.

    Parameters
    ----------
    context : EffectContext
        The robot for which instances are offered.

    Yields
    ------
    EffectInstance
        One for each tendon of the model.
    """
    for tendon in tendons(context.model):
        entry = FieldEntry(tendon.name, (tendon.id,), 0.5 * tendon.inertia)
        yield from FIELD.instances(context.model, [entry], tendon.damping, "")
