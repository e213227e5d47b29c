"""The direction of gravity."""

from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np

from dropo.core.contracts.effect import EffectContext, EffectInstance, Quantity
from dropo.core.services.validation import Array


def gravity_tilt(context: EffectContext) -> Iterator[EffectInstance]:
    """The direction of gravity, as where the base is tilted.

    g' = R(angle) g, with R a rotation about the world's x or y axis.

    Parameters
    ----------
    context : EffectContext
        The robot for which instances are offered.

    Yields
    ------
    EffectInstance
        Two, global: the variants "x" and "y", each an angle [rad]; none without gravity.
    """
    if not np.any(context.model.opt.gravity):
        return
    for axis, letter in enumerate("xy"):
        angle = Quantity(letter, "rad", -0.5, 0.5, (-0.05, -0.005, 0.005, 0.05))
        yield EffectInstance("gravity_tilt", None, (angle,), letter, model=partial(_tilt, axis))


def _tilt(axis: int, model: Any, magnitudes: Array) -> None:
    """Turns gravity about the world's x (0) or y (1) axis."""
    c = np.cos(magnitudes[0])
    s = np.sin(magnitudes[0])
    about_x = [[1, 0, 0], [0, c, -s], [0, s, c]]
    about_y = [[c, 0, s], [0, 1, 0], [-s, 0, c]]
    rotation = np.array(about_x if axis == 0 else about_y)
    model.opt.gravity[:] = rotation @ model.opt.gravity
