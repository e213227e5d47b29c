"""Independent uniform distributions."""

import numpy as np

from dropo.core.contracts.family import Family, means_and_scales
from dropo.core.numerics.array_api import constant
from dropo.core.numerics.standard_distributions import UNIFORM
from dropo.core.records.parameters import ParameterSpace
from dropo.core.services.validation import Array


class Uniform(Family):
    """Independent uniform distributions around their means.

    Parameters
    ----------
    space : ParameterSpace
        The d parameters.

    Notes
    -----
    xi_i is uniform on [mean_i - scale_i, mean_i + scale_i]: the scale is half the width, and
    sd = scale / sqrt(3).
    """

    standard = UNIFORM

    def __init__(self, space: ParameterSpace):
        super().__init__(space)
        self.unknowns = means_and_scales(space)

    def _draw(self, phi: Array, base: Array) -> Array:
        return self.mean(phi) + self.scale(phi) * constant(UNIFORM.quantile(base), phi)

    def mean(self, phi: Array) -> Array:
        """Returns the mean (d,), the middle of the interval."""
        return phi[: len(self.space)]

    def sd(self, phi: Array) -> Array:
        """Returns the standard deviation (d,)."""
        return self.scale(phi) / float(np.sqrt(3))
