"""How scores of a spread vary where the rows of a unit share one draw of the parameters.

A likelihood of rows has a draw of its own for every row. Where a unit's rows share one, the scores
of its rows depend on each other: by how much, the linear-Gaussian model says.
"""

from dataclasses import dataclass
from itertools import combinations_with_replacement

import numpy as np
from numpy.typing import NDArray

from dropo.core.numerics.kept_rows import KeptRows, row_blocks
from dropo.core.numerics.linear_gaussian import solved_rows
from dropo.core.services.validation import Array


@dataclass(frozen=True)
class ScoreCovariances:
    """Covariances of the sums of scores over all rows, under the linear-Gaussian model.

    Attributes
    ----------
    mean, mean_shared : (d, d) array
        Of the scores of the means if each row has a draw of its own, and what it adds that the rows
        of a unit share one.
    pair, pair_shared : (n, n) array
        The same of the scores of the covariance's n = d (d + 1) / 2 entries, in the order of
        `pairs_of`. The first is their information too.
    """

    mean: Array
    mean_shared: Array
    pair: Array
    pair_shared: Array


def pairs_of(d: int) -> NDArray[np.int64]:
    """List the entries of a symmetric matrix.

    Parameters
    ----------
    d : int
        Its size.

    Returns
    -------
    (2, n) array of int
        Rows and columns, n = d (d + 1) / 2.
    """
    return np.array(list(combinations_with_replacement(range(d), 2)), dtype=np.int64).T


def score_covariances(
    jacobian: KeptRows,
    covariance: Array,
    epsilon: Array,
    label: NDArray[np.int64],
    varying: NDArray[np.int64],
) -> ScoreCovariances:
    """Find how the scores of some parameters' means and covariances vary.

    Parameters
    ----------
    jacobian : (R, p, D) array, in memory or in a file
        Derivatives J of the predictions by all parameters.
    covariance : (D, D) array
        S, of the parameters.
    epsilon : (p,) array
        Noise variances.
    label : (R,) array of int
        The unit of each row: 0 to G - 1.
    varying : (d,) array of int
        The parameters that vary; S is 0 elsewhere.

    Returns
    -------
    ScoreCovariances

    Notes
    -----
    With Sigma = J S J' + diag(epsilon), K = J' Sigma^-1 J and u = J' Sigma^-1 r of each row, the
    scores are u for the means and u_a u_b - K_ab for S_ab (half of it on the diagonal). Two rows of
    a unit have cov(u, u') = K S K', and fourth moments of a Gaussian by Isserlis' theorem.
    """
    rows, p, width = jacobian.shape
    d = len(varying)
    count = int(label.max()) + 1
    spread = covariance[np.ix_(varying, varying)]
    first, second = pairs_of(d)
    weight = np.where(first == second, 0.5, 1.0)
    weights = np.outer(weight, weight)
    own = np.zeros((count, d, d))
    products = np.zeros((count, len(first), d, d))
    mean_rows = np.zeros((d, d))
    pair = np.zeros((len(first), len(first)))
    pair_rows = np.zeros_like(pair)
    for block in row_blocks(rows, 24 * (p * (p + width) + 4 * len(first) ** 2)):
        gram = solved_rows(jacobian[block], covariance, epsilon)[1]
        gram = gram[:, varying[:, None], varying]
        np.add.at(own, label[block], gram)
        outer = np.einsum("rna,rnb->rnab", gram[:, first], gram[:, second])
        np.add.at(products, label[block], outer)
        shared = gram @ spread @ gram
        mean_rows += shared.sum(axis=0)
        pair += _fourth_moments(gram, first, second)
        pair_rows += _fourth_moments(shared, first, second)
    of_units = np.zeros_like(pair)
    for unit in products:
        turned = spread @ unit @ spread
        of_units += np.einsum("nab,mab->nm", turned, unit)
        of_units += np.einsum("nab,mba->nm", turned, unit)
    return ScoreCovariances(
        mean=own.sum(axis=0),
        mean_shared=np.sum(own @ spread @ own, axis=0) - mean_rows,
        pair=weights * pair,
        pair_shared=weights * (of_units - pair_rows),
    )


def _fourth_moments(moments: Array, first: NDArray[np.int64], second: NDArray[np.int64]) -> Array:
    """(n, n) sums over rows of C_ac C_bd + C_ad C_bc for pairs ab and cd, of C (r, d, d)."""
    across = moments[:, first[:, None], first] * moments[:, second[:, None], second]
    crossed = moments[:, first[:, None], second] * moments[:, second[:, None], first]
    return np.asarray(np.sum(across + crossed, axis=0))
