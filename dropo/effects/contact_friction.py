"""Friction of contacts."""

from collections.abc import Iterator
from typing import Any

from dropo.core.checks import Array
from dropo.core.effect import Atom, Quantity, Robot
from dropo.effects.places import touching


def contact_friction(robot: Robot) -> Iterator[Atom]:
    """Sliding friction of all contacts by one factor, or of one geom's."""
    size = Quantity("sliding", "1", -0.95, 5.0, (-0.2, -0.02, 0.02, 0.2), relative=True)
    geoms = touching(robot.model)
    if not geoms:
        return

    def everywhere(model: Any, sizes: Array) -> None:
        model.geom_friction[:, 0] *= 1 + sizes[0]
        model.pair_friction[:, :2] *= 1 + sizes[0]

    yield Atom("contact_friction", None, (size,), model=everywhere)
    world = robot.model.geom_friction[robot.model.geom_bodyid == 0, 0]
    for geom, name in geoms if len(geoms) > 1 else []:
        own = float(robot.model.geom_friction[geom, 0])
        least = float(world.max(initial=0.0)) / own - 1  # a contact takes the larger friction of its two geoms
        if least >= 0:
            continue

        def model(model: Any, sizes: Array, geom: int = geom) -> None:
            model.geom_friction[geom, 0] *= 1 + sizes[0]

        number = Quantity("sliding", "1", least, 5.0, tuple(p for p in size.probes if p > least), relative=True, base=own)
        yield Atom("contact_friction", name, (number,), model=model)
