"""What a fit predicts beside what was measured, and beside what was known before it."""

import warnings

import numpy as np
from scipy import stats

from dropo.core.contracts.problem import Problem
from dropo.core.records.fit import Fit
from dropo.core.records.predictions import LEVEL, Predictions, Side
from dropo.core.records.trajectories import Ints, Segments, Trajectories
from dropo.core.services.validation import Array

REACH = 20  # control steps that are predicted from one measurement
# windows that are kept, one after another; and those of the errors by horizon, from all over the
# data
SHOWN = 4
JUDGED = 40
ROWS = 240  # control steps, in rows like those of the fit, for the calibration
# of the parameters; and of the noise, for each of these
DRAWS = 24
REPEATS = 8


def predict(
    problem: Problem, fit: Fit, *, rng: np.random.Generator | int | None = 0
) -> Predictions:
    """Windows of up to 20 control steps replayed from their measured starts, under the fit and
    under what was known before.

    Before: the model's own numbers, or the middle of the search intervals where there are none or
    the data were simulated from them;
    the band is that of parameters drawn evenly from the search intervals. After: the fitted mean,
    and draws of the fitted distribution. Both bands hold the measurements' noise too. The data are
    those held out, where the problem has such.
    """
    generator = np.random.default_rng(rng)
    problem = problem.using(
        length=next(
            (row["lambda"] for row in fit.details.get("lambda_choice", ()) if row["chosen"]), None
        )
    )
    data = problem.trajectories if problem.held_out is None else problem.held_out
    name, value = _known_before(problem)
    box = problem.space.from_unit(generator.random((DRAWS, len(problem.space))))
    shown = _shown(problem, data)
    judged = _judged(problem, data)
    rows = _rows(problem, data)
    sigma = np.sqrt(np.nan_to_num(np.broadcast_to(fit.epsilon, (len(problem.simulator.signals),))))
    targets = problem.simulator.targets(problem.cut(data))
    spread = np.where(np.ptp(targets, axis=0) > 0, np.std(targets, axis=0), 0.0)
    under = {
        name: np.concatenate([value[None], box]),
        "fitted distribution": np.concatenate([fit.mean[None], fit.sample(DRAWS, generator)]),
    }
    sides = [
        _side(problem, label, values, (shown, judged, rows), sigma, spread, generator)
        for label, values in under.items()
    ]
    reach = judged.steps.shape[1]
    noise = np.sqrt(np.mean((sigma / _unit(spread)) ** 2)) if np.any(sigma > 0) else np.nan
    first = np.array([start for start, _ in data.spans])[data.trajectory[shown.steps[:, 0]]]
    step = problem.simulator.control_step
    return Predictions(
        tuple(s.name for s in problem.simulator.signals),
        tuple(s.unit for s in problem.simulator.signals),
        np.nan if step is None else step,
        shown.steps[:, 0] - first,
        _by_window(problem.simulator.targets(shown), shown),
        data.next_observations[shown.steps],
        spread,
        np.full(reach, noise),
        int(rows.lengths.max()),
        problem.held_out is not None,
        *sides,
    )


def _known_before(problem: Problem) -> tuple[str, Array]:
    """What stood for the parameters before any fit, in words and as (d,)."""
    nominal = problem.simulator.nominal
    if nominal is None or problem.truth is not None:
        return "middle of the search intervals", problem.space.from_unit(
            np.full(len(problem.space), 0.5)
        )
    return "the model's own numbers", np.asarray(nominal, dtype=float)


