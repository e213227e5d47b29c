"""Velocities from logged positions, with the noise level of both.

They come from a smoother, or from a filter that knows the past alone. In reading order:
`estimate_velocities` fits a `_Column` to each position; `_fit_column` finds the noise level and the
bandwidth of largest likelihood, and `_find_jumps` the rows at which the velocity jumps.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import reduce
from operator import add

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import minimize_scalar

from dropo.core.numerics.robust_statistics import deviation
from dropo.core.records.trajectories import Ints
from dropo.core.services.validation import Array, float_array, require
from dropo.logs.signals.integrated_noise import (
    IntegratedNoise,
    LikelihoodTerms,
    filter_motions,
)

ORDER = 3
"""Numbers in a state: position, velocity and acceleration, which is a random walk.

Of 2, 3 and 4 the one whose stated noise levels are right on most motions.
"""


@dataclass(frozen=True)
class VelocitySettings:
    """How noise level, bandwidth and jumps of a position are found.

    q is the density of the random walk of the acceleration, r the variance of the measurement.

    Attributes
    ----------
    longest : float
        Median steps of time in a step: what is longer is no clock.
    lowest : float
        Lower bound of log(q / r), in steps of the median time.
    highest : float
        Upper bound of log(q / r), in steps of the median time.
    grid_step : float
        Step of log(q / r) in the first search between these bounds.
    tolerance : float
        Tolerance of log(q / r) in the search that follows.
    blocks : int
        Largest number of pieces on which a long log is fitted.
    block_rows : int
        Number of rows of such a piece.
    jump_score : float
        Score that a jump of the velocity must have, in standard deviations of all scores.
    jump_contrast : float
        Multiple of the scores around it that a jump's score must be.
    jump_sharpness : float
        Multiple of the velocity's score that the acceleration's score must be below at a jump.
    jump_width : float
        Steps either side in which a jump shows, in units of the smoother's (q / r)^(-1 / 6).
    jump_reach : int
        The surroundings of a jump reach so many of these widths either side.
    jump_rounds : int
        Number of fits at most; between one and the next, jumps are searched for.
    probes : int
        Number of columns of random signs that show how much noise passes the smoother (Hutchinson
        1990).
    """

    longest: float = 1e9
    lowest: float = -30.0
    highest: float = 10.0
    grid_step: float = 4.0
    tolerance: float = 0.02
    blocks: int = 20
    block_rows: int = 1000
    jump_score: float = 8.0
    jump_contrast: float = 6.5
    jump_sharpness: float = 1.95
    jump_width: float = 3.0
    jump_reach: int = 10
    jump_rounds: int = 5
    probes: int = 8


DEFAULTS = VelocitySettings()
NO_JUMPS: Ints = np.empty(0, dtype=np.int64)


@dataclass(frozen=True, eq=False)
class Velocities:
    """Smoothed or filtered positions, and their velocities.

    Attributes
    ----------
    positions, velocities : (n, p) array
        The estimates.
    position_noise : (p,) array
        Standard deviation of the noise of the measured positions.
    velocity_noise : (p,) array
        Standard deviation of the errors of `velocities`, which are correlated over the width of the
        smoother.
    smoothed_noise : (p,) array
        Standard deviation of the errors of `positions`.
    jumps : tuple of int array
        For each column the rows before which the velocity jumped (an impact), so that nothing was
        smoothed across.
    causal : bool
        Whether only measurements up to a row were used.
    """

    positions: Array
    velocities: Array
    position_noise: Array
    velocity_noise: Array
    smoothed_noise: Array
    jumps: tuple[Ints, ...]
    causal: bool = False


def estimate_velocities(
    time: ArrayLike,
    positions: ArrayLike,
    *,
    noise: ArrayLike | None = None,
    causal: bool = False,
    settings: VelocitySettings = DEFAULTS,
) -> Velocities:
    """Estimate velocities from measured positions.

    Parameters
    ----------
    time : (n,) array
        Strictly increasing instants [s], also unevenly spaced.
    positions : (n, p) array
        Measured then; angles must be unwrapped.
    noise : (p,) array, optional
        Standard deviations of the measurements, where they are known.
    causal : bool
        Use a filter, for what must not know the future: its errors are larger, and it catches up
        behind a jump. By default a smoother, split at jumps.
    settings : VelocitySettings, optional
        How noise level, bandwidth and jumps are found.

    Returns
    -------
    Velocities

    Raises
    ------
    BadArgument
        If an array has another shape or is not finite, there are fewer than 7 rows, `time` does not
        increase, or `noise` is not above 0.

    Notes
    -----
    Each column's acceleration is a random walk seen through white noise; the noise level and the
    smoother's bandwidth are those of largest likelihood. A quantised column has at least the noise
    of its steps, step / sqrt(12).
    """
    caller = "estimate_velocities"
    stamps = float_array("time", time, (None,), caller)
    rows = float_array("positions", positions, (len(stamps), None), caller)
    rule = f"at least {2 * ORDER + 1} rows"
    require(len(stamps) > 2 * ORDER, "positions", rule, len(stamps), caller)
    increasing = bool((np.diff(stamps) > 0).all())
    require(increasing, "time", "strictly increasing", "instants that are not", caller)
    steps = np.diff(stamps)
    rule = f"without a step of more than {settings.longest:g} usual ones"
    longest = int(steps.argmax())
    got = f"one of {steps[longest]:.3g} s, to row {longest + 1}"
    require(steps[longest] <= settings.longest * np.median(steps), "time", rule, got, caller)
    levels: list[float | None] = [None] * rows.shape[1]
    if noise is not None:
        known = float_array("noise", noise, (rows.shape[1],), caller)
        require(bool((known > 0).all()), "noise", "above 0", known, caller)
        levels = list(known.tolist())

    columns = []
    for measured, level in zip(rows.T, levels, strict=True):
        columns.append(_fit_column(stamps, measured, level, settings))
    smoothed = [_estimate_column(column, settings) for column in columns]
    estimates = np.stack([states for states, _ in smoothed], axis=2)  # (n, 2, p)
    errors = np.stack([deviations for _, deviations in smoothed], axis=1)  # (2, p)
    if causal:
        motions = [column.motion for column in columns]
        ratios = np.array([column.ratio for column in columns])
        filtered = np.stack(list(filter_motions(motions, ratios)[:, :, :2]), axis=2)
        # The smoother's errors, and by how much the filter differs from the smoother.
        difference = np.mean((filtered - estimates)[2 * ORDER :] ** 2, axis=0)
        errors = np.sqrt(errors**2 + difference)
        estimates = filtered
    return Velocities(
        positions=estimates[:, 0],
        velocities=estimates[:, 1],
        position_noise=np.array([column.noise for column in columns]),
        velocity_noise=errors[1],
        smoothed_noise=errors[0],
        jumps=tuple(column.motion.jumps for column in columns),
        causal=causal,
    )


def quantum(values: Array) -> float:
    """Find the step of which all differences of values are multiples.

    Parameters
    ----------
    values : (n,) array
        The values.

    Returns
    -------
    float
        The step, in their unit; 0 where there is none.
    """
    steps = np.diff(np.unique(values))
    if len(steps):
        steps = steps[steps > 1e-7 * np.abs(values).max()]  # below, rounding of single precision
    if not len(steps):
        return 0.0
    # The steps below one and a half of the smallest are single ones; all are whole multiples.
    step = float(np.mean(steps[steps < 1.5 * steps.min()]))
    multiples = steps / step
    is_whole = np.abs(multiples - np.round(multiples)) < 0.05
    return step if len(steps) > 2 and is_whole.all() else 0.0


# One position


@dataclass(frozen=True, eq=False)
class _Column:
    """One position: its motion, the standard deviation of its noise, and q / r.

    The noise is in the position's unit, the ratio in the motion's inner unit of time.
    """

    motion: IntegratedNoise
    noise: float
    ratio: float


def _fit_column(
    time: Array, measured: Array, noise: float | None, settings: VelocitySettings
) -> _Column:
    """The column with its jumps, and noise and ratio of largest likelihood."""
    unit = float(np.median(np.diff(time)))
    motion = IntegratedNoise(time, measured, ORDER, NO_JUMPS, unit=unit)
    if np.ptp(measured) == 0:
        return _Column(motion, 0.0, float(np.exp(settings.lowest)))
    minimum_noise = quantum(measured) / np.sqrt(12)
    # Where jumps are found, fit anew with them, until none is found or the last fit is made.
    column = _fit_noise(motion, noise, minimum_noise, settings)
    for _ in range(settings.jump_rounds - 1):
        new = _find_jumps(column, settings)
        if not len(new):
            break
        jumps = np.union1d(column.motion.jumps, new).astype(np.int64)
        with_jumps = replace(column.motion, jumps=jumps)
        column = _fit_noise(with_jumps, noise, minimum_noise, settings)
    return column


def _estimate_column(column: _Column, settings: VelocitySettings) -> tuple[Array, Array]:
    """Position and velocity (n, 2), and the standard deviations (2,) of their errors.

    An error has a variance and a bias. The variance is that of the measurements times the gain of
    the smoother. The bias is motion that the smoother takes off: what it takes off its own result
    stands for what it took off the truth. What stands still has velocity 0.
    """
    motion = column.motion
    measured = motion.measured
    if np.ptp(measured) == 0:
        return np.stack([measured, np.zeros_like(measured)], axis=1), np.zeros(2)
    states = motion.smoothed(column.ratio, measured[:, None])[:, :2, 0]
    rng = np.random.default_rng(0)  # always the same: an estimate of a trace
    signs = rng.choice([-1.0, 1.0], size=(len(states), settings.probes))
    # Smooth its own positions again, and noise of unit variance beside them.
    inputs = np.concatenate([states[:, :1], signs], axis=1)
    outputs = motion.smoothed(column.ratio, inputs)[:, :2]
    squared_bias = np.mean((outputs[:, :, 0] - states)[ORDER:-ORDER] ** 2, axis=0)
    variance_gain = np.mean(outputs[:, :, 1:] ** 2, axis=(0, 2))
    return states, np.sqrt(column.noise**2 * variance_gain + squared_bias)


# Noise level and bandwidth


def _fit_noise(
    motion: IntegratedNoise, noise: float | None, minimum: float, settings: VelocitySettings
) -> _Column:
    """The column with the noise level, if it is not known, and the ratio of largest likelihood.

    What is minimised is -2 log L, up to a constant.
    """
    blocks = _blocks(motion, settings)
    if noise is None:
        ratio = _most_likely_ratio(blocks, _cost_of_free_noise, settings)
        terms = _likelihood_terms(blocks, ratio)
        most_likely = float(np.sqrt(terms.squares / terms.degrees))
        if most_likely >= minimum:
            return _Column(motion, most_likely, ratio)
    level = minimum if noise is None else noise

    def cost_of_level(terms: LikelihoodTerms) -> float:
        return _cost_of_known_noise(terms, level)

    return _Column(motion, level, _most_likely_ratio(blocks, cost_of_level, settings))


def _cost_of_free_noise(terms: LikelihoodTerms) -> float:
    """-2 log L at the variance of the noise that is most likely, squares / degrees."""
    return float(terms.degrees * np.log(terms.squares / terms.degrees) + terms.log_determinant)


def _cost_of_known_noise(terms: LikelihoodTerms, level: float) -> float:
    """-2 log L at a standard deviation of the noise."""
    variance = level**2
    return float(
        terms.squares / variance + terms.degrees * np.log(variance) + terms.log_determinant
    )


def _likelihood_terms(blocks: list[IntegratedNoise], ratio: float) -> LikelihoodTerms:
    """The terms of all blocks together."""
    return reduce(add, [block.likelihood_terms(ratio) for block in blocks])


def _blocks(motion: IntegratedNoise, settings: VelocitySettings) -> list[IntegratedNoise]:
    """The motion, or evenly spread pieces of a long one."""
    n = len(motion.time)
    rows = settings.block_rows
    if n <= settings.blocks * rows:
        return [motion]
    starts = np.linspace(0, n - rows, settings.blocks).astype(int)
    return [_piece(motion, slice(start, start + rows)) for start in starts]


def _piece(motion: IntegratedNoise, rows: slice) -> IntegratedNoise:
    """Some rows of a motion, with the jumps in them."""
    inside = motion.jumps[(motion.jumps > rows.start) & (motion.jumps < rows.stop)] - rows.start
    return replace(motion, time=motion.time[rows], measured=motion.measured[rows], jumps=inside)


def _most_likely_ratio(
    blocks: list[IntegratedNoise],
    cost: Callable[[LikelihoodTerms], float],
    settings: VelocitySettings,
) -> float:
    """The ratio q / r of the lowest cost: by a grid of its logarithm, then by Brent's method."""

    def cost_at(log_ratio: float) -> float:
        try:
            return cost(_likelihood_terms(blocks, float(np.exp(log_ratio))))
        except np.linalg.LinAlgError:  # so stiff that rounding wins
            return np.inf

    step = settings.grid_step
    grid = np.arange(settings.lowest, settings.highest + step / 2, step)
    best = grid[int(np.argmin([cost_at(float(x)) for x in grid]))]
    bounds = (max(settings.lowest, best - step), min(settings.highest, best + step))
    found = minimize_scalar(
        cost_at, bounds=bounds, method="bounded", options={"xatol": settings.tolerance}
    )
    return float(np.exp(found.x))


