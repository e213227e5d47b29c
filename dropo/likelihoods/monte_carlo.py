"""The thesis' likelihood: a Gaussian with the moments of K simulations."""

import math
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from dropo.core.contracts.sampled_likelihood import SampledLikelihood
from dropo.core.numerics.array_api import constant, namespace
from dropo.core.services.validation import Array, require
from dropo.likelihoods.support.sample_moments import (
    cholesky_rows,
    log_determinant,
    sample_moments,
    square_distance,
)


@dataclass(frozen=True)
class MonteCarlo(SampledLikelihood):
    """A Gaussian for each row, with the moments of the predictions of K draws.

    Attributes
    ----------
    draws : int
        K. With few draws the density is biased; that of `GhuryeOlkin` is not.
    degrees : float, optional
        Degrees of freedom, above 2, of a multivariate Student t in the Gaussian's place, with the
        same covariance S [2]_.

    Raises
    ------
    BadArgument
        If `degrees` is not above 2, or a setting breaks a rule of `SampledLikelihood`.

    Notes
    -----
    log N(y; m, S), where m and Cov are the mean and unbiased covariance of the predictions and
    S = Cov + diag(epsilon) [1]_, with log|S| = 2 sum_i log L_ii; the logarithm is missing in the
    thesis' text.

    References
    ----------
    .. [1] Tiboni 2021, eq. 5.3 to 5.5.
    .. [2] Kotz, Nadarajah, "Multivariate t distributions and their applications", 2004, eq. 1.1.
    """

    degrees: float | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        valid = self.degrees is None or self.degrees > 2
        require(valid, "degrees", "above 2, to have a covariance", self.degrees, "MonteCarlo")

    def with_degrees(self, degrees: float) -> Self:
        """Return the same likelihood with a Student t of so many degrees of freedom."""
        return replace(self, degrees=degrees)

    def _log_density(
        self, predictions: Array, targets: Array, epsilon: Array, noise: Array | None
    ) -> Array:
        xp = namespace(predictions)
        p = targets.shape[1]
        largest_rank = len(predictions) - 1 + int(xp.count_nonzero(epsilon))
        if largest_rank < p:
            return xp.full_like(targets[:, 0], np.nan)
        mean, covariance = sample_moments(predictions)
        factor = cholesky_rows(covariance + epsilon * constant(np.eye(p), covariance))  # eq. 5.3
        kernel = self._log_kernel(square_distance(factor, targets - mean), p)
        density: Array = kernel - 0.5 * log_determinant(factor)  # eq. 5.5
        return density

    def _log_kernel(self, square: Array, p: int) -> Array:
        """(R,) log densities of squared distances r' S^-1 r in p dimensions, but for log|S|."""
        if self.degrees is None:
            return -0.5 * (p * math.log(2 * math.pi) + square)
        # S is degrees / scale times the matrix in the t's own formula.
        half = self.degrees / 2
        scale = self.degrees - 2
        peak = math.lgamma(half + p / 2) - math.lgamma(half) - 0.5 * p * math.log(math.pi * scale)
        kernel: Array = peak - (half + p / 2) * namespace(square).log1p(square / scale)
        return kernel
