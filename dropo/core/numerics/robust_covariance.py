"""Standard errors that hold where rows depend on each other or the model is not quite right."""

import numpy as np

from dropo.core.numerics.dependence import Units, variance_of_sum
from dropo.core.services.validation import Array

SINGULAR = 1e-14  # of the largest eigenvalue of the scaled information


def sandwich(scores: Array, information: Array, units: Units) -> tuple[Array, Array]:
    """Covariance (m, m) of the estimate from scores (R, m), H^-1 V H^-1, and degrees of freedom
    (m,) of its standard errors.

    V: the covariance of the scores' sum, by `variance_of_sum`, from each unknown's own influence
    H^-1 u. Unknowns that the data do not inform at all are NaN; directions without information get
    a huge variance, which a pseudo-inverse would hide.
    """
    size = np.sqrt(np.diagonal(information))
    good = size > 0
    scaled = information[np.ix_(good, good)] / np.outer(size[good], size[good])
    values, vectors = np.linalg.eigh(scaled)
    inverse = (
        (vectors / np.maximum(values, SINGULAR)) @ vectors.T / np.outer(size[good], size[good])
    )
    covariance = np.full(information.shape, np.nan)
    degrees = np.full(len(information), np.nan)
    covariance[np.ix_(good, good)], degrees[good] = variance_of_sum(
        scores[:, good] @ inverse, units
    )
    return covariance, degrees
