"""Paired tests over data sets: does a variant differ from the first one on the same data?"""

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import rankdata, studentized_range, wilcoxon

from dropo.core.services.validation import Array, float_array


def paired_p_value(first: ArrayLike, second: ArrayLike) -> float:
    """Test whether pairs differ: Wilcoxon's signed ranks, two-sided.

    Parameters
    ----------
    first, second : (n,) array_like
        Values on the same data sets; pairs that are not finite are left out.

    Returns
    -------
    float
        The p-value; 1 where all pairs are alike, NaN where there are none.
    """
    difference = np.subtract(first, second)
    known = difference[np.isfinite(difference)]
    if not len(known):
        return float("nan")
    if not known.any():
        return 1.0
    return float(wilcoxon(known).pvalue)


def smallest_p_value(pairs: int) -> float:
    """Compute the smallest p-value that Wilcoxon's signed ranks can reach.

    Parameters
    ----------
    pairs : int
        Number n of pairs.

    Returns
    -------
    float
        2^(1 - n), two-sided, where all differences have one sign; at most 1.
    """
    return min(1.0, 2.0 ** (1 - pairs))


def mean_ranks(costs: ArrayLike) -> Array:
    """Average ranks of variants over data sets, 1 the best.

    Parameters
    ----------
    costs : (n, k) array_like
        Of k variants on n data sets, finite or infinite; less is better.

    Returns
    -------
    (k,) array
    """
    return np.asarray(rankdata(np.asarray(costs, dtype=float), axis=1).mean(axis=0))


def critical_difference(variants: int, data_sets: int, level: float = 0.05) -> float:
    """How far average ranks must lie apart to differ: Nemenyi's test after Friedman's.

    Parameters
    ----------
    variants, data_sets : int
        How many were ranked, at least 2, and on how many data sets.
    level : float
        Of the test.

    Returns
    -------
    float

    References
    ----------
    Demsar, Statistical comparisons of classifiers over multiple data sets, Journal of Machine
    Learning Research 7, 2006, section 3.2.2.
    """
    quantile = studentized_range.ppf(1 - level, variants, np.inf) / np.sqrt(2)
    return float(quantile * np.sqrt(variants * (variants + 1) / (6 * data_sets)))


def performance_profile(costs: ArrayLike) -> tuple[Array, Array]:
    """The share of data sets that each variant solves within a factor of the cheapest one.

    Parameters
    ----------
    costs : (n, k) array_like
        What it cost each of k variants to solve each of n data sets; infinite where it did not.

    Returns
    -------
    factors : (m,) array
        Where a share rises, from 1 on.
    shares : (m, k) array
        The share of data sets at that factor, of all n.

    References
    ----------
    Dolan and More, Benchmarking optimization software with performance profiles, Mathematical
    Programming 91, 2002; as used by More and Wild, Benchmarking derivative-free optimization
    algorithms, SIAM Journal on Optimization 20, 2009.
    """
    costs = np.asarray(costs, dtype=float)
    least = costs.min(axis=1, keepdims=True)
    with np.errstate(invalid="ignore"):
        ratios = np.where(np.isfinite(costs), costs / least, np.inf)
    return _shares(ratios, first=1.0)


def data_profile(costs: ArrayLike, unit: ArrayLike) -> tuple[Array, Array]:
    """The share of data sets that each variant solves within a cost.

    Parameters
    ----------
    costs : (n, k) array_like
        As of `performance_profile`.
    unit : (n,) array_like
        The cost of one simplex gradient on each data set, d + 1 evaluations, in the same unit.

    Returns
    -------
    gradients : (m,) array
        Where a share rises, in simplex gradients.
    shares : (m, k) array

    References
    ----------
    More and Wild 2009, as of `performance_profile`.

    Raises
    ------
    BadArgument
        If `unit` has another length than `costs`, or is not finite.
    """
    costs = np.asarray(costs, dtype=float)
    units = float_array("unit", unit, (len(costs),), "data_profile")
    return _shares(costs / units[:, None], first=0.0)


def expected_running_time(costs: ArrayLike, solved: ArrayLike) -> Array:
    """What a success costs on average, failures included.

    Parameters
    ----------
    costs : (n, k) array_like
        What each of k variants spent on each of n data sets, whether it solved it or not.
    solved : (n, k) array_like of bool
        Whether it did.

    Returns
    -------
    (k,) array
        All cost over the number of successes; infinite where there was none.

    References
    ----------
    Hansen, Auger, Ros, Mersmann, Tusar, Brockhoff, COCO: a platform for comparing continuous
    optimizers in a black-box setting, Optimization Methods and Software 36, 2021.
    """
    spent = np.asarray(costs, dtype=float).sum(axis=0)
    successes = np.asarray(solved, dtype=bool).sum(axis=0)
    with np.errstate(divide="ignore"):
        return np.asarray(np.where(successes > 0, spent / np.maximum(successes, 1), np.inf))


def _shares(ratios: Array, first: float) -> tuple[Array, Array]:
    """Where the shares of `ratios` (n, k) below a bound rise, and the shares there."""
    places = np.unique(ratios[np.isfinite(ratios)])
    places = np.concatenate([[first], places[places > first]])
    shares = (ratios[None] <= places[:, None, None]).mean(axis=1)
    return places, shares
