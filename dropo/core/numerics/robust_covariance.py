"""Standard errors that hold where rows depend on each other or the model is not quite right."""

import numpy as np

from dropo.core.numerics.dependence import Units, variance_of_sum
from dropo.core.services.validation import Array

SINGULAR = 1e-14
"""Smallest eigenvalue of the scaled information; smaller ones are rounding."""
EXACT = 1e-6
"""Share of a variance below which what is uncertain of it does not matter."""


def sandwich(
    scores: Array, information: Array, units: Units, prior: Array | None = None
) -> tuple[Array, Array]:
    """Estimate the covariance H^-1 V H^-1 of a maximum-likelihood estimate.

    V is the covariance of the scores' sum, by `variance_of_sum`, from each unknown's own influence
    H^-1 u. With a prior it is the error against a truth drawn from the prior: its information P is
    part of H and of V, and scores are taken from their mean, as their sum is the prior's pull.

    Parameters
    ----------
    scores : (R, m) array
        Score of each row.
    information : (m, m) array
        H, the Fisher information.
    units : Units
        Which rows depend on each other.
    prior : (m,) array, optional
        The diagonal of P.

    Returns
    -------
    covariance : (m, m) array
        NaN for unknowns on which the data have no information. Directions without information get
        a huge variance, which a pseudo-inverse would hide.
    degrees : (m,) array
        Degrees of freedom of the standard errors; NaN likewise.
    """
    if prior is not None:
        information = information + np.diag(prior)
        scores = scores - scores.mean(axis=0)
    good = np.diagonal(information) > 0
    block = np.ix_(good, good)
    inverse = inverse_information(information[block])
    covariance = np.full(information.shape, np.nan)
    degrees = np.full(len(information), np.nan)
    informed = scores if good.all() else scores[:, good]
    covariance[block], degrees[good] = variance_of_sum(informed @ inverse, units)
    if prior is not None:
        of_data = np.diagonal(covariance)[good].copy()
        covariance[block] += inverse * prior[good] @ inverse
        # The prior's part of a variance is known exactly (Satterthwaite 1946).
        whole = np.diagonal(covariance)[good]
        degrees[good] *= (whole / np.maximum(of_data, EXACT * whole)) ** 2
    return covariance, degrees


def inverse_information(information: Array) -> Array:
    """Invert an information matrix, with a huge variance along directions without information.

    Parameters
    ----------
    information : (m, m) array
        With a positive diagonal.

    Returns
    -------
    (m, m) array
    """
    size = np.sqrt(np.diagonal(information))
    scale = np.outer(size, size)
    values, vectors = np.linalg.eigh(information / scale)
    return np.asarray((vectors / np.maximum(values, SINGULAR)) @ vectors.T / scale)