# Jumps


def _find_jumps(column: _Column, settings: VelocitySettings) -> Ints:
    """Rows before which the velocity jumps.

    Such a step has a score of the velocity

    1. that stands out from those of all steps (`jump_score`),
    2. that stands out from those of its surroundings (`jump_contrast`), and
    3. beside which the acceleration's score is not much larger (`jump_sharpness`): a jump of the
       acceleration, as under a switched command, shows first in the acceleration's own scores.
    """
    scores = np.abs(column.motion.scores(column.ratio))  # (n - 1, ORDER), the position's first
    scores[column.motion.jumps - 1] = 0.0
    usual = deviation(scores[:, 1:])
    if not np.all(usual > 0):  # nothing moves
        return NO_JUMPS
    velocity, acceleration = (scores[:, 1:] / usual).T  # a state has these two, as ORDER is 3
    # The smoother's width, in steps: a jump shows in the scores of so many steps either side.
    width = max(2 * ORDER, int(settings.jump_width * column.ratio ** (-0.5 / ORDER)))
    reach = settings.jump_reach * width
    # A step near an end, a known jump or a larger score is not looked at.
    taken = [0, *(column.motion.jumps - 1).tolist(), len(scores)]
    found: list[int] = []
    # Of more steps than one in each width, most would be near another.
    most = len(scores) // width
    largest_first = np.argsort(-velocity).tolist()
    for k in largest_first[:most]:
        if velocity[k] <= settings.jump_score:
            break
        if min(abs(k - other) for other in taken) <= width:
            continue
        taken.append(k)
        before = velocity[max(0, k - reach) : k - width + 1]
        after = velocity[k + width : k + reach]
        around = np.concatenate([before, after])
        stands_out = velocity[k] > settings.jump_contrast * np.sqrt(np.mean(around**2))
        largest_acceleration = acceleration[k - width : k + width].max()
        if stands_out and largest_acceleration < settings.jump_sharpness * velocity[k]:
            found.append(k)
    rows = sorted(_place_jump(column, k + 1, reach) for k in found)
    return np.array(rows, dtype=np.int64)


def _place_jump(column: _Column, row: int, reach: int) -> int:
    """The row, of those beside, at which the motion begins anew with the largest likelihood.

    Only so many rows either side are looked at (reach). Terms of -2 log L that all have are left
    out.
    """
    first = max(0, row - reach)
    piece = replace(_piece(column.motion, slice(first, row + reach)), jumps=NO_JUMPS)
    options = [row, row - 1, row + 1, row - 2, row + 2]
    costs = []
    for option in options:
        with_jump = replace(piece, jumps=np.array([option - first]))
        terms = with_jump.likelihood_terms(column.ratio)
        costs.append(terms.squares / column.noise**2 + terms.log_determinant)
    return options[int(np.argmin(costs))]
