"""Moments of samples in every row, and Gaussian densities by Cholesky factors, on any arrays."""

import numpy as np

from dropo.core.numerics.array_api import cholesky, namespace
from dropo.core.services.validation import Array

BLOCK = 4_000_000  # numbers of predictions in one block of rows: 32 MB, whatever K and R are


def sample_moments(samples: Array) -> tuple[Array, Array]:
    """Find mean and unbiased covariance of each row over samples, by blocks of rows.

    Parameters
    ----------
    samples : (K, R, p) array or tensor

    Returns
    -------
    mean : (R, p) array or tensor
    covariance : (R, p, p) array or tensor

    References
    ----------
    Tiboni 2021, eq. 5.4.
    """
    xp = namespace(samples)
    k, rows, p = samples.shape
    size = max(1, BLOCK // (k * p))
    means = []
    covariances = []
    for first in range(0, rows, size):
        block = xp.moveaxis(samples[:, first : first + size], 0, 1)  # (rows of the block, K, p)
        mean = xp.mean(block, axis=1)
        centred = block - mean[:, None]
        means.append(mean)
        covariances.append(xp.matrix_transpose(centred) @ centred / (k - 1))
    return xp.concat(means), xp.concat(covariances)


def cholesky_rows(covariance: Array) -> Array:
    """Factorize covariances.

    Parameters
    ----------
    covariance : (R, p, p) array or tensor

    Returns
    -------
    (R, p, p) array or tensor
        Lower factors; NaN if a covariance is singular, as far as rounding lets one see.
    """
    xp = namespace(covariance)
    factor = cholesky(covariance)
    # A pivot below this fraction of its variance is a rounding error.
    rounding = 4 * covariance.shape[1] * np.finfo(float).eps
    pivots = xp.linalg.diagonal(factor) ** 2
    lost = pivots <= rounding * xp.linalg.diagonal(covariance)
    good: Array = xp.where(xp.any(lost, axis=1)[:, None, None], np.nan, factor)
    return good


def log_determinant(factor: Array) -> Array:
    """Find log|L L'| of lower factors.

    Parameters
    ----------
    factor : (R, p, p) array or tensor

    Returns
    -------
    (R,) array or tensor
    """
    xp = namespace(factor)
    total: Array = 2 * xp.sum(xp.log(xp.linalg.diagonal(factor)), axis=1)
    return total


def square_distance(factor: Array, residual: Array) -> Array:
    """Find r' (L L')^-1 r by forward substitution in all rows at once.

    Parameters
    ----------
    factor : (R, p, p) array or tensor
        Lower factors L.
    residual : (R, p) array or tensor

    Returns
    -------
    (R,) array or tensor
    """
    total = 0.0 * residual[:, 0]
    for i in range(residual.shape[1]):
        whitened = residual[:, i] / factor[:, i, i]
        residual = residual - whitened[:, None] * factor[:, :, i]
        total = total + whitened**2
    return total
