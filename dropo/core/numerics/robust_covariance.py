"""Standard errors that hold where rows depend on each other or the model is not quite right."""

import numpy as np

from dropo.core.numerics.dependence import Units, variance_of_sum
from dropo.core.services.validation import Array

SINGULAR = 1e-14
"""Smallest eigenvalue of the scaled information; smaller ones are rounding."""


def sandwich(scores: Array, information: Array, units: Units) -> tuple[Array, Array]:
    """Estimate the covariance H^-1 V H^-1 of a maximum-likelihood estimate.

    V is the covariance of the scores' sum, by `variance_of_sum`, from each unknown's own influence
    H^-1 u.

    Parameters
    ----------
    scores : (R, m) array
        Score of each row.
    information : (m, m) array
        H, the Fisher information.
    units : Units
        Which rows depend on each other.

    Returns
    -------
    covariance : (m, m) array
        NaN for unknowns on which the data have no information. Directions without information get
        a huge variance, which a pseudo-inverse would hide.
    degrees : (m,) array
        Degrees of freedom of the standard errors; NaN likewise.
    """
    size = np.sqrt(np.diagonal(information))
    good = size > 0
    block = np.ix_(good, good)
    scale = np.outer(size[good], size[good])
    values, vectors = np.linalg.eigh(information[block] / scale)
    inverse = (vectors / np.maximum(values, SINGULAR)) @ vectors.T / scale
    covariance = np.full(information.shape, np.nan)
    degrees = np.full(len(information), np.nan)
    covariance[block], degrees[good] = variance_of_sum(scores[:, good] @ inverse, units)
    return covariance, degrees
