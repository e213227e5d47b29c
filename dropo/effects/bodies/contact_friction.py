"""Friction of contacts."""

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from typing import Any

from dropo.core.contracts.effect import EffectContext, EffectInstance, Quantity
from dropo.core.services.validation import Array
from dropo.mjmodel.bodies import contact_geoms

PROBES = (-0.8, -0.5, -0.2, -0.02, 0.02, 0.2)
"""Large ones too: contacts that stick do not change with a small change of friction."""


def contact_friction(context: EffectContext) -> Iterator[EffectInstance]:
    """Sliding friction of all contacts by one factor, or of one geom's contacts.

    mu' = (1 + s) mu. A contact takes the larger friction of its two geoms, so that one geom's has
    no effect below that of the world's geoms; such magnitudes are not offered.

    Parameters
    ----------
    context : EffectContext
        The robot for which instances are offered.

    Yields
    ------
    EffectInstance
        One for all geoms, then one for each that can touch something where there are several, with
        the pure number s; none where nothing can touch.
    """
    model = context.model
    geoms = contact_geoms(model)
    if not geoms:
        return
    factor = Quantity("sliding", "1", -0.95, 5.0, PROBES, smooth=False, relative=True)
    yield EffectInstance("contact_friction", None, (factor,), model=_scale_all)
    if len(geoms) == 1:
        return
    world = float(model.geom_friction[model.geom_bodyid == 0, 0].max(initial=0.0))
    for geom, name in geoms:
        own = float(model.geom_friction[geom, 0])
        if own <= 0 or world >= own:
            continue
        low = max(factor.low, world / own - 1)
        probes = tuple(probe for probe in PROBES if probe > low)
        number = replace(factor, low=low, probes=probes, base=own)
        yield EffectInstance("contact_friction", name, (number,), model=partial(_scale, geom))


def _scale_all(model: Any, magnitudes: Array) -> None:
    """Scales the sliding friction of all geoms and pairs."""
    model.geom_friction[:, 0] *= 1 + magnitudes[0]
    model.pair_friction[:, :2] *= 1 + magnitudes[0]


def _scale(geom: int, model: Any, magnitudes: Array) -> None:
    """Scales the sliding friction of one geom."""
    model.geom_friction[geom, 0] *= 1 + magnitudes[0]
