"""A moving medium."""

from collections.abc import Iterator
from functools import partial
from typing import Any

from dropo.core.contracts.effect import EffectContext, EffectInstance, Quantity
from dropo.core.services.validation import Array


def wind(context: EffectContext) -> Iterator[EffectInstance]:
    """Wind along one of the world's axes, in a medium whose density is found with it.

    MuJoCo's drag, see `air_drag`.

    Parameters
    ----------
    context : EffectContext
        The robot for which instances are offered.

    Yields
    ------
    EffectInstance
        Three, global: the variants "x", "y" and "z", each with a density [kg/m^3] and a speed
        [m/s].
    """
    option = context.model.opt
    base = float(option.density)
    trials = tuple((pair,) for pair in ((1.2, -5.0), (1.2, 5.0), (20.0, -5.0), (20.0, 5.0)))
    density = Quantity("density", "kg/m^3", -base, 2000.0, (1.2, 20.0), base=base)
    for axis, letter in enumerate("xyz"):
        own = float(option.wind[axis])
        speed = Quantity("speed", "m/s", -30.0, 30.0, (-5.0, 5.0), base=own)
        change = partial(_blow, axis)
        yield EffectInstance("wind", None, (density, speed), letter, model=change, trials=trials)


def _blow(axis: int, model: Any, magnitudes: Array) -> None:
    """Adds to the density of the medium and to its speed along one axis."""
    model.opt.density += float(magnitudes[0])
    model.opt.wind[axis] += magnitudes[1]
