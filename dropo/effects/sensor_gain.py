"""The scale of a measurement."""

from collections.abc import Iterator
from functools import partial

import numpy as np

from dropo.core.contracts.effect import EffectContext, EffectInstance, Quantity
from dropo.core.services.validation import Array
from dropo.effects.support.places import is_rotation


def sensor_gain(context: EffectContext) -> Iterator[EffectInstance]:
    """The scale of a signal, y' = (1 + g) y; not of rotations, which have none."""
    for place, (name, _) in enumerate(context.signals):
        if not is_rotation(name):
            size = Quantity("gain", "1", -0.9, 4.0, (-0.05, -0.005, 0.005, 0.05), relative=True)
            yield EffectInstance(
                "sensor_gain",
                name,
                (size,),
                start=partial(_back, place),
                measurement=partial(_scale, place),
            )


def _back(place: int, rows: Array, slopes: Array, magnitudes: Array) -> Array:
    out = np.zeros_like(rows)
    out[:, place] = rows[:, place] * (1 / (1 + magnitudes[0]) - 1)
    return out


def _scale(place: int, signals: Array, magnitudes: Array) -> Array:
    out = signals.copy()
    out[..., place] *= 1 + magnitudes[0]
    return out
