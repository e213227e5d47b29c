"""Statistical tests of estimators and samplers: are intervals, draws and estimates what they claim?

Each replication draws a truth and data from it, and fits these. The answers are tests with
p-values, to be read beside a control that must fail.
"""

from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import binomtest, chi2, kstest

from dropo.core.contracts.problem import Problem
from dropo.core.records.fits.fit import Fit
from dropo.core.records.trajectories import Ints
from dropo.core.services.errors import Incompatible
from dropo.core.services.tables import Report, Table, number
from dropo.core.services.validation import Array, float_array, require

Draw = Callable[[np.random.Generator], tuple[Problem, ArrayLike]]
"""Draws a truth (d,), from the prior where there is one, and a problem with data from it."""
LEVELS = 99
"""Draws beside which a truth is ranked: ranks from 0 to 99."""
BINS = 10
"""Equal bins of the chi-square test of ranks."""


@dataclass(frozen=True, repr=False)
class Coverage(Report):
    """How often intervals hold the truth.

    Attributes
    ----------
    hits : (N, d) array of bool
        Whether each of d intervals held its truth, by replication.
    level : float
        What the intervals claim.
    p_values : (d,) array
        Of the two-sided binomial test that each covers as it claims.
    """

    hits: Any
    level: float
    p_values: Array

    @property
    def rates(self) -> Array:
        """(d,) the shares that hold the truth."""
        return np.asarray(self.hits.mean(axis=0))

    @property
    def p_value(self) -> float:
        """Of all of them together, by Bonferroni's inequality."""
        return together(self.p_values)

    def parts(self) -> list[str | Table]:
        """A row for each interval."""
        error = np.sqrt(self.level * (1 - self.level) / len(self.hits))
        rows = [
            (str(i), f"{rate:.1%}", f"{error:.1%}", number(p, 2))
            for i, (rate, p) in enumerate(zip(self.rates, self.p_values, strict=True))
        ]
        title = f"coverage of {self.level:.0%} intervals, {len(self.hits)} replications"
        return [Table(title, ("number", "holds the truth", "+-", "p"), tuple(rows))]


@dataclass(frozen=True, repr=False)
class Calibration(Report):
    """Ranks of the truth among draws of a posterior: uniform where the posterior is right.

    Attributes
    ----------
    ranks : (N, d) int array
        From 0 to `levels`, by replication.
    levels : int
        Draws beside which a truth is ranked.
    p_values : (d,) array
        Of the chi-square test that ranks are uniform.
    """

    ranks: Ints
    levels: int
    p_values: Array

    @property
    def p_value(self) -> float:
        """Of all of them together, by Bonferroni's inequality."""
        return together(self.p_values)

    def band(self, level: float = 0.95) -> Array:
        """Compute the band of ranks for this number of replications.

        Parameters
        ----------
        level : float
            Probability that all ranks of a right method are within the band.

        Returns
        -------
        (levels,) array
            As of `rank_band`.
        """
        return rank_band(len(self.ranks), level=level, levels=self.levels)

    def parts(self) -> list[str | Table]:
        """A row for each number."""
        rows = []
        for i, (own, p) in enumerate(zip(self.ranks.T, self.p_values, strict=True)):
            rows.append((str(i), f"{own.mean() / self.levels:.3f}", number(p, 2)))
        title = f"ranks of the truth, {len(self.ranks)} replications"
        return [Table(title, ("number", "mean rank, 0.5 expected", "p of uniform"), tuple(rows))]


@dataclass(frozen=True, repr=False)
class ExpectedCoverage(Report):
    """Credibility of regions around random points that reach to the truth: uniform if all is right.

    Attributes
    ----------
    credibility : (N,) array
        The share of draws nearer to the random point than the truth, by replication.
    p_value : float
        Of the Kolmogorov-Smirnov test that it is uniform.
    """

    credibility: Array
    p_value: float

    def parts(self) -> list[str | Table]:
        """The share of truths in regions of a few credibilities."""
        rows = []
        for level in (0.1, 0.25, 0.5, 0.75, 0.9):
            rows.append((f"{level:.0%}", f"{np.mean(self.credibility <= level):.1%}"))
        title = f"expected coverage, {len(self.credibility)} replications"
        table = Table(title, ("credibility", "holds the truth"), tuple(rows))
        return [table, f"p of uniform: {number(self.p_value, 2)}"]


