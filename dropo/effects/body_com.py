"""The centre of mass of a body."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from dropo.core.checks import Array
from dropo.core.effect import Atom, Quantity, Robot
from dropo.effects.places import bodies


def body_com(robot: Robot) -> Iterator[Atom]:
    """The centre of mass of a body, along each axis of the body's frame."""
    for body, name in bodies(robot.model):
        radius = float(np.sqrt(robot.model.body_inertia[body].max() / robot.model.body_mass[body]))
        for axis, letter in enumerate("xyz"):

            def model(model: Any, sizes: Array, body: int = body, axis: int = axis) -> None:
                model.body_ipos[body, axis] += sizes[0]

            probes = tuple(share * radius for share in (-0.1, -0.01, 0.01, 0.1))
            size = Quantity(letter, "m", -2 * radius, 2 * radius, probes, base=float(robot.model.body_ipos[body, axis]))
            yield Atom("body_com", name, (size,), letter, model=model)
