"""Velocities from logged positions, with the noise level of both: by a smoother, or by a filter
that knows the past alone.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import minimize_scalar

from dropo.core.numerics.robust_statistics import deviation
from dropo.core.records.trajectories import Ints
from dropo.core.services.validation import Array, float_array, require
from dropo.logs.signals.integrated_noise import Motion, filtered

# accelerations are taken as a random walk: of 2, 3 and 4 the one whose stated noise levels are
# right on most motions
ORDER = 3
# of log q / r: the search, in steps of the median time, and its first grid
LEAST = -30.0
LARGEST = 10.0
GRID = 4.0
# rows that the search sees of a long log
BLOCKS = 20
BLOCK = 1000
# a jump of the velocity: its score among all, beside its surroundings', above the acceleration's
GATE = 8.0
ABOVE = 6.5
BELOW = 1.95
ROUNDS = 5  # of looking for jumps
PROBES = 8  # columns of random signs that show how much noise comes through (Hutchinson 1990)
NOTHING: Ints = np.empty(0, dtype=np.int64)


@dataclass(frozen=True, eq=False)
class Velocities:
    """Smoothed or filtered positions and their velocities, (n, p) each, and standard deviations
    (p,) of what is wrong in them.

    position_noise: of the measured positions; smoothed_noise: of `positions`; velocity_noise: of
    `velocities`, whose errors hang together over the width of the smoother. jumps: for each column
    the rows before which the velocity jumped (an impact), so that nothing was smoothed across.
    causal: whether only measurements up to a row were used.
    """

    positions: Array
    velocities: Array
    position_noise: Array
    velocity_noise: Array
    smoothed_noise: Array
    jumps: tuple[Ints, ...]
    causal: bool = False


def estimate_velocities(
    time: ArrayLike, positions: ArrayLike, *, noise: ArrayLike | None = None, causal: bool = False
) -> Velocities:
    """The velocities (n, p) of positions (n, p) measured at `time` (n,) [s], strictly increasing,
    also unevenly.

    Each column's acceleration is taken as a random walk seen through white noise; the noise level
    and the smoother's bandwidth are the ones of largest likelihood. noise: (p,) the standard
    deviations, where they are known. A quantised column has at least the noise of its steps, step /
    sqrt(12). causal: a filter, for what must not know the future, with larger errors, which catches
    up behind a jump; else a smoother, split at jumps. Angles must be unwrapped.
    """
    stamps = float_array("time", time, (None,), "estimate_velocities")
    rows = float_array("positions", positions, (len(stamps), None), "estimate_velocities")
    require(
        len(stamps) > 2 * ORDER,
        "positions",
        f"at least {2 * ORDER + 1} rows",
        len(stamps),
        "estimate_velocities",
    )
    require(
        bool((np.diff(stamps) > 0).all()),
        "time",
        "strictly increasing",
        "instants that are not",
        "estimate_velocities",
    )
    known = (
        None
        if noise is None
        else float_array("noise", noise, (rows.shape[1],), "estimate_velocities")
    )
    require(
        known is None or bool((known > 0).all()), "noise", "above 0", known, "estimate_velocities"
    )
    columns = [
        _Column.of(stamps, column, None if known is None else float(known[i]))
        for i, column in enumerate(rows.T)
    ]
    smooth = [column.smoothed() for column in columns]
    estimates = [s[0] for s in smooth]
    errors = [s[1] for s in smooth]
    if causal:
        later = estimates
        estimates = list(
            filtered(
                [column.motion for column in columns],
                np.array([column.ratio for column in columns]),
            )[:, :, :2]
        )
        errors = [
            np.sqrt(e**2 + np.mean((a - b)[2 * ORDER :] ** 2, axis=0))
            for e, a, b in zip(errors, estimates, later, strict=True)
        ]
    # (n, 2, p), (2, p)
    found = np.stack(estimates, axis=2)
    deviations = np.stack(errors, axis=1)
    levels = np.array([column.noise for column in columns])
    jumps = tuple(column.motion.jumps for column in columns)
    return Velocities(found[:, 0], found[:, 1], levels, deviations[1], deviations[0], jumps, causal)


def quantum(values: Array) -> float:
    """The step of which all differences of the values (n,) are multiples; 0 where there is none."""
    gaps = np.diff(np.unique(values))
    gaps = (
        gaps[gaps > 1e-7 * np.abs(values).max()] if len(gaps) else gaps
    )  # below, rounding of single precision
    if not len(gaps):
        return 0.0
    step = float(np.mean(gaps[gaps < 1.5 * gaps.min()]))
    whole = np.abs(gaps / step - np.round(gaps / step)) < 0.05
    return step if len(gaps) > 2 and whole.all() else 0.0


@dataclass(frozen=True, eq=False)
class _Column:
    """One position: its motion, the standard deviation of its noise and q / r of largest
    likelihood.
    """

    motion: Motion
    noise: float
    ratio: float

    @staticmethod
    def of(time: Array, measured: Array, noise: float | None) -> "_Column":
        motion = Motion(time, measured, ORDER, NOTHING, unit=float(np.median(np.diff(time))))
        if np.ptp(measured) == 0:
            return _Column(motion, 0.0, float(np.exp(LEAST)))
        least = quantum(measured) / np.sqrt(12)
        for _ in range(ROUNDS):
            column = _likeliest(motion, noise, least)
            more = _jumps(column)
            if not len(more):
                break
            motion = replace(motion, jumps=np.union1d(motion.jumps, more).astype(np.int64))
        return column

    def smoothed(self) -> tuple[Array, Array]:
        """Position and velocity (n, 2), and the standard deviations (2,) of their errors: noise
        that comes through, and lost motion.

        What the smoother takes off its own result stands for the motion that it took off the truth.
        What stands still has velocity 0.
        """
        if np.ptp(self.motion.measured) == 0:
            return np.stack(
                [self.motion.measured, np.zeros_like(self.motion.measured)], axis=1
            ), np.zeros(2)
        states = self.motion.smoothed(self.ratio, self.motion.measured[:, None])[:, :2, 0]
        signs = np.random.default_rng(0).choice(
            [-1.0, 1.0], size=(len(states), PROBES)
        )  # always the same: a trace's estimate
        probes = self.motion.smoothed(self.ratio, np.concatenate([states[:, :1], signs], axis=1))[
            :, :2
        ]
        lost = np.mean((probes[:, :, 0] - states)[ORDER:-ORDER] ** 2, axis=0)
        through = np.mean(probes[:, :, 1:] ** 2, axis=(0, 2))
        return states, np.sqrt(self.noise**2 * through + lost)


def _likeliest(motion: Motion, noise: float | None, least: float) -> _Column:
    """The column with the noise level, if it is not known, and the ratio of largest likelihood."""
    blocks = _blocks(motion)

    def fits(ratio: float) -> Array:
        return np.sum([block.fit(ratio) for block in blocks], axis=0)

    def free(log_ratio: float) -> float:
        squares, determinant, degrees = fits(float(np.exp(log_ratio)))
        return float(degrees * np.log(squares / degrees) + determinant)

    def fixed(log_ratio: float, level: float) -> float:
        squares, determinant, degrees = fits(float(np.exp(log_ratio)))
        return float(squares / level**2 + degrees * np.log(level**2) + determinant)

    if noise is None:
        ratio = _minimum(free)
        squares, _, degrees = fits(ratio)
        found = float(np.sqrt(squares / degrees))
        if found >= least:
            return _Column(motion, found, ratio)
        noise = least
    level = noise
    return _Column(motion, level, _minimum(lambda log_ratio: fixed(log_ratio, level)))


def _blocks(motion: Motion) -> list[Motion]:
    """The motion, or evenly spread pieces of a long one."""
    n = len(motion.time)
    if n <= BLOCKS * BLOCK:
        return [motion]
    starts = np.linspace(0, n - BLOCK, BLOCKS).astype(int)
    return [_piece(motion, slice(start, start + BLOCK)) for start in starts]


def _piece(motion: Motion, rows: slice) -> Motion:
    inside = motion.jumps[(motion.jumps > rows.start) & (motion.jumps < rows.stop)] - rows.start
    return replace(motion, time=motion.time[rows], measured=motion.measured[rows], jumps=inside)


def _minimum(function: Callable[[float], float]) -> float:
    """Exp of where a function of log q / r is smallest, within the bounds: a grid, then Brent's
    method.
    """

    def guarded(x: float) -> float:
        try:
            return function(x)
        except np.linalg.LinAlgError:  # so stiff that rounding wins
            return np.inf

    grid = np.arange(LEAST, LARGEST + GRID / 2, GRID)
    best = grid[int(np.argmin([guarded(float(x)) for x in grid]))]
    bounds = (max(LEAST, best - GRID), min(LARGEST, best + GRID))
    return float(
        np.exp(minimize_scalar(guarded, bounds=bounds, method="bounded", options={"xatol": 0.02}).x)
    )


def _jumps(column: _Column) -> Ints:
    """Rows before which the velocity jumps: steps that stand out from all and from their
    surroundings, more than the acceleration does.

    A jump of the acceleration, as under a switched command, shows first in the acceleration's own
    scores.
    """
    scores = np.abs(column.motion.scores(column.ratio))
    scores[column.motion.jumps - 1] = 0.0
    scores = scores[:, 1:] / deviation(scores[:, 1:])  # (n - 1, 2) of velocity and acceleration
    width = max(
        2 * ORDER, int(3 * column.ratio ** (-0.5 / ORDER))
    )  # steps over which the smoother reaches
    taken = [0, *(column.motion.jumps - 1).tolist(), len(scores)]
    found: list[int] = []
    for k in np.argsort(-scores[:, 0])[: len(scores) // width].tolist():
        if scores[k, 0] <= GATE:
            break
        if min(abs(k - other) for other in taken) <= width:
            continue
        around = np.concatenate(
            [
                scores[max(0, k - 10 * width) : k - width + 1, 0],
                scores[k + width : k + 10 * width, 0],
            ]
        )
        here = scores[k - width : k + width, 1].max()
        taken.append(k)
        if scores[k, 0] > ABOVE * np.sqrt(np.mean(around**2)) and here < BELOW * scores[k, 0]:
            found.append(k)
    return np.array(sorted(_placed(column, k + 1, width) for k in found), dtype=np.int64)


def _placed(column: _Column, row: int, width: int) -> int:
    """The row, of those beside, at which the motion begins anew with the largest likelihood."""
    first = max(0, row - 10 * width)
    piece = replace(_piece(column.motion, slice(first, row + 10 * width)), jumps=NOTHING)
    options = [row, row - 1, row + 1, row - 2, row + 2]
    fits = [
        replace(piece, jumps=np.array([option - first])).fit(column.ratio) for option in options
    ]
    return options[
        int(
            np.argmin([squares / column.noise**2 + determinant for squares, determinant, _ in fits])
        )
    ]
