"""A family as in a package of one's own, which computes with SciPy."""

import math

from scipy.stats import triang

from dropo.core.contracts.family import Family, means_and_scales


class Triangle(Family):
    """Symmetric triangles on mean -+ scale, sd = scale / sqrt(6)."""

    def __init__(self, space):
        super().__init__(space)
        self.unknowns = means_and_scales(space)

    def _draw(self, phi, base):
        return self.mean(phi) + self.scale(phi) * (2 * triang.ppf(base, 0.5) - 1)

    def mean(self, phi):
        return phi[: len(self.space)]

    def sd(self, phi):
        return self.scale(phi) / math.sqrt(6)
