"""The rotational inertia of a body."""

from collections.abc import Iterator
from functools import partial
from typing import Any

from dropo.core.contracts.effect import EffectContext, EffectInstance, Quantity
from dropo.core.services.validation import Array
from dropo.mjmodel.bodies import moving_bodies


def body_inertia(context: EffectContext) -> Iterator[EffectInstance]:
    """The rotational inertia of a body, all its principal moments by one factor.

    I' = (1 + s) I

    Parameters
    ----------
    context : EffectContext
        The robot for which instances are offered.

    Yields
    ------
    EffectInstance
        One for each body that can move, with the pure number s.
    """
    for body, name in moving_bodies(context.model):
        base = float(context.model.body_inertia[body].max())
        probes = (-0.2, -0.02, 0.02, 0.2)
        factor = Quantity("inertia", "1", -0.8, 4.0, probes, relative=True, base=base)
        yield EffectInstance("body_inertia", name, (factor,), model=partial(_scale, body))


def _scale(body: int, model: Any, magnitudes: Array) -> None:
    """Scales the principal moments of a body."""
    model.body_inertia[body] *= 1 + magnitudes[0]