def coverage(
    estimator: Any,
    draw: Draw,
    *,
    level: float = 0.95,
    replications: int = 100,
    rng: np.random.Generator | int | None = 0,
    intervals: Callable[[Fit, float], ArrayLike] | None = None,
    executor: Executor | None = None,
) -> Coverage:
    """Count how often an estimator's intervals hold the truth.

    Parameters
    ----------
    estimator : Estimator
        What fits; its `fit(problem, rng=...)` is called.
    draw : callable
        A generator to a problem, and the truths (d,) of the functional.
    level : float
        What the intervals claim, between 0 and 1.
    replications : int
        N, how many data sets are fitted; 200 tell 5 % from 10 %.
    rng : numpy.random.Generator, int or None
        A generator or a seed.
    intervals : callable, optional
        A fit and the level to intervals (d, 2) of any functional; those of the means by default.
    executor : concurrent.futures.Executor, optional
        Where replications run; results do not depend on it.

    Returns
    -------
    Coverage

    Raises
    ------
    BadArgument
        If the level is not between 0 and 1, or there are no replications.
    """
    require(0 < level < 1, "level", "between 0 and 1", level, "coverage")
    bounds = intervals or _interval_of_means
    task = partial(_is_inside, estimator, draw, bounds, level)
    hits = np.array(_replicated(task, replications, rng, executor, "coverage"))
    p_values = [binomtest(int(own.sum()), len(own), level).pvalue for own in hits.T]
    return Coverage(hits, level, np.array(p_values))


def simulation_based_calibration(
    estimator: Any,
    draw: Draw,
    *,
    replications: int = 100,
    levels: int = LEVELS,
    rng: np.random.Generator | int | None = 0,
    draws: Callable[[Fit], ArrayLike] | None = None,
    executor: Executor | None = None,
) -> Calibration:
    """Rank truths from the prior among the draws of their posteriors.

    Parameters
    ----------
    estimator : Estimator
        What samples the posterior.
    draw : callable
        A generator to a problem, and the truth (d,), which is drawn from the estimator's own prior.
    replications : int
        N, at least five for each of ten bins.
    levels : int
        Draws beside which a truth is ranked, spread evenly over all; one less than a multiple of
        ten.
    rng, executor
        As of `coverage`.
    draws : callable
        A fit to draws (K, d) of any functional; those of the posterior by default.

    Returns
    -------
    Calibration

    Raises
    ------
    BadArgument
        If there are too few replications or draws.
    Incompatible
        If a fit has no draws of a posterior, and `draws` is left out.

    References
    ----------
    Talts, Betancourt, Simpson, Vehtari, Gelman, Validating Bayesian inference algorithms with
    simulation-based calibration, 2018, arXiv:1804.06788.
    """
    least = f"at least {5 * BINS}, for five in a bin"
    require(replications >= 5 * BINS, "replications", least, replications, "calibration")
    task = partial(_ranks, estimator, draw, draws or posterior_draws, levels)
    found = _replicated(task, replications, rng, executor, "calibration")
    all_ranks = np.array(found)
    return Calibration(all_ranks, levels, uniformity(all_ranks, levels))


def expected_coverage(
    estimator: Any,
    draw: Draw,
    *,
    replications: int = 100,
    rng: np.random.Generator | int | None = 0,
    draws: Callable[[Fit], ArrayLike] | None = None,
    executor: Executor | None = None,
) -> ExpectedCoverage:
    """Test posteriors in all numbers at once, by distances to random points (TARP).

    Distances are in units of the spread of the truths over all replications.

    Parameters
    ----------
    estimator, draw, replications, rng, draws, executor
        As of `simulation_based_calibration`.

    Returns
    -------
    ExpectedCoverage

    Raises
    ------
    BadArgument, Incompatible
        As of `simulation_based_calibration`.

    References
    ----------
    Lemos, Coogan, Hezaveh, Perreault-Levasseur, Sampling-based accuracy testing of posterior
    estimators for general inference, ICML 2023, arXiv:2302.03026.
    """
    require(replications >= 10, "replications", "at least 10", replications, "expected_coverage")
    (points_rng,) = np.random.default_rng(rng).spawn(1)
    task = partial(_draws_and_truth, estimator, draw, draws or posterior_draws)
    found = _replicated(task, replications, rng, executor, "expected_coverage")
    truths = np.array([truth for _, truth in found])
    low = truths.min(axis=0)
    width = np.maximum(truths.max(axis=0) - low, np.finfo(float).tiny)
    credibility = []
    for values, truth in found:
        point = points_rng.random(len(truth))
        distances = np.linalg.norm((values - low) / width - point, axis=1)
        reach = np.linalg.norm((truth - low) / width - point)
        credibility.append(np.mean(distances < reach))
    shares = np.array(credibility)
    return ExpectedCoverage(shares, float(kstest(shares, "uniform").pvalue))


def ranks(draws: Array, truth: Array, levels: int = LEVELS) -> Ints:
    """Ranks of the truth among draws.

    Parameters
    ----------
    draws : (K, d) array
        Draws of the posterior, of which `levels` are taken, spread evenly.
    truth : (d,) array
        True parameters.
    levels : int
        Number of draws that are compared.

    Returns
    -------
    (d,) int array
        How many of them are below the truth: 0 ... levels.

    Raises
    ------
    BadArgument
        If there are fewer draws than `levels`.
    """
    require(len(draws) >= levels, "draws", f"at least {levels}", len(draws), "ranks")
    chosen = draws[np.linspace(0, len(draws) - 1, levels).round().astype(int)]
    return np.asarray((chosen < truth).sum(axis=0), dtype=np.int64)


