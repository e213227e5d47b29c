"""The direction of gravity."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from dropo.core.checks import Array
from dropo.core.effect import Atom, Quantity, Robot


def gravity_tilt(robot: Robot) -> Iterator[Atom]:
    """The direction of gravity: a base that is tilted about the world's x or y axis."""
    if not np.any(robot.model.opt.gravity):
        return
    for axis, letter in enumerate("xy"):

        def model(model: Any, sizes: Array, axis: int = axis) -> None:
            model.opt.gravity[:] = _rotation(axis, sizes[0]) @ model.opt.gravity

        yield Atom("gravity_tilt", None, (Quantity(letter, "rad", -0.5, 0.5, (-0.05, -0.005, 0.005, 0.05)),), letter, model=model)


def _rotation(axis: int, angle: float) -> Array:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[1, 0, 0], [0, c, -s], [0, s, c]] if axis == 0 else [[c, 0, s], [0, 1, 0], [-s, 0, c]])
