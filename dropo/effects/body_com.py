"""The centre of mass of a body."""

from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np

from dropo.core.contracts.effect import Atom, Quantity, Robot
from dropo.core.services.validation import Array
from dropo.effects.support.places import bodies


def body_com(robot: Robot) -> Iterator[Atom]:
    """The centre of mass of a body, along each axis of the body's frame; the rotational inertia about it stays.

    Of bodies that MuJoCo compiles as simple (free bodies whose frame is at their centre of mass) only where the model can be
    compiled anew, since it cannot move their centre of mass otherwise.
    """
    for body, name in bodies(robot.model):
        simple = bool(robot.model.body_simple[body])
        if simple and not robot.source:
            continue
        radius = float(np.sqrt(robot.model.body_inertia[body].max() / robot.model.body_mass[body]))
        for axis, letter in enumerate("xyz"):
            probes = tuple(share * radius for share in (-0.1, -0.01, 0.01, 0.1))
            size = Quantity(letter, "m", -2 * radius, 2 * radius, probes, base=float(robot.model.body_ipos[body, axis]))
            yield Atom("body_com", name, (size,), letter, model=partial(_move, body, axis), general=simple)


def _move(body: int, axis: int, model: Any, sizes: Array) -> None:
    model.body_ipos[body, axis] += sizes[0]
