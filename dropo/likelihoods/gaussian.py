"""The thesis' likelihood: a Gaussian with the moments of K simulations."""

from dataclasses import dataclass

import numpy as np

from dropo.core.checks import Array
from dropo.core.sampled_likelihood import SampledLikelihood

BLOCK = 4_000_000  # numbers of predictions in one block of rows: 32 MB, whatever K and R are


@dataclass(frozen=True)
class Gaussian(SampledLikelihood):
    """log N(y; m, S), where m and Cov are the mean and unbiased covariance of K predictions and S = Cov + diag(epsilon).

    Thesis, eq. 5.3 to 5.5, with log|S| = 2 sum_i log L_ii (the logarithm is missing in its text). With few draws the density is
    biased; that of `GhuryeOlkin` is not.
    """

    def _log_density(self, predictions: Array, targets: Array, epsilon: Array, noise: Array | None) -> Array:
        p = targets.shape[1]
        if len(predictions) - 1 + np.count_nonzero(epsilon) < p:  # the most that the rank of S can be
            return np.full(len(targets), np.nan)
        mean, covariance = sample_moments(predictions)
        factor = cholesky_rows(covariance + epsilon * np.eye(p))  # eq. 5.3
        density: Array = -0.5 * (p * np.log(2 * np.pi) + log_determinant(factor) + square_distance(factor, targets - mean))  # eq. 5.5
        return density


def sample_moments(samples: Array) -> tuple[Array, Array]:
    """Mean (R, p) and unbiased covariance (R, p, p) over K samples (K, R, p) (thesis, eq. 5.4), by blocks of rows."""
    k, rows, p = samples.shape
    mean, covariance = np.empty((rows, p)), np.empty((rows, p, p))
    size = max(1, BLOCK // (k * p))
    for first in range(0, rows, size):
        block = np.moveaxis(samples[:, first : first + size], 0, 1)  # (rows of the block, K, p)
        mean[first : first + size] = block.mean(axis=1)
        centred = block - mean[first : first + size, None]
        covariance[first : first + size] = np.swapaxes(centred, 1, 2) @ centred / (k - 1)
    return mean, covariance


def cholesky_rows(covariance: Array) -> Array:
    """Lower factors L (R, p, p) of R covariances; NaN where one is singular, as far as rounding lets tell."""
    try:
        factor = np.linalg.cholesky(covariance).astype(float, copy=False)
    except np.linalg.LinAlgError:
        factor = np.array([_factor_or_nan(row) for row in covariance])
    pivots, variances = np.diagonal(factor, axis1=1, axis2=2) ** 2, np.diagonal(covariance, axis1=1, axis2=2)
    rounding = 4 * covariance.shape[1] * np.finfo(float).eps  # a pivot below this share of its variance is a rounding error
    factor[(pivots <= rounding * variances).any(axis=1)] = np.nan
    return factor


def _factor_or_nan(covariance: Array) -> Array:
    try:
        return np.linalg.cholesky(covariance).astype(float, copy=False)
    except np.linalg.LinAlgError:
        return np.full_like(covariance, np.nan)


def log_determinant(factor: Array) -> Array:
    """(R,) log|L L'| from lower factors (R, p, p)."""
    total: Array = 2 * np.log(np.diagonal(factor, axis1=1, axis2=2)).sum(axis=1)
    return total


def square_distance(factor: Array, residual: Array) -> Array:
    """(R,) r' (L L')^-1 r of residuals (R, p): the square of L^-1 r, by forward substitution in all rows at once."""
    white = np.zeros_like(residual)
    for i in range(residual.shape[1]):
        white[:, i] = (residual[:, i] - (factor[:, i, :i] * white[:, :i]).sum(axis=1)) / factor[:, i, i]
    total: Array = (white**2).sum(axis=1)
    return total
