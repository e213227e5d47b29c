"""The thesis' family: independent Gaussians, each truncated at two standard deviations."""

import numpy as np
from scipy.special import ndtr

from dropo.core.contracts.family import Family, means_and_scales
from dropo.core.numerics.array_api import constant
from dropo.core.numerics.standard_distributions import TRUNCATED_NORMAL
from dropo.core.records.parameters import ParameterSpace
from dropo.core.services.validation import Array

CUT = 2.0
"""Where the Gaussians are truncated, in sigma (thesis, section 5.3)."""

_DENSITY_AT_CUT = np.exp(-(CUT**2) / 2) / np.sqrt(2 * np.pi)
SD = float(np.sqrt(1 - 2 * CUT * _DENSITY_AT_CUT / (1 - 2 * ndtr(-CUT))))
"""Standard deviation of the truncated Gaussian with sigma = 1: 0.8796."""


class TruncatedGaussian(Family):
    """Independent truncated Gaussians.

    Parameters
    ----------
    space : ParameterSpace
        The d parameters.

    Notes
    -----
    xi_i ~ N(mean_i, scale_i^2) given |xi_i - mean_i| <= 2 scale_i (thesis, section 5.3). The scale
    is sigma before truncation, so that sd = 0.8796 scale.
    """

    standard = TRUNCATED_NORMAL

    def __init__(self, space: ParameterSpace):
        super().__init__(space)
        self.unknowns = means_and_scales(space)

    def _draw(self, phi: Array, base: Array) -> Array:
        return self.mean(phi) + self.scale(phi) * constant(TRUNCATED_NORMAL.quantile(base), phi)

    def mean(self, phi: Array) -> Array:
        """Returns the mean (d,)."""
        return phi[: len(self.space)]

    def sd(self, phi: Array) -> Array:
        """Returns the standard deviation (d,) after truncation, below the scale."""
        return SD * self.scale(phi)
