"""Friction of contacts."""

from collections.abc import Iterator
from functools import partial
from typing import Any

from dropo.core.contracts.effect import EffectContext, EffectInstance, Quantity
from dropo.core.services.validation import Array
from dropo.mjmodel.bodies import contact_geoms

PROBES = (-0.8, -0.5, -0.2, -0.02, 0.02, 0.2)  # contacts that stick feel nothing of a small change


def contact_friction(context: EffectContext) -> Iterator[EffectInstance]:
    """Sliding friction of all contacts by one factor, or of one geom's: mu' = (1 + s) mu.

    A contact takes the larger friction of its two geoms, so that one geom's has no effect below
    that of the world's geoms; such sizes are not offered.
    """
    size = Quantity("sliding", "1", -0.95, 5.0, PROBES, smooth=False, relative=True)
    geoms = contact_geoms(context.model)
    if not geoms:
        return
    yield EffectInstance("contact_friction", None, (size,), model=_scale_all)
    world = context.model.geom_friction[context.model.geom_bodyid == 0, 0]
    for geom, name in geoms if len(geoms) > 1 else []:
        own = float(context.model.geom_friction[geom, 0])
        least = max(size.low, float(world.max(initial=0.0)) / own - 1) if own > 0 else 0.0
        if least < 0:
            probes = tuple(probe for probe in size.probes if probe > least)
            number = Quantity(
                "sliding", "1", least, size.high, probes, smooth=False, relative=True, base=own
            )
            yield EffectInstance("contact_friction", name, (number,), model=partial(_scale, geom))


def _scale_all(model: Any, magnitudes: Array) -> None:
    model.geom_friction[:, 0] *= 1 + magnitudes[0]
    model.pair_friction[:, :2] *= 1 + magnitudes[0]


def _scale(geom: int, model: Any, magnitudes: Array) -> None:
    model.geom_friction[geom, 0] *= 1 + magnitudes[0]
