"""The thesis' likelihood: a Gaussian with the moments of K simulations."""

import math
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from dropo.core.contracts.sampled_likelihood import SampledLikelihood
from dropo.core.numerics.array_api import cholesky, constant, namespace
from dropo.core.services.validation import Array, require

BLOCK = 4_000_000  # numbers of predictions in one block of rows: 32 MB, whatever K and R are


@dataclass(frozen=True)
class Gaussian(SampledLikelihood):
    """log N(y; m, S), where m and Cov are the mean and unbiased covariance of K predictions and S =
    Cov + diag(epsilon).

    Thesis, eq. 5.3 to 5.5, with log|S| = 2 sum_i log L_ii (the logarithm is missing in its text).
    With few draws the density is biased; that of `GhuryeOlkin` is not. degrees: None, or a
    multivariate Student t of so many degrees of freedom and the same covariance S in the Gaussian's
    place (Kotz, Nadarajah 2004, Multivariate t Distributions, eq. 1.1).
    """

    degrees: float | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        require(
            self.degrees is None or self.degrees > 2,
            "degrees",
            "above 2, to have a covariance",
            self.degrees,
            "Gaussian",
        )

    def with_degrees(self, degrees: float) -> Self:
        return replace(self, degrees=degrees)

    def _log_density(
        self, predictions: Array, targets: Array, epsilon: Array, noise: Array | None
    ) -> Array:
        xp = namespace(predictions)
        p = targets.shape[1]
        if (
            len(predictions) - 1 + int(xp.count_nonzero(epsilon)) < p
        ):  # the most that the rank of S can be
            return xp.full_like(targets[:, 0], np.nan)
        mean, covariance = sample_moments(predictions)
        factor = cholesky_rows(covariance + epsilon * constant(np.eye(p), covariance))  # eq. 5.3
        density: Array = self._log_kernel(
            square_distance(factor, targets - mean), p
        ) - 0.5 * log_determinant(factor)  # eq. 5.5
        return density

    def _log_kernel(self, square: Array, p: int) -> Array:
        """(R,) the log density of squared distances r' S^-1 r in p dimensions, without the
        determinant.
        """
        if self.degrees is None:
            return -0.5 * (p * math.log(2 * math.pi) + square)
        # S is degrees / scale times the matrix in the t's own formula
        half = self.degrees / 2
        scale = self.degrees - 2
        peak = math.lgamma(half + p / 2) - math.lgamma(half) - 0.5 * p * math.log(math.pi * scale)
        kernel: Array = peak - (half + p / 2) * namespace(square).log1p(square / scale)
        return kernel


def sample_moments(samples: Array) -> tuple[Array, Array]:
    """Mean (R, p) and unbiased covariance (R, p, p) over K samples (K, R, p) (thesis, eq. 5.4), by
    blocks of rows.
    """
    xp = namespace(samples)
    (k, rows, p) = samples.shape
    size = max(1, BLOCK // (k * p))
    means = []
    covariances = []
    for first in range(0, rows, size):
        block = xp.moveaxis(samples[:, first : first + size], 0, 1)  # (rows of the block, K, p)
        means.append(xp.mean(block, axis=1))
        centred = block - means[-1][:, None]
        covariances.append(xp.matrix_transpose(centred) @ centred / (k - 1))
    return xp.concat(means), xp.concat(covariances)


def cholesky_rows(covariance: Array) -> Array:
    """Lower factors L (R, p, p) of R covariances; NaN where one is singular, as far as rounding
    lets tell.
    """
    xp = namespace(covariance)
    factor = cholesky(covariance)
    rounding = (
        4 * covariance.shape[1] * np.finfo(float).eps
    )  # a pivot below this share of its variance is a rounding error
    lost = xp.linalg.diagonal(factor) ** 2 <= rounding * xp.linalg.diagonal(covariance)
    good: Array = xp.where(xp.any(lost, axis=1)[:, None, None], np.nan, factor)
    return good


def log_determinant(factor: Array) -> Array:
    """(R,) log|L L'| from lower factors (R, p, p)."""
    xp = namespace(factor)
    total: Array = 2 * xp.sum(xp.log(xp.linalg.diagonal(factor)), axis=1)
    return total


def square_distance(factor: Array, residual: Array) -> Array:
    """(R,) r' (L L')^-1 r of residuals (R, p): the square of L^-1 r, by forward substitution in all
    rows at once.
    """
    total = 0.0 * residual[:, 0]
    for i in range(residual.shape[1]):
        white = residual[:, i] / factor[:, i, i]
        residual = residual - white[:, None] * factor[:, :, i]
        total = total + white**2
    return total
