"""The thesis' family: independent Gaussians, each cut at two standard deviations."""

import numpy as np
from scipy.special import ndtr

from dropo.core.contracts.family import Family, means_and_scales
from dropo.core.numerics.array_api import constant
from dropo.core.numerics.standard_distributions import TRUNCATED_NORMAL
from dropo.core.records.parameters import ParameterSpace
from dropo.core.services.validation import Array

CUT = 2.0  # [sigma], thesis, section 5.3
SD = float(
    np.sqrt(1 - 2 * CUT * np.exp(-(CUT**2) / 2) / np.sqrt(2 * np.pi) / (1 - 2 * ndtr(-CUT)))
)  # 0.8796, of sigma = 1


class TruncatedGaussian(Family):
    """xi_i ~ N(mean_i, scale_i^2) given |xi_i - mean_i| <= 2 scale_i (thesis, section 5.3); the
    scale is sigma, sd = 0.8796 sigma.
    """

    standard = TRUNCATED_NORMAL

    def __init__(self, space: ParameterSpace):
        super().__init__(space)
        self.unknowns = means_and_scales(space)

    def _draw(self, phi: Array, base: Array) -> Array:
        return self.mean(phi) + self.scale(phi) * constant(TRUNCATED_NORMAL.quantile(base), phi)

    def mean(self, phi: Array) -> Array:
        return phi[: len(self.space)]

    def sd(self, phi: Array) -> Array:
        return SD * self.scale(phi)
