"""The medium around the robot."""

from collections.abc import Iterator
from typing import Any

from dropo.core.checks import Array
from dropo.core.effect import Atom, Quantity, Robot

MEDIUM = (("density", "kg/m^3", 100.0), ("viscosity", "Pa s", 5.0))


def air_drag(robot: Robot) -> Iterator[Atom]:
    """The density or the viscosity of the medium (MuJoCo's inertia-box model of drag)."""
    for name, unit, scale in MEDIUM:
        base = float(getattr(robot.model.opt, name))

        def model(model: Any, sizes: Array, name: str = name) -> None:
            setattr(model.opt, name, getattr(model.opt, name) + float(sizes[0]))

        probes = tuple(share * scale for share in (0.01, 0.2))
        yield Atom("air_drag", None, (Quantity(name, unit, -base, 20 * scale, probes, base=base),), name, model=model)
