"""The centre of mass of a body."""

from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np

from dropo.core.contracts.effect import EffectContext, EffectInstance, Quantity
from dropo.core.services.validation import Array
from dropo.mjmodel.bodies import moving_bodies


def body_com(context: EffectContext) -> Iterator[EffectInstance]:
    """The centre of mass of a body, along each axis of its frame; the inertia about it stays.

    It is left out for bodies that MuJoCo compiles as simple (free bodies whose frame is at their
    centre of mass) where the model cannot be compiled anew: MuJoCo cannot move their centre of mass
    otherwise.

    Parameters
    ----------
    context : EffectContext
        The robot for which instances are offered.

    Yields
    ------
    EffectInstance
        Three for each body that can move: the variants "x", "y" and "z", each a shift [m].
    """
    for body, name in moving_bodies(context.model):
        simple = bool(context.model.body_simple[body])
        if simple and not context.source:
            continue
        # the largest radius of gyration
        inertia = context.model.body_inertia[body].max()
        radius = float(np.sqrt(inertia / context.model.body_mass[body]))
        for axis, letter in enumerate("xyz"):
            probes = tuple(fraction * radius for fraction in (-0.1, -0.01, 0.01, 0.1))
            base = float(context.model.body_ipos[body, axis])
            shift = Quantity(letter, "m", -2 * radius, 2 * radius, probes, base=base)
            yield EffectInstance(
                "body_com", name, (shift,), letter, model=partial(_move, body, axis), general=simple
            )


def _move(body: int, axis: int, model: Any, magnitudes: Array) -> None:
    """Moves the centre of mass along one axis."""
    model.body_ipos[body, axis] += magnitudes[0]
