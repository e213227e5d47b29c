"""Measurements that come late."""

from collections.abc import Iterator
from functools import partial

import numpy as np

from dropo.core.contracts.effect import EffectContext, EffectInstance, Quantity
from dropo.core.services.validation import Array
from dropo.effects.support.places import is_rotation

TRIALS = (0.02, 0.2, 0.5, 1.0, 2.0)
"""Delays that a screening tries, in control steps; for a fast signal, only one near the right delay
improves the prediction.
"""


def sensor_delay(context: EffectContext) -> Iterator[EffectInstance]:
    """The delay of one signal; not of rotations, whose three numbers come together.

    y'(t) = y(t - T). A start is moved on by T times the speed of the measured signal. A delay of
    all signals alike is the same as one of all commands (`actuator_delay`), which stands for both.

    Parameters
    ----------
    context : EffectContext
        The robot for which instances are offered.

    Yields
    ------
    EffectInstance
        One for each compared signal, with T in seconds.
    """
    dt = context.control_step
    count = len(context.signals)
    for place, (name, _) in enumerate(context.signals):
        if is_rotation(name):
            continue
        delay = Quantity("delay", "s", 0.0, 5 * dt, (0.02 * dt, 0.2 * dt, dt), smooth=False)
        yield EffectInstance(
            "sensor_delay",
            name,
            (delay,),
            start=partial(_move_on, place),
            sensor_delay=partial(_delays, place, count),
            trials=tuple(((steps * dt,),) for steps in TRIALS),
        )


def _move_on(place: int, signals: Array, speeds: Array, magnitudes: Array) -> Array:
    """Offsets from the delayed start signal to the present one, by its speed."""
    out = np.zeros_like(signals)
    out[:, place] = magnitudes[0] * speeds[:, place]
    return out


def _delays(place: int, count: int, magnitudes: Array) -> Array:
    """The delay of each of the signals."""
    return np.eye(count)[place] * magnitudes[0]
