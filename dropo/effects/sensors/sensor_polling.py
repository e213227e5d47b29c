"""Signals that are read one after another."""

from collections.abc import Iterator
from functools import partial

import numpy as np

from dropo.core.contracts.effect import EffectContext, EffectInstance, Quantity
from dropo.core.services.validation import Array
from dropo.mjmodel.joints import joints

WHOLE = (0.2, 0.5, 1.0)
"""Times for reading all joints that a screening tries, in control steps."""
LONGEST = 2.0
"""The longest time for reading all joints, in control steps."""


def sensor_polling(context: EffectContext) -> Iterator[EffectInstance]:
    """Joints that are read one after another on a bus, the last of them at the row's own time.

    Joint k of n is read (n - 1 - k) T before the last one, its position and velocity together;
    where T is negative, the last is read first.

    Parameters
    ----------
    context : EffectContext
        The robot for which instances are offered.

    Yields
    ------
    EffectInstance
        One, with T in seconds; none where fewer than two joints are read.
    """
    order = _order(context)
    count = max(order) + 1
    if count < 2:
        return
    whole = context.control_step / (count - 1)
    probes = tuple(sign * part * whole for part in WHOLE for sign in (-1.0, 1.0))
    interval = Quantity("interval", "s", -LONGEST * whole, LONGEST * whole, probes, smooth=False)
    places = np.array(order)
    yield EffectInstance(
        "sensor_polling",
        None,
        (interval,),
        start=partial(_move_on, places),
        sensor_delay=partial(_delays, places),
        trials=tuple(((probe,),) for probe in probes),
    )


def _order(context: EffectContext) -> list[int]:
    """The place of each signal's joint among the joints that are read; -1 of other signals."""
    of_signal = []
    known = {joint.name for joint in joints(context.model)}
    for name, _ in context.signals:
        field, _, joint = name.partition(".")
        of_signal.append(joint if field in ("qpos", "qvel") and joint in known else None)
    read = [joint for joint in dict.fromkeys(of_signal) if joint is not None]
    return [-1 if joint is None else read.index(joint) for joint in of_signal]


def _delays(places: Array, magnitudes: Array) -> Array:
    """By how much each signal is measured before the last one is."""
    count = places.max() + 1
    interval = magnitudes[0]
    before = interval * (count - 1 - places) if interval > 0 else -interval * places
    return np.where(places < 0, 0.0, before)


def _move_on(places: Array, signals: Array, speeds: Array, magnitudes: Array) -> Array:
    """Offsets from early start signals to the present ones, by their speeds."""
    return np.asarray(_delays(places, magnitudes) * speeds)