def uniformity(found: Ints, levels: int = LEVELS, bins: int = BINS) -> Array:
    """Chi-square p-values of ranks being uniform.

    Parameters
    ----------
    found : (N, d) int array
        Ranks from 0 to `levels`.
    levels : int
        The largest rank.
    bins : int
        Number of equal bins.

    Returns
    -------
    (d,) array
        A p-value for each parameter.

    Raises
    ------
    BadArgument
        If `bins` does not divide `levels + 1`.
    """
    require((levels + 1) % bins == 0, "bins", f"a divisor of {levels + 1}", bins, "uniformity")
    bin_of = found * bins // (levels + 1)
    counts = np.array([np.bincount(column, minlength=bins) for column in bin_of.T])
    expected = len(found) / bins
    statistic = ((counts - expected) ** 2 / expected).sum(axis=1)
    return np.asarray(chi2.sf(statistic, bins - 1))


def rank_band(
    replications: int, *, level: float = 0.95, levels: int = LEVELS, simulations: int = 2000
) -> Array:
    """How far the share of ranks below each one may lie from uniform, at all ranks together.

    Parameters
    ----------
    replications : int
        N ranks.
    level : float
        Probability that uniform ranks stay inside everywhere.
    levels : int
        The largest rank.
    simulations : int
        Of N uniform ranks, by which the band is found, always the same ones.

    Returns
    -------
    (levels,) array
        Half widths around (r + 1) / (levels + 1) for the ranks r = 0 ... levels - 1.
    """
    rng = np.random.default_rng(0)
    share = np.arange(1, levels + 1) / (levels + 1)
    error = np.sqrt(share * (1 - share) / replications)
    furthest = []
    for _ in range(simulations):
        drawn = rng.integers(0, levels + 1, replications)
        counts = np.bincount(drawn, minlength=levels + 1)[:-1]
        below = np.cumsum(counts) / replications
        furthest.append(np.max(np.abs(below - share) / error))
    return np.asarray(np.quantile(furthest, level) * error)


def posterior_draws(fit: Fit) -> Array:
    """The draws (K, d) of a fit's posterior: of a sampler, of particles or of a neural density.

    Parameters
    ----------
    fit : Fit
        By `posterior`, `epopt` or `npe`.

    Returns
    -------
    (K, d) array

    Raises
    ------
    Incompatible
        If the fit has none.
    """
    if fit.posterior is not None:
        chain = fit.posterior.chain
        return chain.reshape(-1, chain.shape[-1])
    draws = getattr(fit.search_record, "draws", None)
    if draws is None:
        raise Incompatible(
            f"A fit by {fit.method!r} has no draws of a posterior. Name them: draws=..., a function"
            " of the fit."
        )
    return np.asarray(draws, dtype=float)


def together(p_values: Array) -> float:
    """Combine the p-values of several tests by Bonferroni's inequality.

    Parameters
    ----------
    p_values : (m,) array
        p-values of m tests.

    Returns
    -------
    float
        The p-value of all of them together.
    """
    return min(1.0, len(p_values) * float(p_values.min()))


def _replicated(
    task: Callable[[int], Any],
    replications: int,
    rng: np.random.Generator | int | None,
    executor: Executor | None,
    caller: str,
) -> list[Any]:
    """The answers of a task to as many seeds."""
    require(replications >= 1, "replications", "at least 1", replications, caller)
    seeds = np.random.default_rng(rng).integers(2**63, size=replications).tolist()
    return list(map(task, seeds) if executor is None else executor.map(task, seeds))


def _fitted(estimator: Any, draw: Draw, seed: int) -> tuple[Fit, Array]:
    """The fit of one replication, and its truth (d,)."""
    data_rng, fit_rng = np.random.default_rng(seed).spawn(2)
    problem, truth = draw(data_rng)
    fit: Fit = estimator.fit(problem, rng=fit_rng)
    return fit, float_array("truth", truth, (None,), "draw")


def _interval_of_means(fit: Fit, level: float) -> Array:
    """Intervals (d, 2) of the means."""
    return fit.interval(level)


def _is_inside(
    estimator: Any,
    draw: Draw,
    intervals: Callable[[Fit, float], ArrayLike],
    level: float,
    seed: int,
) -> list[bool]:
    """Whether the intervals of one replication hold their truths."""
    fit, truth = _fitted(estimator, draw, seed)
    low, high = np.asarray(intervals(fit, level), dtype=float).T
    return list(((low <= truth) & (truth <= high)).tolist())


def _draws_and_truth(
    estimator: Any, draw: Draw, draws: Callable[[Fit], ArrayLike], seed: int
) -> tuple[Array, Array]:
    """The draws (K, d) of one replication, and its truth (d,)."""
    fit, truth = _fitted(estimator, draw, seed)
    return float_array("draws", draws(fit), (None, len(truth)), "draws"), truth


def _ranks(
    estimator: Any, draw: Draw, draws: Callable[[Fit], ArrayLike], levels: int, seed: int
) -> Ints:
    """The ranks (d,) of one replication."""
    return ranks(*_draws_and_truth(estimator, draw, draws, seed), levels)
