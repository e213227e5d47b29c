"""A constant offset of a measurement."""

from collections.abc import Iterator
from functools import partial

import numpy as np

from dropo.core.contracts.effect import EffectContext, EffectInstance, Quantity
from dropo.core.services.validation import Array
from dropo.effects.support.places import SENSOR_SIZES


def sensor_bias(context: EffectContext) -> Iterator[EffectInstance]:
    """A constant that is added to a signal, y' = y + b; of a rotation, a small turn about an axis
    of the body.
    """
    for place, (name, unit) in enumerate(context.signals):
        scale = SENSOR_SIZES.get(unit, 0.1)
        size = Quantity(
            "bias",
            unit or "1",
            -10 * scale,
            10 * scale,
            tuple(share * scale for share in (-0.1, -0.01, 0.01, 0.1)),
        )
        yield EffectInstance(
            "sensor_bias",
            name,
            (size,),
            start=partial(_back, place),
            measurement=partial(_add, place),
        )


def _back(place: int, rows: Array, slopes: Array, magnitudes: Array) -> Array:
    out = np.zeros_like(rows)
    out[:, place] = -magnitudes[0]
    return out


def _add(place: int, signals: Array, magnitudes: Array) -> Array:
    out = signals.copy()
    out[..., place] += magnitudes[0]
    return out
