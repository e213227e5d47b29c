"""Measurements that come late."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from dropo.core.checks import Array
from dropo.core.effect import Atom, Quantity, Robot


def sensor_delay(robot: Robot) -> Iterator[Atom]:
    """A delay of one signal. Of all signals alike it is the same as a delay of all commands, which stands for both."""
    dt, p = robot.control_step, len(robot.signals)
    for place, (name, _) in enumerate(robot.signals):
        size = Quantity("delay", "s", 0.0, 5 * dt, (0.02 * dt, 0.2 * dt, dt), smooth=False)
        yield Atom("sensor_delay", name, (size,), start=_ahead([place]), late=_late([place], p))


def _ahead(places: Sequence[int]) -> Any:
    """The signal now, from what was seen late and how fast it moves."""

    def start(rows: Array, slopes: Array, sizes: Array) -> Array:
        out = 0.0 * rows
        out[:, places] = sizes[0] * slopes[:, places]
        return out

    return start


def _late(places: Sequence[int], p: int) -> Any:
    def late(sizes: Array) -> Array:
        out = np.zeros(p)
        out[places] = sizes[0]
        return out

    return late
