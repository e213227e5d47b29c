"""Measurements that come late."""

from collections.abc import Iterator
from functools import partial

import numpy as np

from dropo.core.contracts.effect import EffectContext, EffectInstance, Quantity
from dropo.core.services.validation import Array
from dropo.effects.support.places import is_rotation

TRIED = (0.02, 0.2, 0.5, 1.0, 2.0)  # control steps: of a fast signal the right one alone stands out


def sensor_delay(context: EffectContext) -> Iterator[EffectInstance]:
    """A delay of one signal, y'(t) = y(t - T); not of rotations, whose three numbers come together.

    A start is moved on by T times the speed of the measured signal. Of all signals alike a delay is
    the same as one of all commands, which stands for both.
    """
    dt = context.control_step
    p = len(context.signals)
    for place, (name, _) in enumerate(context.signals):
        if not is_rotation(name):
            size = Quantity("delay", "s", 0.0, 5 * dt, (0.02 * dt, 0.2 * dt, dt), smooth=False)
            trials = tuple(((share * dt,),) for share in TRIED)
            yield EffectInstance(
                "sensor_delay",
                name,
                (size,),
                start=partial(_ahead, place),
                sensor_delay=partial(_late, place, p),
                trials=trials,
            )


def _ahead(place: int, rows: Array, slopes: Array, magnitudes: Array) -> Array:
    """The signal now, from what was seen late and how fast it moves."""
    out = np.zeros_like(rows)
    out[:, place] = magnitudes[0] * slopes[:, place]
    return out


def _late(place: int, p: int, magnitudes: Array) -> Array:
    return np.eye(p)[place] * magnitudes[0]
