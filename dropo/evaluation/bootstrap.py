"""The block bootstrap: the estimate's own distribution, by fitting data of pieces drawn anew."""

from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from dropo.core.contracts.estimator import Estimator
from dropo.core.contracts.problem import Problem
from dropo.core.records.independent_units import SETTINGS
from dropo.core.records.parameters import ParameterSpace
from dropo.core.records.trajectories import Ints, Trajectories
from dropo.core.services.errors import DropoError, SimulationFailed
from dropo.core.services.validation import Array, require


@dataclass(frozen=True)
class Bootstrap:
    """Estimates on data drawn anew.

    Attributes
    ----------
    space : ParameterSpace
        The d parameters.
    means, scales : (B, d) array
        Of each fit, in the parameters' units; NaN in the rows of fits that failed.
    pieces : str
        What was drawn.
    """

    space: ParameterSpace
    means: Array
    scales: Array
    pieces: str

    @property
    def standard_errors(self) -> Array:
        """(d,) standard errors of the means."""
        return np.asarray(np.nanstd(self.means, axis=0, ddof=1))

    def interval(self, level: float = 0.95) -> Array:
        """Return percentile intervals of the means.

        Parameters
        ----------
        level : float
            Between 0 and 1.

        Returns
        -------
        (d, 2) array

        Raises
        ------
        BadArgument
            If the level is not between 0 and 1.

        References
        ----------
        Efron and Tibshirani, An introduction to the bootstrap, 1993, chapter 13.
        """
        require(0 < level < 1, "level", "between 0 and 1", level, "Bootstrap.interval")
        return np.asarray(np.nanquantile(self.means, [(1 - level) / 2, (1 + level) / 2], axis=0).T)


def bootstrap(
    problem: Problem,
    estimator: Estimator,
    *,
    replications: int = 200,
    rng: np.random.Generator | int | None = 0,
    executor: Executor | None = None,
) -> Bootstrap:
    """Fit a problem on data sets of pieces drawn with replacement.

    Pieces are trajectories where there are 20, else the named groups where there are 20, else
    overlapping blocks of 5 n^(1/3) of n transitions [1]_, within trajectories.

    Parameters
    ----------
    problem : Problem
        With d parameters.
    estimator : Estimator
        What fits it.
    replications : int
        B, how many data sets are drawn.
    rng : numpy.random.Generator, int or None
        A generator or a seed.
    executor : concurrent.futures.Executor, optional
        Where fits run, threads by default; the draws are the same on any.

    Returns
    -------
    Bootstrap

    Raises
    ------
    BadArgument
        If there are fewer than two replications.
    SimulationFailed
        If every fit failed.

    References
    ----------
    .. [1] Künsch, The jackknife and the bootstrap for general stationary observations, Annals of
       Statistics 17, 1989.
    """
    require(replications >= 2, "replications", "at least 2", replications, "bootstrap")
    pieces, kind = _pieces(problem)
    seeds = np.random.default_rng(rng).integers(2**63, size=replications).tolist()
    task = partial(_replication, problem, estimator, pieces)
    if executor is not None:
        found = list(executor.map(task, seeds))
    else:
        with ThreadPoolExecutor(thread_name_prefix="bootstrap") as threads:
            found = list(threads.map(task, seeds))
    means = np.array([mean for mean, _ in found])
    scales = np.array([scale for _, scale in found])
    if not np.isfinite(means).all(axis=1).any():
        raise SimulationFailed(
            "Every fit of the bootstrap failed. Fit the data themselves first, to see why."
        )
    return Bootstrap(problem.space, means, scales, kind)


def resampled(
    trajectories: Trajectories, pieces: list[Ints], size: int, rng: np.random.Generator
) -> Trajectories:
    """Draw pieces with replacement until there are enough transitions.

    Parameters
    ----------
    trajectories : Trajectories
        The data.
    pieces : list of int array
        The rows of each piece.
    size : int
        Transitions that are drawn at least.
    rng : numpy.random.Generator
        Draws the pieces.

    Returns
    -------
    Trajectories
        Each drawn piece ends a trajectory, and its groups are groups of their own.
    """
    drawn: list[Ints] = []
    while sum(map(len, drawn)) < size:
        drawn.append(pieces[rng.integers(len(pieces))])
    rows = np.concatenate(drawn)
    lengths = [len(piece) for piece in drawn]
    ends = trajectories.terminals[rows].copy()
    ends[:-1] |= np.diff(rows) != 1
    ends[np.cumsum(lengths) - 1] = True
    group: Ints | None = None
    if trajectories.group is not None:
        piece = np.repeat(np.arange(len(drawn)), lengths)
        group = _new_groups(trajectories.group[rows], piece)
    time = None if trajectories.time is None else trajectories.time[rows]
    return Trajectories(
        trajectories.observations[rows],
        trajectories.actions[rows],
        trajectories.next_observations[rows],
        ends,
        group,
        time,
    )


def redrawn(problem: Problem, rng: np.random.Generator) -> Problem:
    """Make the same problem on as much data of pieces drawn with replacement.

    Parameters
    ----------
    problem : Problem
        The problem.
    rng : numpy.random.Generator
        Draws the pieces, which are those of `bootstrap`.

    Returns
    -------
    Problem
    """
    return _drawn(problem, _pieces(problem)[0], rng)


def _drawn(problem: Problem, pieces: list[Ints], rng: np.random.Generator) -> Problem:
    """The problem on pieces drawn anew."""
    data = resampled(problem.trajectories, pieces, len(problem.trajectories), rng)
    return replace(problem, trajectories=data, everything=None, held_out=None)


def _new_groups(group: Ints, piece: Ints) -> Ints:
    """A group in two pieces is two groups: drawn twice, it is another draw of the parameters."""
    pairs = np.stack([piece, group])
    return np.asarray(np.unique(pairs, axis=1, return_inverse=True)[1]).ravel()


def _pieces(problem: Problem) -> tuple[list[Ints], str]:
    """The rows of each piece, and what pieces are."""
    data = problem.trajectories
    if len(data.spans) >= SETTINGS.many:
        return [np.arange(start, stop) for start, stop in data.spans], "trajectories"
    if data.group is not None:
        groups = np.unique(data.group)
        if len(groups) >= SETTINGS.many:
            return [np.flatnonzero(data.group == group) for group in groups], "groups"
    length = max(problem.horizon, int(np.ceil(5 * len(data) ** (1 / 3))))
    blocks = []
    for start, stop in data.spans:
        last = max(start + 1, stop - length + 1)
        blocks += [np.arange(first, min(first + length, stop)) for first in range(start, last)]
    return blocks, f"blocks of {length} transitions"


def _replication(
    problem: Problem, estimator: Estimator, pieces: list[Ints], seed: int
) -> tuple[ArrayLike, ArrayLike]:
    """The mean and scale (d,) of a fit on data drawn anew; NaN where it fails."""
    rng = np.random.default_rng(seed)
    drawn = _drawn(problem, pieces, rng)
    try:
        fit = estimator.fit(drawn, rng=rng)
    except DropoError:
        nothing = np.full(len(problem.space), np.nan)
        return nothing, nothing
    return fit.mean, fit.scale
