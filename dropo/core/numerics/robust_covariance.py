"""Standard errors that hold where rows depend on each other or the model is not quite right."""

import numpy as np

from dropo.core.numerics.dependence import Units, unit_sums, variance_of_sum
from dropo.core.services.validation import Array

SINGULAR = 1e-14
"""Smallest eigenvalue of the scaled information; smaller ones are rounding."""
EXACT = 1e-6
"""Share of a variance below which what is uncertain of it does not matter."""


def sandwich(
    scores: Array,
    information: Array,
    units: Units,
    prior: Array | None = None,
    by_unit: Array | None = None,
) -> tuple[Array, Array]:
    """Estimate the covariance H^-1 V H^-1 of a maximum-likelihood estimate.

    V is the covariance of the scores' sum, by `variance_of_sum`, from each unknown's own influence
    H^-1 u. With a prior it is the error against a truth drawn from the prior: its information P is
    part of H and of V, and scores are taken from their mean, as their sum is the prior's pull.

    Where it is known which unit has how much of the information, V and its degrees of freedom are
    those of `few_units_sandwich`: units of which few decide leave small residuals.

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
    by_unit : (G, m, m) array, optional
        The information of each unit, but for a common factor.

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
    covariance = np.full(information.shape, np.nan)
    degrees = np.full(len(information), np.nan)
    if not good.any():
        return covariance, degrees
    block = np.ix_(good, good)
    inverse = inverse_information(information[block])
    informed = scores if good.all() else scores[:, good]
    if by_unit is None:
        covariance[block], degrees[good] = variance_of_sum(informed @ inverse, units)
    else:
        own = by_unit[:, good][:, :, good]
        whole = own.sum(axis=0) if prior is None else own.sum(axis=0) + np.diag(prior[good])
        sums, degrees[good] = _adjusted(unit_sums(informed, units), own, whole)
        covariance[block] = inverse @ sums.T @ sums @ inverse
    if prior is not None:
        of_data = np.diagonal(covariance)[good].copy()
        covariance[block] += inverse * prior[good] @ inverse
        # The prior's part of a variance is known exactly (Satterthwaite 1946).
        whole = np.diagonal(covariance)[good]
        degrees[good] *= (whole / np.maximum(of_data, EXACT * whole)) ** 2
    return covariance, degrees


def few_units_sandwich(scores: Array, information: Array) -> tuple[Array, Array]:
    """Estimate the covariance of a least-squares estimate from few independent units.

    The residuals of a unit are smaller than the errors, since the fit follows them: the more, the
    more of the information is the unit's own. CR2 makes up for that, exactly where errors are
    independent and alike; what is left of the uncertainty of the variance is in the degrees of
    freedom, which may be far below G - 1 where few units have most of the information.

    Parameters
    ----------
    scores : (G, m) array
        J' r of each unit's whitened residuals r and Jacobian J.
    information : (G, m, m) array
        J' J of each unit.

    Returns
    -------
    covariance : (m, m) array
        NaN for unknowns on which no unit has information.
    degrees : (m,) array
        Degrees of freedom of its diagonal, by Satterthwaite's approximation; NaN likewise.

    References
    ----------
    Bell and McCaffrey, Survey Methodology 28 (2002), 169; Pustejovsky and Tipton, J. Business &
    Economic Statistics 36 (2018), 672, eq. 6 to 11.
    """
    whole = information.sum(axis=0)
    told = np.diagonal(whole) > 0
    covariance = np.full(whole.shape, np.nan)
    degrees = np.full(len(whole), np.nan)
    if not told.any():
        return covariance, degrees
    block = np.ix_(told, told)
    own = information[:, told][:, :, told]
    adjusted, degrees[told] = _adjusted(scores[:, told], own, whole[block])
    inverse = inverse_information(whole[block])
    covariance[block] = inverse @ adjusted.T @ adjusted @ inverse
    return covariance, degrees


def _adjusted(scores: Array, information: Array, whole: Array) -> tuple[Array, Array]:
    """The scores of units with what the fit took from their residuals, and degrees of freedom."""
    # In units of the unknowns in which each has information 1: they may differ by many orders.
    size = np.sqrt(np.diagonal(whole))
    scale = np.outer(size, size)
    adjusted, degrees = _adjusted_alike(scores / size, information / scale, whole / scale)
    return adjusted * size, degrees


def _adjusted_alike(scores: Array, information: Array, whole: Array) -> tuple[Array, Array]:
    """The same where the diagonal of all information is 1."""
    values, vectors = np.linalg.eigh(inverse_information(whole))
    size = np.sqrt(np.maximum(values, 0.0))
    root = (vectors * size) @ vectors.T  # M^-1/2
    back = (vectors / np.maximum(size, SINGULAR * size.max())) @ vectors.T
    # In coordinates in which all information is the identity, a unit has the share A of it.
    share, axes = np.linalg.eigh(root @ information @ root)
    left = np.maximum(1.0 - share, SINGULAR)
    turned = np.einsum("gij,gi->gj", axes, scores @ root)
    adjusted = np.einsum("gij,gj->gi", axes, turned / np.sqrt(left)) @ back
    # The variance of a coefficient c is a quadratic form of the errors with the matrix
    # diag(c' (1 - A)^-1 A c) - w_g' w_h, where w_g = (1 - A_g)^-1/2 A_g c.
    places = np.einsum("gij,ik->gjk", axes, root)
    own = np.einsum("gj,gjk->gk", share / left, places**2)
    pulls = np.einsum("gij,gjk->kgi", axes, (share / np.sqrt(left))[:, :, None] * places)
    length = np.sum(pulls**2, axis=2).T
    gram = np.einsum("kgi,kgj->kij", pulls, pulls)
    trace = np.sum(own - length, axis=0)
    square = np.sum(own**2 - 2 * own * length, axis=0) + np.sum(gram**2, axis=(1, 2))
    # Where no unit has any information, as beside a prior alone, all count.
    degrees = np.full(len(square), max(len(scores) - 1.0, 1.0))
    np.divide(trace**2, square, out=degrees, where=square > 0)
    return adjusted, degrees


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
