"""How hard contacts are."""

from collections.abc import Iterator
from typing import Any

from dropo.core.checks import Array
from dropo.core.effect import Atom, Quantity, Robot
from dropo.effects.places import touching


def contact_stiffness(robot: Robot) -> Iterator[Atom]:
    """Time constant or damping ratio of all contacts by one factor, or the distance at which they begin."""
    if not touching(robot.model):
        return
    for place, name in enumerate(("time constant", "damping ratio")):

        def model(model: Any, sizes: Array, place: int = place) -> None:
            model.geom_solref[:, place] *= 1 + sizes[0]
            model.pair_solref[:, place] *= 1 + sizes[0]

        size = Quantity(name, "1", -0.8, 5.0, (-0.2, -0.02, 0.02, 0.2), relative=True)
        yield Atom("contact_stiffness", None, (size,), name.replace(" ", "-"), model=model)

    def margin(model: Any, sizes: Array) -> None:
        model.geom_margin[:] += sizes[0] / 2  # the margins of two geoms add up
        model.pair_margin[:] += sizes[0]

    size = Quantity("margin", "m", -0.05, 0.05, (-2e-3, -2e-4, 2e-4, 2e-3), smooth=False)
    yield Atom("contact_stiffness", None, (size,), "margin", model=margin)
