"""The unit box as the whole real space, on which Pyro's samplers work."""

from typing import Any

import numpy as np
from scipy.special import ndtr, ndtri

from dropo.core.contracts.sampler import Density, first_positions
from dropo.core.numerics.array_api import constant, plain
from dropo.core.services.validation import Array

EDGE = 1e-3
"""Distance of the coordinates' origin from the ends of the box, where the map is flat."""


class RealLine:
    """A density over the unit box, as one over w in R^d.

    A constant density on the box is normal in w.

    Parameters
    ----------
    density : callable
        (W, d) -> (W, 1 + d): log densities over the box, and their gradients behind them.
    start, spread : (d,) array
        Middle and width of the region of the box where |w| is about 1.

    Attributes
    ----------
    origin, scale : (d,) array
        Coefficients of the map.

    Notes
    -----
    u = Phi(origin + scale w), with the standard normal distribution function Phi.
    """

    def __init__(self, density: Density, start: Array, spread: Array):
        self.density = density
        self.start = start
        self.spread = spread
        self.origin = ndtri(np.clip(start, EDGE, 1 - EDGE))
        self.scale = np.minimum(spread / _normal(self.origin), 1.0)

    def unit(self, w: Array) -> Array:
        """Return points of the unit box.

        Parameters
        ----------
        w : (..., d) array
            Points on the real line.

        Returns
        -------
        (..., d) array
            In (0, 1).
        """
        return np.asarray(ndtr(self.origin + self.scale * w))

    def head(self, rng: np.random.Generator, count: int) -> Array:
        """Returns first positions on the real line, where the density is positive.

        Parameters
        ----------
        rng : numpy.random.Generator
            Source of the random positions.
        count : int
            Number W of positions.

        Returns
        -------
        (W, d) array
            Positions w around the start.

        Raises
        ------
        BadArgument
            If no position of positive density is found around the start.
        """
        points, _ = first_positions(
            lambda u: self.density(u)[:, 0], rng, self.start, self.spread, count
        )
        return (ndtri(np.clip(points, 1e-9, 1 - 1e-9)) - self.origin) / self.scale

    def log_density(self, w: Any) -> Any:
        """Returns log p(u) + log |du/dw| up to a constant, with its gradient for autograd.

        Parameters
        ----------
        w : (..., d) torch.Tensor
            Points on the real line.

        Returns
        -------
        (...,) torch.Tensor
            Log densities.
        """
        z = self.origin + self.scale * plain(w).reshape(-1, len(self.origin))
        answers = self.density(ndtr(z))
        values = answers[:, 0] - 0.5 * (z**2).sum(axis=1)
        gradients = (answers[:, 1:] * _normal(z) - z) * self.scale
        # a tensor that is 0 and has the right derivative
        tangent = constant(gradients.reshape(w.shape), w) * (w - w.detach())
        return constant(values.reshape(w.shape[:-1]), w) + tangent.sum(-1)


def _normal(z: Array) -> Array:
    """Returns the standard normal density."""
    return np.exp(-0.5 * z**2) / np.sqrt(2 * np.pi)
