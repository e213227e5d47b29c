"""Gaussians with any correlation matrix."""

from itertools import combinations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dropo.core.contracts.family import Family, means_and_scales
from dropo.core.numerics.array_api import constant, namespace
from dropo.core.numerics.standard_distributions import NORMAL
from dropo.core.records.parameters import Parameter, ParameterSpace
from dropo.core.services.errors import BadArgument
from dropo.core.services.validation import Array, float_array

PARTIAL = 0.99  # the largest partial correlation that a search reaches: at 1 the law is degenerate


class FullGaussian(Family):
    """xi ~ N(mean, diag(scale) C diag(scale)); not truncated.

    Where an entry of a draw is infeasible, the whole draw is made again.

    The correlation matrix C is given by canonical partial correlations: "partial.a.b" is the
    correlation of a and b given the parameters before a. Every point of their box is a correlation
    matrix (Lewandowski, Kurowicka, Joe 2009, J. Multivariate Analysis 100, section 2.4).
    """

    standard = NORMAL

    def __init__(self, space: ParameterSpace):
        super().__init__(space)
        partials = [
            Parameter(f"partial.{a}.{b}", -PARTIAL, PARTIAL)
            for a, b in combinations(space.names, 2)
        ]
        self.unknowns = ParameterSpace((*means_and_scales(space), *partials))
        self._places = np.eye(len(space), dtype=np.int64)  # of z_ij in (0, 1, partials)
        self._places.T[np.triu_indices(len(space), 1)] = 2 + np.arange(len(partials))

    def _draw(self, phi: Array, base: Array) -> Array:
        return self.mean(phi) + self.scale(phi) * (
            constant(NORMAL.quantile(base), phi) @ self._factor(phi).T
        )

    def _infeasible(self, values: Array) -> NDArray[np.bool_]:
        xp = namespace(values)
        return xp.broadcast_to(
            xp.any(super()._infeasible(values), axis=1, keepdims=True), values.shape
        )

    def _factor(self, phi: Array) -> Array:
        """L (d, d), lower triangular, of C = L L': L_ij = z_ij sqrt(prod_{k < j} (1 - z_ik^2)),
        with z_ii = 1.
        """
        xp = namespace(phi)
        d = len(self.space)
        z = xp.concat([constant([0.0, 1.0], phi), phi[2 * d :]])[self._places]
        left = xp.cumulative_prod(xp.sqrt(1 - xp.tril(z, k=-1) ** 2), axis=1)
        factor: Array = z * xp.concat([constant(np.ones((d, 1)), phi), left[:, :-1]], axis=1)
        return factor

    def mean(self, phi: Array) -> Array:
        return phi[: len(self.space)]

    def sd(self, phi: Array) -> Array:
        return self.scale(phi)

    def correlation(self, phi: Array) -> Array:
        factor = self._factor(phi)
        correlation: Array = factor @ factor.T
        return correlation

    def phi_of(self, mean: ArrayLike, covariance: ArrayLike) -> Array:
        """The member (m,) of that mean (d,) and covariance (d, d), positive definite; the bounds of
        phi are those of a search.
        """
        d = len(self.space)
        caller = "FullGaussian.phi_of"
        covariance = float_array("covariance", covariance, (d, d), caller)
        try:
            factor = np.linalg.cholesky(covariance)
        except np.linalg.LinAlgError:
            raise BadArgument(
                f"The 'covariance' of {caller} must be positive definite. Got "
                f"{covariance.tolist()!r} instead."
            ) from None
        sd = np.sqrt(np.diagonal(covariance))
        factor = factor / sd[:, None]
        left = np.sqrt(
            np.cumsum(factor[:, ::-1] ** 2, axis=1)[:, ::-1]
        )  # sqrt(1 - sum_{k < j} L_ik^2), without cancellation
        z = np.divide(factor, left, out=np.zeros((d, d)), where=left > 0)
        return np.concatenate(
            [float_array("mean", mean, (d,), caller), sd, z.T[np.triu_indices(d, 1)]]
        )
