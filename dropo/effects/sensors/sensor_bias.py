"""A constant offset of a measurement."""

from collections.abc import Iterator
from functools import partial

import numpy as np

from dropo.core.contracts.effect import EffectContext, EffectInstance, Quantity
from dropo.core.services.validation import Array
from dropo.effects.support.places import LARGE_SENSOR_ERRORS


def sensor_bias(context: EffectContext) -> Iterator[EffectInstance]:
    """A constant that is added to a signal; of a rotation, a small turn about an axis of the body.

    y' = y + b

    Parameters
    ----------
    context : EffectContext
        The robot for which instances are offered.

    Yields
    ------
    EffectInstance
        One for each compared signal, with b in its unit.
    """
    for place, (name, unit) in enumerate(context.signals):
        scale = LARGE_SENSOR_ERRORS.get(unit, 0.1)
        probes = tuple(fraction * scale for fraction in (-0.1, -0.01, 0.01, 0.1))
        bias = Quantity("bias", unit or "1", -10 * scale, 10 * scale, probes)
        yield EffectInstance(
            "sensor_bias",
            name,
            (bias,),
            start=partial(_undo, place),
            measurement=partial(_add, place),
        )


def _undo(place: int, signals: Array, speeds: Array, magnitudes: Array) -> Array:
    """Offsets that take the bias from the start signals."""
    out = np.zeros_like(signals)
    out[:, place] = -magnitudes[0]
    return out


def _add(place: int, signals: Array, magnitudes: Array) -> Array:
    """Adds the bias to one signal."""
    out = signals.copy()
    out[..., place] += magnitudes[0]
    return out
