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


class FullGaussian(Family):
    """A Gaussian with any correlation matrix, not truncated.

    Where an entry of a draw is infeasible, the whole draw is made again.

    Parameters
    ----------
    space : ParameterSpace
        The d parameters.

    Attributes
    ----------
    max_partial : float
        Largest absolute partial correlation in the box of phi. At 1 the distribution is degenerate.

    Notes
    -----
    xi ~ N(mean, diag(scale) C diag(scale)). The correlation matrix C is given by canonical partial
    correlations: the unknown "partial.a.b" is the correlation of a and b given the parameters
    before a. Every point of the box of partial correlations is a correlation matrix.

    References
    ----------
    Lewandowski, Kurowicka and Joe (2009), "Generating random correlation matrices based on vines
    and extended onion method", Journal of Multivariate Analysis 100, section 2.4.
    """

    standard = NORMAL
    max_partial = 0.99

    def __init__(self, space: ParameterSpace):
        super().__init__(space)
        partials = [
            Parameter(f"partial.{a}.{b}", -self.max_partial, self.max_partial)
            for a, b in combinations(space.names, 2)
        ]
        self.unknowns = ParameterSpace((*means_and_scales(space), *partials))
        # where each z_ij stands in the vector (0, 1, partials)
        self._places = np.eye(len(space), dtype=np.int64)
        self._places.T[np.triu_indices(len(space), 1)] = 2 + np.arange(len(partials))

    def _draw(self, phi: Array, base: Array) -> Array:
        z = constant(NORMAL.quantile(base), phi)
        return self.mean(phi) + self.scale(phi) * (z @ self._factor(phi).T)

    def _infeasible(self, values: Array) -> NDArray[np.bool_]:
        xp = namespace(values)
        rows = xp.any(super()._infeasible(values), axis=1, keepdims=True)
        return xp.broadcast_to(rows, values.shape)

    def _factor(self, phi: Array) -> Array:
        """Returns the lower triangular factor L (d, d) of C = L L'.

        L_ij = z_ij sqrt(prod_{k < j} (1 - z_ik^2)), with z_ii = 1.
        """
        xp = namespace(phi)
        d = len(self.space)
        z = xp.concat([constant([0.0, 1.0], phi), phi[2 * d :]])[self._places]
        remaining = xp.cumulative_prod(xp.sqrt(1 - xp.tril(z, k=-1) ** 2), axis=1)
        ones = constant(np.ones((d, 1)), phi)
        factor: Array = z * xp.concat([ones, remaining[:, :-1]], axis=1)
        return factor

    def mean(self, phi: Array) -> Array:
        """Returns the mean (d,)."""
        return phi[: len(self.space)]

    def sd(self, phi: Array) -> Array:
        """Returns the standard deviation (d,), which is the scale."""
        return self.scale(phi)

    def correlation(self, phi: Array) -> Array:
        """Returns the correlation matrix C (d, d)."""
        factor = self._factor(phi)
        correlation: Array = factor @ factor.T
        return correlation

    def phi_of(self, mean: ArrayLike, covariance: ArrayLike) -> Array:
        """Returns the member with a given mean and covariance.

        Parameters
        ----------
        mean : (d,) array
            Mean of every parameter, in its own unit.
        covariance : (d, d) array
            Positive definite covariance matrix.

        Returns
        -------
        (m,) array
            phi. It may lie outside the bounds of `unknowns`, which limit a search only.

        Raises
        ------
        BadArgument
            If an array has another shape or is not finite, or the covariance is not positive
            definite.
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
        # sqrt(1 - sum_{k < j} L_ik^2), summed from the right to avoid cancellation
        remaining = np.sqrt(np.cumsum(factor[:, ::-1] ** 2, axis=1)[:, ::-1])
        z = np.divide(factor, remaining, out=np.zeros((d, d)), where=remaining > 0)
        partials = z.T[np.triu_indices(d, 1)]
        return np.concatenate([float_array("mean", mean, (d,), caller), sd, partials])
