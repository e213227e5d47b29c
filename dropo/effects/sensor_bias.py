"""A constant offset of a measurement."""

from collections.abc import Iterator

from dropo.core.checks import Array
from dropo.core.effect import Atom, Quantity, Robot
from dropo.effects.places import SENSOR_SIZES


def sensor_bias(robot: Robot) -> Iterator[Atom]:
    """A constant that is added to a signal."""
    for place, (name, unit) in enumerate(robot.signals):

        def start(rows: Array, slopes: Array, sizes: Array, place: int = place) -> Array:
            out = 0.0 * rows
            out[:, place] = -sizes[0]
            return out

        def sense(signals: Array, sizes: Array, place: int = place) -> Array:
            out = signals.copy()
            out[..., place] += sizes[0]
            return out

        scale = SENSOR_SIZES.get(unit, 0.1)
        size = Quantity("bias", unit, -10 * scale, 10 * scale, tuple(share * scale for share in (-0.1, -0.01, 0.01, 0.1)))
        yield Atom("sensor_bias", name, (size,), start=start, sense=sense)
