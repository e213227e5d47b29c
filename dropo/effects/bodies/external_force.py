"""A constant force on a body."""

from collections.abc import Iterator
from functools import partial

import numpy as np

from dropo.core.contracts.effect import EffectContext, EffectInstance, Quantity
from dropo.core.services.validation import Array
from dropo.mjmodel.bodies import moving_bodies


def external_force(context: EffectContext) -> Iterator[EffectInstance]:
    """A constant force at a body's centre of mass, along one of the world's axes.

    Parameters
    ----------
    context : EffectContext
        The robot for which instances are offered.

    Yields
    ------
    EffectInstance
        Three for each body that can move: the variants "x", "y" and "z", each a force [N].
    """
    gravity = max(np.linalg.norm(context.model.opt.gravity), 1.0)
    weight = float(context.model.body_mass.sum() * gravity)
    for body, name in moving_bodies(context.model):
        for axis, letter in enumerate("xyz"):
            probes = tuple(fraction * weight for fraction in (-0.02, -0.002, 0.002, 0.02))
            force = Quantity(letter, "N", -weight, weight, probes)
            yield EffectInstance(
                "external_force", name, (force,), letter, wrench=partial(_push, body, axis)
            )


def _push(body: int, axis: int, magnitudes: Array) -> tuple[int, Array]:
    """The body, and the force and torque on it."""
    return body, np.eye(6)[axis] * magnitudes[0]
