"""The direction of gravity."""

from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np

from dropo.core.contracts.effect import EffectContext, EffectInstance, Quantity
from dropo.core.services.validation import Array


def gravity_tilt(context: EffectContext) -> Iterator[EffectInstance]:
    """The direction of gravity: g' = R(angle) g, a rotation about the world's x or y axis, as where
    the base is tilted.
    """
    for axis, letter in enumerate("xy") if np.any(context.model.opt.gravity) else []:
        size = Quantity(letter, "rad", -0.5, 0.5, (-0.05, -0.005, 0.005, 0.05))
        yield EffectInstance("gravity_tilt", None, (size,), letter, model=partial(_tilt, axis))


def _tilt(axis: int, model: Any, magnitudes: Array) -> None:
    c = np.cos(magnitudes[0])
    s = np.sin(magnitudes[0])
    rotation = (
        [[1, 0, 0], [0, c, -s], [0, s, c]] if axis == 0 else [[c, 0, s], [0, 1, 0], [-s, 0, c]]
    )
    model.opt.gravity[:] = np.array(rotation) @ model.opt.gravity
