"""The scale of a measurement."""

from collections.abc import Iterator

from dropo.core.checks import Array
from dropo.core.effect import Atom, Quantity, Robot


def sensor_gain(robot: Robot) -> Iterator[Atom]:
    """The scale of a signal; not of rotations, which have none."""
    for place, (name, _) in enumerate(robot.signals):
        if name.endswith((".rx", ".ry", ".rz")):
            continue

        def start(rows: Array, slopes: Array, sizes: Array, place: int = place) -> Array:
            out = 0.0 * rows
            out[:, place] = rows[:, place] * (1 / (1 + sizes[0]) - 1)
            return out

        def sense(signals: Array, sizes: Array, place: int = place) -> Array:
            out = signals.copy()
            out[..., place] *= 1 + sizes[0]
            return out

        size = Quantity("gain", "1", -0.9, 4.0, (-0.05, -0.005, 0.005, 0.05), relative=True)
        yield Atom("sensor_gain", name, (size,), start=start, sense=sense)
