"""A moving medium."""

from collections.abc import Iterator
from functools import partial
from typing import Any

from dropo.core.contracts.effect import Atom, Quantity, Robot
from dropo.core.services.validation import Array


def wind(robot: Robot) -> Iterator[Atom]:
    """Wind along one of the world's axes, in a medium of a density to be found with it (MuJoCo's drag, see air_drag)."""
    base = float(robot.model.opt.density)
    for axis, letter in enumerate("xyz"):
        trials = tuple((pair,) for pair in ((1.2, -5.0), (1.2, 5.0), (20.0, -5.0), (20.0, 5.0)))
        density = Quantity("density", "kg/m^3", -base, 2000.0, (1.2, 20.0), base=base)
        speed = Quantity("speed", "m/s", -30.0, 30.0, (-5.0, 5.0), base=float(robot.model.opt.wind[axis]))
        yield Atom("wind", None, (density, speed), letter, model=partial(_blow, axis), trials=trials)


def _blow(axis: int, model: Any, sizes: Array) -> None:
    model.opt.density += float(sizes[0])
    model.opt.wind[axis] += sizes[1]
