"""Spread and weights that a few very large errors do not move."""

import numpy as np
from scipy.special import gammaln

from dropo.core.services.validation import Array

NORMAL = 1.4826
"""Standard deviations in the median distance from the centre of normal numbers."""


def deviation(errors: Array) -> Array:
    """Estimate the standard deviation of errors about 0, were they normal, by their median size.

    Parameters
    ----------
    errors : (n, p) array
        Errors; rows of NaN count for nothing.

    Returns
    -------
    (p,) array
        NaN of columns of NaN alone, and where there are no rows.
    """
    if not len(errors):
        return np.full(errors.shape[1:], np.nan)
    count = np.count_nonzero(~np.isnan(errors), axis=0)
    if np.all(count == len(errors)):
        return np.asarray(NORMAL * np.median(np.abs(errors), axis=0))
    # NaN come last.
    sizes = np.sort(np.abs(errors), axis=0)
    lower, upper = (
        np.take_along_axis(sizes, middle[np.newaxis], axis=0)[0]
        for middle in ((count - 1) // 2, count // 2)
    )
    return np.asarray(NORMAL * (lower + upper) / 2)


def student_t_weights(squares: Array, size: int, degrees: float) -> Array:
    """Weigh vectors by how well they fit, as the likelihood of a multivariate Student t does.

    Parameters
    ----------
    squares : (n,) array
        Squared Mahalanobis lengths.
    size : int
        Numbers in each vector.
    degrees : float
        Degrees of freedom.

    Returns
    -------
    (n,) array
        (degrees + size) / (degrees + squares).
    """
    return np.asarray((degrees + size) / (degrees + squares))


def student_t_log_density(squares: Array, size: int, degrees: float) -> Array:
    """Evaluate a multivariate Student t whose scale matrix has the determinant one.

    Parameters
    ----------
    squares : array
        Squared Mahalanobis lengths.
    size : int
        Numbers in each vector.
    degrees : float
        Degrees of freedom.

    Returns
    -------
    array
        Log densities [nats], of the shape of `squares`.
    """
    constant = (
        gammaln((degrees + size) / 2) - gammaln(degrees / 2) - 0.5 * size * np.log(degrees * np.pi)
    )
    return np.asarray(constant - 0.5 * (degrees + size) * np.log1p(squares / degrees))
