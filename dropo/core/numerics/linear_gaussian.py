"""The linear-Gaussian model of compared rows around a member of a family: scores and information.

With J = d f / d xi at the mean, xi ~ N(mu, S) gives y ~ N(f(mu), J S J' + diag(epsilon)).
"""

import numpy as np
from numpy.typing import NDArray

from dropo.core.numerics.kept_rows import KeptRows, row_blocks
from dropo.core.services.validation import Array


def scores_and_information(
    residuals: Array, jacobian: Array, covariance: Array, epsilon: Array
) -> tuple[Array, Array]:
    """Differentiate the log-likelihood of rows by the mean and the variances of parameters.

    Parameters
    ----------
    residuals : (R, p) array
        Measured less predicted.
    jacobian : (R, p, d) array
        Derivatives J of the predictions by the parameters.
    covariance : (d, d) array
        S, the covariance of the parameters.
    epsilon : (p,) array
        Noise variances.

    Returns
    -------
    scores : (R, 2 d) array
        Derivatives by the mean mu, then by the variances v, of each row.
    information : (2 d, 2 d) array
        Fisher information, block diagonal.

    Notes
    -----
    d log L / d mu = J' Sigma^-1 r; d log L / d v_i = ((J_i' Sigma^-1 r)^2 - J_i' Sigma^-1 J_i) / 2.
    """
    rows, p, d = jacobian.shape
    scores = np.empty((rows, 2 * d))
    information = np.zeros((2 * d, 2 * d))
    for block in row_blocks(rows, 24 * p * (p + d)):
        own = jacobian[block]
        solved, gram = solved_rows(own, covariance, epsilon)
        by_mean = np.einsum("rpd,rp->rd", solved, residuals[block])
        scores[block, :d] = by_mean
        scores[block, d:] = 0.5 * (by_mean**2 - np.einsum("rdd->rd", gram))
        information[:d, :d] += gram.sum(axis=0)
        information[d:, d:] += 0.5 * (gram**2).sum(axis=0)
    return scores, information


def information_of_units(
    jacobian: KeptRows, covariance: Array, epsilon: Array, label: NDArray[np.int64]
) -> Array:
    """Sum the Fisher information of rows on the means by unit.

    Parameters
    ----------
    jacobian : (R, p, d) array, in memory or in a file
        Derivatives of the predictions by the parameters.
    covariance : (d, d) array
        Of the parameters.
    epsilon : (p,) array
        Noise variances.
    label : (R,) array of int
        The unit of each row: 0 to G - 1.

    Returns
    -------
    (G, d, d) array
    """
    rows, p, d = jacobian.shape
    out = np.zeros((int(label.max()) + 1, d, d))
    for block in row_blocks(rows, 24 * p * (p + d)):
        np.add.at(out, label[block], solved_rows(jacobian[block], covariance, epsilon)[1])
    return out


def solved_rows(jacobian: Array, covariance: Array, epsilon: Array) -> tuple[Array, Array]:
    """Weigh the derivatives of rows by the inverse of their covariance.

    Parameters
    ----------
    jacobian : (r, p, d) array
        Derivatives J of the predictions by the parameters.
    covariance : (d, d) array
        S, of the parameters.
    epsilon : (p,) array
        Noise variances.

    Returns
    -------
    solved : (r, p, d) array
        Sigma^-1 J, with Sigma = J S J' + diag(epsilon).
    gram : (r, d, d) array
        J' Sigma^-1 J.
    """
    sigma = jacobian @ covariance @ jacobian.swapaxes(1, 2)
    sigma[:, np.arange(len(epsilon)), np.arange(len(epsilon))] += epsilon
    solved: Array = np.asarray(np.linalg.solve(sigma, jacobian), dtype=float)
    gram: Array = jacobian.swapaxes(1, 2) @ solved
    return solved, gram
