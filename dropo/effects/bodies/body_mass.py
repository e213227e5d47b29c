"""The mass of a body."""

from collections.abc import Iterator
from functools import partial
from typing import Any

from dropo.core.contracts.effect import EffectContext, EffectInstance, Quantity
from dropo.core.services.validation import Array
from dropo.mjmodel.bodies import moving_bodies


def body_mass(context: EffectContext) -> Iterator[EffectInstance]:
    """The mass of a body; its rotational inertia stays.

    m' = m + d

    Parameters
    ----------
    context : EffectContext
        The robot for which instances are offered.

    Yields
    ------
    EffectInstance
        One for each body that can move, with d in kg.
    """
    for body, name in moving_bodies(context.model):
        mass = float(context.model.body_mass[body])
        probes = tuple(fraction * mass for fraction in (-0.1, -0.02, 0.02, 0.1))
        change = Quantity("mass", "kg", -0.8 * mass, 3 * mass, probes, base=mass)
        yield EffectInstance("body_mass", name, (change,), model=partial(_add, body))


def _add(body: int, model: Any, magnitudes: Array) -> None:
    """Adds to the mass of a body."""
    model.body_mass[body] += magnitudes[0]
