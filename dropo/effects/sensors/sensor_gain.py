"""The scale of a measurement."""

from collections.abc import Iterator
from functools import partial

import numpy as np

from dropo.core.contracts.effect import EffectContext, EffectInstance, Quantity
from dropo.core.services.validation import Array
from dropo.effects.support.places import is_rotation


def sensor_gain(context: EffectContext) -> Iterator[EffectInstance]:
    """The scale of a signal; not of rotations, which have none.

    y' = (1 + g) y

    Parameters
    ----------
    context : EffectContext
        The robot for which instances are offered.

    Yields
    ------
    EffectInstance
        One for each compared signal, with the pure number g.
    """
    for place, (name, _) in enumerate(context.signals):
        if is_rotation(name):
            continue
        gain = Quantity("gain", "1", -0.9, 4.0, (-0.05, -0.005, 0.005, 0.05), relative=True)
        yield EffectInstance(
            "sensor_gain",
            name,
            (gain,),
            start=partial(_undo, place),
            measurement=partial(_scale, place),
        )


def _undo(place: int, signals: Array, speeds: Array, magnitudes: Array) -> Array:
    """Offsets that divide the start signal by the scale."""
    out = np.zeros_like(signals)
    out[:, place] = signals[:, place] * (1 / (1 + magnitudes[0]) - 1)
    return out


def _scale(place: int, signals: Array, magnitudes: Array) -> Array:
    """Scales one signal."""
    out = signals.copy()
    out[..., place] *= 1 + magnitudes[0]
    return out
