"""The rotational inertia of a body."""

from collections.abc import Iterator
from typing import Any

from dropo.core.checks import Array
from dropo.core.effect import Atom, Quantity, Robot
from dropo.effects.places import bodies


def body_inertia(robot: Robot) -> Iterator[Atom]:
    """The rotational inertia of a body, all its principal moments by one factor."""
    for body, name in bodies(robot.model):

        def model(model: Any, sizes: Array, body: int = body) -> None:
            model.body_inertia[body] *= 1 + sizes[0]

        size = Quantity(
            "inertia", "1", -0.8, 4.0, (-0.2, -0.02, 0.02, 0.2), relative=True, base=float(robot.model.body_inertia[body].max())
        )
        yield Atom("body_inertia", name, (size,), model=model)
