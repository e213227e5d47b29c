"""The medium around the robot."""

from collections.abc import Iterator
from functools import partial
from typing import Any

from dropo.core.contracts.effect import EffectContext, EffectInstance, Quantity
from dropo.core.services.validation import Array

MEDIUM = (("density", "kg/m^3", 100.0), ("viscosity", "Pa s", 5.0))
"""Field of mjOption, unit and the size of a large change."""


def air_drag(context: EffectContext) -> Iterator[EffectInstance]:
    """The density or the viscosity of the medium around the robot.

    MuJoCo computes the drag of each body from a box of equal inertia.

    Parameters
    ----------
    context : EffectContext
        The robot for which instances are offered.

    Yields
    ------
    EffectInstance
        Two, global: the variants "density" [kg/m^3] and "viscosity" [Pa s], each as a change of the
        model's own.
    """
    for name, unit, scale in MEDIUM:
        base = float(getattr(context.model.opt, name))
        change = Quantity(name, unit, -base, 20 * scale, (0.01 * scale, 0.2 * scale), base=base)
        yield EffectInstance("air_drag", None, (change,), name, model=partial(_add, name))


def _add(name: str, model: Any, magnitudes: Array) -> None:
    """Adds to a number of the medium."""
    setattr(model.opt, name, getattr(model.opt, name) + float(magnitudes[0]))
