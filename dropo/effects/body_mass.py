"""The mass of a body."""

from collections.abc import Iterator
from functools import partial
from typing import Any

from dropo.core.contracts.effect import EffectContext, EffectInstance, Quantity
from dropo.core.services.validation import Array
from dropo.mjmodel.bodies import moving_bodies


def body_mass(context: EffectContext) -> Iterator[EffectInstance]:
    """The mass of a body; its rotational inertia stays: m' = m + d."""
    for body, name in moving_bodies(context.model):
        mass = float(context.model.body_mass[body])
        size = Quantity(
            "mass",
            "kg",
            -0.8 * mass,
            3 * mass,
            (-0.1 * mass, -0.02 * mass, 0.02 * mass, 0.1 * mass),
            base=mass,
        )
        yield EffectInstance("body_mass", name, (size,), model=partial(_add, body))


def _add(body: int, model: Any, magnitudes: Array) -> None:
    model.body_mass[body] += magnitudes[0]