def _shown(problem: Problem, data: Trajectories) -> Segments:
    """Windows one after another, in the middle of the longest trajectory; the first trajectories
    where a window must begin with one.
    """
    begins, length = _begins(problem, data)
    if _from_the_start(problem):
        return data.from_rows(begins[:SHOWN], length, every_step=True)
    longest = int(np.argmax([stop - start for start, stop in data.spans]))
    own = begins[data.trajectory[begins] == longest]
    middle = max(0, (len(own) - SHOWN) // 2)
    return data.from_rows(own[middle : middle + SHOWN], length, every_step=True)


def _judged(problem: Problem, data: Trajectories) -> Segments:
    """Windows from all over the data."""
    begins, length = _begins(problem, data)
    chosen = np.unique(np.linspace(0, len(begins) - 1, JUDGED).round().astype(np.int64))
    return data.from_rows(begins[chosen], length, every_step=True)


def _begins(problem: Problem, data: Trajectories) -> tuple[Ints, int]:
    """Rows at which windows may begin, and how long these are."""
    length = min(REACH, max(stop - start for start, stop in data.spans))
    every = [np.arange(start, stop - length + 1, length) for start, stop in data.spans]
    own = [begins[:1] for begins in every] if _from_the_start(problem) else every
    return np.concatenate(own).astype(np.int64), length


def _from_the_start(problem: Problem) -> bool:
    """Whether the state in the middle of a trajectory is not all measured."""
    return problem.reset != "transition"


def _rows(problem: Problem, data: Trajectories) -> Segments:
    """Segments like those of the fit, as many as make about `ROWS` control steps."""
    segments = problem.cut(data)
    return segments.take(segments.thin(max(1, int(ROWS / segments.lengths.mean()))))


def _side(
    problem: Problem,
    name: str,
    values: Array,
    places: tuple[Segments, Segments, Segments],
    sigma: Array,
    spread: Array,
    rng: np.random.Generator,
) -> Side:
    """values: (1 + K, d), the line's and the band's."""
    simulator = problem.simulator
    (shown, judged, rows) = places
    found = simulator.predict(values, shown)
    drawn = found[1:, None] + sigma * rng.standard_normal(
        (len(values) - 1, REPEATS, *found.shape[1:])
    )
    ends = _quantiles(drawn.reshape(-1, *found.shape[1:]), [(1 - LEVEL) / 2, (1 + LEVEL) / 2])
    errors = _by_window(
        simulator.predict(values[:1], judged)[0] - simulator.targets(judged), judged
    ) / _unit(spread)
    compared = simulator.predict(values, rows)
    targets = simulator.targets(rows)
    return Side(
        name,
        _by_window(found[0], shown),
        np.stack([_by_window(end, shown) for end in ends]),
        _rms(errors, (0, 2)),
        _rms(compared[0] - targets, (0,)),
        _pit(compared[1:], targets, sigma, problem.noise_degrees),
    )


def _pit(draws: Array, targets: Array, sigma: Array, degrees: float | None) -> Array:
    """(R p,) the share of the prediction (K, R, p), with its noise, that lies below each target (R,
    p).
    """
    distribution = stats.norm if degrees is None else stats.t(degrees)
    tiny = 1e-12 * np.maximum(np.abs(targets).max(axis=0), 1e-300)
    below = np.mean(distribution.cdf((targets - draws) / np.maximum(sigma, tiny)), axis=0)
    return np.asarray(below[np.isfinite(below)])


def _unit(spread: Array) -> Array:
    """(p,) what errors are counted in; a signal that does not vary counts for nothing."""
    return np.where(spread > 0, spread, np.inf)


def _by_window(rows: Array, segments: Segments) -> Array:
    """(W L, p) -> (W, L, p)."""
    return rows.reshape(len(segments), segments.steps.shape[1], -1)


def _quantiles(draws: Array, shares: list[float]) -> Array:
    """Over the first axis, without draws that failed; NaN where all did."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # all failed
        return np.asarray(np.nanquantile(draws, shares, axis=0))


def _rms(errors: Array, axes: tuple[int, ...]) -> Array:
    """Without rows that failed; NaN where all did."""
    squares = errors**2
    count = np.isfinite(squares).sum(axis=axes)
    total = np.where(np.isfinite(squares), squares, 0.0).sum(axis=axes)
    return np.sqrt(np.where(count > 0, total, np.nan) / np.maximum(count, 1))
