"""Independent uniform distributions."""

import numpy as np

from dropo.core.contracts.family import Family, means_and_scales
from dropo.core.numerics.array_api import constant
from dropo.core.numerics.standard_distributions import UNIFORM
from dropo.core.records.parameters import ParameterSpace
from dropo.core.services.validation import Array


class Uniform(Family):
    """xi_i uniform on mean_i -+ scale_i: the scale is the half width, sd = scale / sqrt(3)."""

    standard = UNIFORM

    def __init__(self, space: ParameterSpace):
        super().__init__(space)
        self.unknowns = means_and_scales(space)

    def _draw(self, phi: Array, base: Array) -> Array:
        return self.mean(phi) + self.scale(phi) * constant(UNIFORM.quantile(base), phi)

    def mean(self, phi: Array) -> Array:
        return phi[: len(self.space)]

    def sd(self, phi: Array) -> Array:
        return self.scale(phi) / float(np.sqrt(3))
