"""The block bootstrap: the estimate's own distribution, by fitting the data again with whole pieces
drawn anew.
"""

from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from dropo.core.contracts.estimator import Estimator
from dropo.core.contracts.problem import Problem
from dropo.core.records.independent_units import MANY
from dropo.core.records.parameters import ParameterSpace
from dropo.core.records.trajectories import Ints, Trajectories
from dropo.core.services.errors import DropoError, SimulationFailed
from dropo.core.services.validation import Array, require


@dataclass(frozen=True)
class Bootstrap:
    """Estimates on data drawn anew. means, scales: (B, d), NaN in the rows of fits that failed;
    pieces: what was drawn.
    """

    space: ParameterSpace
    means: Array
    scales: Array
    pieces: str

    @property
    def standard_errors(self) -> Array:
        """(d,) of the means."""
        return np.asarray(np.nanstd(self.means, axis=0, ddof=1))

    def interval(self, level: float = 0.95) -> Array:
        """(d, 2) percentile intervals of the means (Efron and Tibshirani 1993, chapter 13)."""
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
    """Fits the problem on `replications` data sets of pieces drawn with replacement.

    Pieces are trajectories where there are 20, else the named groups where there are 20, else
    overlapping blocks of 5 n^(1/3) of n transitions (Künsch 1989), within trajectories. executor:
    any concurrent.futures.Executor, threads where there is none; the same draws on any.
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
    means, scales = (np.array(values) for values in zip(*found, strict=True))
    if not np.isfinite(means).all(axis=1).any():
        raise SimulationFailed(
            "Every fit of the bootstrap failed. Fit the data themselves first, to see why."
        )
    return Bootstrap(problem.space, means, scales, kind)


def resampled(
    trajectories: Trajectories, pieces: list[Ints], size: int, rng: np.random.Generator
) -> Trajectories:
    """At least `size` transitions of pieces drawn with replacement, each of them a group and an end
    of a trajectory.
    """
    drawn: list[Ints] = []
    while sum(map(len, drawn)) < size:
        drawn.append(pieces[rng.integers(len(pieces))])
    rows = np.concatenate(drawn)
    ends = trajectories.terminals[rows].copy()
    ends[:-1] |= np.diff(rows) != 1
    ends[np.cumsum([len(piece) for piece in drawn]) - 1] = True
    group = (
        None
        if trajectories.group is None
        else _fresh(
            trajectories.group[rows], np.repeat(np.arange(len(drawn)), list(map(len, drawn)))
        )
    )
    time = None if trajectories.time is None else trajectories.time[rows]
    return Trajectories(
        trajectories.observations[rows],
        trajectories.actions[rows],
        trajectories.next_observations[rows],
        ends,
        group,
        time,
    )


def _fresh(group: Ints, piece: Ints) -> Ints:
    """A group in two pieces is two groups: drawn twice, it is another draw of the parameters."""
    return np.asarray(np.unique(np.stack([piece, group]), axis=1, return_inverse=True)[1]).ravel()


def _pieces(problem: Problem) -> tuple[list[Ints], str]:
    data = problem.trajectories
    if len(data.spans) >= MANY:
        return [np.arange(start, stop) for start, stop in data.spans], "trajectories"
    if data.group is not None and len(np.unique(data.group)) >= MANY:
        return [np.flatnonzero(data.group == g) for g in np.unique(data.group)], "groups"
    length = max(problem.length, int(np.ceil(5 * len(data) ** (1 / 3))))
    blocks = [
        np.arange(i, min(i + length, stop))
        for start, stop in data.spans
        for i in range(start, max(start + 1, stop - length + 1))
    ]
    return blocks, f"blocks of {length} transitions"


def _replication(
    problem: Problem, estimator: Estimator, pieces: list[Ints], seed: int
) -> tuple[ArrayLike, ArrayLike]:
    rng = np.random.default_rng(seed)
    data = resampled(problem.trajectories, pieces, len(problem.trajectories), rng)
    try:
        fit = estimator.fit(
            replace(problem, trajectories=data, everything=None, held_out=None), rng=rng
        )
    except DropoError:
        nothing = np.full(len(problem.space), np.nan)
        return nothing, nothing
    return fit.mean, fit.scale
