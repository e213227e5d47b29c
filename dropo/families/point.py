"""A point estimate as a distribution: a single value of every parameter."""

import numpy as np
from numpy.typing import ArrayLike

from dropo.core.contracts.family import Family
from dropo.core.numerics.array_api import constant, namespace
from dropo.core.numerics.standard_distributions import NORMAL
from dropo.core.records.parameters import Parameter, ParameterSpace
from dropo.core.services.validation import Array


class Point(Family):
    """A distribution without spread: all draws equal the mean, and there is no scale to find.

    Parameters
    ----------
    space : ParameterSpace
        The d parameters.
    """

    standard = NORMAL

    def __init__(self, space: ParameterSpace):
        super().__init__(space)
        self.unknowns = ParameterSpace(
            tuple(Parameter(f"mean.{p.name}", p.low, p.high, p.unit) for p in space)
        )

    def _draw(self, phi: Array, base: Array) -> Array:
        return phi + constant(np.zeros(base.shape), phi)

    def mean(self, phi: Array) -> Array:
        """Returns the mean (d,), which is phi."""
        return phi

    def sd(self, phi: Array) -> Array:
        """Returns the standard deviation (d,), which is 0."""
        return namespace(phi).zeros_like(phi)

    def scale(self, phi: Array) -> Array:
        """Returns the scale (d,), which is 0."""
        return self.sd(phi)

    def phi(self, mean: ArrayLike, scale: ArrayLike | None = None) -> Array:
        """Returns the member (m,) with the mean (d,), clipped to its bounds; scale is ignored."""
        return self.unknowns.clip(mean)
