"""The unit box as the whole real space, where Pyro's samplers move."""

from typing import Any

import numpy as np
from scipy.special import ndtr, ndtri

from dropo.core.contracts.sampler import Density, first_positions
from dropo.core.numerics.array_api import constant, plain
from dropo.core.services.validation import Array

EDGE = 1e-3  # the coordinates' origin keeps this far from the box' ends, where the map is flat


class RealLine:
    """A density over the unit box as one over w in R^d, with u = Phi(origin + scale w): flat on the
    box is normal in w.

    density: (W, d) -> (W, 1 + d), values and gradients over the box; start, spread: (d,), where |w|
    is about 1.
    """

    def __init__(self, density: Density, start: Array, spread: Array):
        self.density = density
        self.start = start
        self.spread = spread
        self.origin = ndtri(np.clip(start, EDGE, 1 - EDGE))
        self.scale = np.minimum(spread / _normal(self.origin), 1.0)

    def unit(self, w: Array) -> Array:
        """Points of the unit box (..., d) at w (..., d)."""
        return np.asarray(ndtr(self.origin + self.scale * w))

    def head(self, rng: np.random.Generator, count: int) -> Array:
        """(W, d) so many positions around the start, where the density is positive."""
        points, _ = first_positions(
            lambda u: self.density(u)[:, 0], rng, self.start, self.spread, count
        )
        return (ndtri(np.clip(points, 1e-9, 1 - 1e-9)) - self.origin) / self.scale

    def log_density(self, w: Any) -> Any:
        """(...,) at a tensor w (..., d), up to a constant: log p(u) + log |du/dw|; its gradient is
        known to autograd.
        """
        z = self.origin + self.scale * plain(w).reshape(-1, len(self.origin))
        answers = self.density(ndtr(z))
        values = answers[:, 0] - 0.5 * (z**2).sum(axis=1)
        gradients = (answers[:, 1:] * _normal(z) - z) * self.scale
        tangent = constant(gradients.reshape(w.shape), w) * (
            w - w.detach()
        )  # 0, with the right derivative
        return constant(values.reshape(w.shape[:-1]), w) + tangent.sum(-1)


def _normal(z: Array) -> Array:
    """The standard normal density."""
    return np.exp(-0.5 * z**2) / np.sqrt(2 * np.pi)
