"""One-dimensional distributions that families map affinely, and their orthonormal polynomials."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.special import ndtr, roots_hermitenorm, roots_legendre

from dropo.core.numerics.array_api import is_tensor, namespace, ndtri
from dropo.core.services.validation import Array

NODES = 64
"""Nodes of each Gauss rule."""


@dataclass(frozen=True, eq=False)
class StandardDistribution:
    """A one-dimensional distribution without parameters.

    Attributes
    ----------
    quantile : callable
        Maps (0, 1) to the distribution's values, array or tensor.
    nodes, weights : (Q,) array
        Its Gauss rule; the weights sum to 1.
    """

    quantile: Callable[[Array], Array]
    nodes: Array
    weights: Array

    @cached_property
    def _recurrence(self) -> tuple[Array, Array]:
        """Coefficients of the three-term recurrence, by the Stieltjes procedure on the rule.

        See Gautschi, Orthogonal Polynomials (2004), section 2.2.
        """
        a = np.zeros(NODES // 2)
        b = np.ones(NODES // 2)
        before = np.zeros_like(self.nodes)
        now = np.ones_like(self.nodes)
        for k in range(len(a) - 1):
            a[k] = self.weights @ (self.nodes * now**2)
            after = (self.nodes - a[k]) * now - b[k] * before
            b[k + 1] = np.sqrt(self.weights @ after**2)
            before = now
            now = after / b[k + 1]
        return a, b

    def orthonormal(self, x: Array, degree: int) -> Array:
        """Evaluate the orthonormal polynomials up to a degree.

        Parameters
        ----------
        x : (...,) array
            Where, array or tensor.
        degree : int
            The highest degree.

        Returns
        -------
        (..., degree + 1) array
            Those of degree 0, 1, ..., degree.
        """
        xp = namespace(x)
        a, b = self._recurrence
        first = xp.ones_like(x) if is_tensor(x) else np.ones(np.shape(x))
        out = [first, (x - a[0]) / b[1]]
        for k in range(1, degree):
            out.append(((x - a[k]) * out[k] - b[k] * out[k - 1]) / b[k + 1])
        if is_tensor(x):
            stacked: Array = xp.stack(out[: degree + 1], axis=-1)
            return stacked
        found = np.empty((*np.shape(x), degree + 1))  # as np.stack, at half its cost
        for k in range(degree + 1):
            found[..., k] = out[k]
        return found


def _normal() -> StandardDistribution:
    """The standard normal distribution."""
    nodes, weights = roots_hermitenorm(NODES)
    return StandardDistribution(ndtri, nodes, weights / weights.sum())


def _uniform() -> StandardDistribution:
    """The uniform distribution on [-1, 1]."""
    nodes, weights = roots_legendre(NODES)
    return StandardDistribution(lambda base: 2 * base - 1, nodes, weights / 2)


def _truncated_normal(cut: float) -> StandardDistribution:
    """A standard normal given |x| <= cut."""
    nodes, weights = roots_legendre(NODES)
    density = weights * np.exp(-((cut * nodes) ** 2) / 2)
    tail = float(ndtr(-cut))
    return StandardDistribution(
        lambda base: ndtri(tail + (1 - 2 * tail) * base), cut * nodes, density / density.sum()
    )


NORMAL = _normal()
UNIFORM = _uniform()
TRUNCATED_NORMAL = _truncated_normal(2.0)
