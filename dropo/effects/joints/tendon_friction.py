"""Dry friction along a tendon."""

from collections.abc import Iterator

from dropo.core.contracts.effect import EffectContext, EffectInstance
from dropo.effects.support.model_field import FieldEntry, ModelField
from dropo.mjmodel.tendons import tendons

FIELD = ModelField("tendon_friction", "tendon_frictionloss", "frictionloss", bound=50.0)


def tendon_friction(context: EffectContext) -> Iterator[EffectInstance]:
    """The dry friction of a tendon, which coupled joints share.

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
        entry = FieldEntry(tendon.name, (tendon.id,), 0.1 * tendon.inertia)
        yield from FIELD.instances(context.model, [entry], tendon.force, "")
