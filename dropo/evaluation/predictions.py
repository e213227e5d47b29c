"""What a fit predicts beside what was measured, and beside what was known before it."""

import warnings
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from dropo.core.contracts.problem import Problem
from dropo.core.numerics.tails import student_below
from dropo.core.records.fits.fit import Fit
from dropo.core.records.predictions import LEVEL, Predictions, Side
from dropo.core.records.trajectories import Ints, Segments
from dropo.core.services.validation import Array
from dropo.evaluation.held_out import (
    DataPart,
    HorizonErrors,
    compared_segments,
    errors_of,
    horizon_segments,
    noise_free_spread,
    rms_of_motion,
    stated_noise,
    whole_part,
)
from dropo.evaluation.whole_run import whole_run


@dataclass(frozen=True)
class PredictionSettings:
    """How much of the data is predicted, and by how many draws.

    Attributes
    ----------
    horizons : tuple of int
        Control steps after which errors are given; the last one is the length of the windows that
        are shown, too.
    shown : int
        Windows that are kept, one after another.
    rows : int
        Control steps, about, in the segments that the calibration is taken from.
    draws : int
        Draws of the parameters.
    noise_draws : int
        Draws of the noise for each draw of the parameters.
    """

    horizons: tuple[int, ...] = (1, 2, 5, 10, 20)
    shown: int = 4
    rows: int = 240
    draws: int = 24
    noise_draws: int = 8


SETTINGS = PredictionSettings()


@dataclass(frozen=True, eq=False)
class _PredictedParts:
    """Which of the data are predicted: shown one after another, for the calibration, for errors by
    horizon, and for errors by signal.
    """

    part: DataPart
    shown: Segments
    calibration: Segments
    by_horizon: list[Segments]
    by_signal: Segments
    spread: Array


def predict(
    problem: Problem,
    fit: Fit,
    *,
    rng: np.random.Generator | int | None = 0,
    settings: PredictionSettings = SETTINGS,
) -> Predictions:
    """Return windows replayed from their measured starts, under the fit and under what was known.

    Before the fit, that is the model's own numbers, or the middle of the search intervals where
    there are none or the data were simulated from them; the band is that of parameters drawn evenly
    from the search intervals. After it, the fitted mean, and draws of the fitted distribution.
    Both bands hold the measurements' noise too.

    Parameters
    ----------
    problem : Problem
        The data are those held out, where it has such.
    fit : Fit
        Of the problem.
    rng : numpy.random.Generator
        A generator or a seed.
    settings : PredictionSettings
        How much is predicted.

    Returns
    -------
    Predictions
        The windows, errors by horizon and by signal, and the calibration.
    """
    generator = np.random.default_rng(rng)
    problem = problem.using(horizon=_horizon(fit))
    simulator = problem.simulator
    name, value = _known_before(problem)
    box = problem.space.from_unit(generator.random((settings.draws, len(problem.space))))
    places = _places(problem, settings)
    sigma = np.sqrt(np.nan_to_num(np.broadcast_to(fit.epsilon, (len(simulator.signals),))))
    drawn = fit.sample(settings.draws, generator)
    before = np.concatenate([value[None], box])
    after = np.concatenate([fit.mean[None], drawn])
    sides = [
        _side(problem, label, values, places, sigma, generator, settings)
        for label, values in ((name, before), ("fitted distribution", after))
    ]
    data = places.part.trajectories
    rows = places.shown.steps[:, 0]
    origins = np.array([start for start, _ in data.spans])
    held_out = np.full(len(data), problem.held_out is not None)
    seen = DataPart(data, data.trajectory, held_out)
    horizons = np.array([int(one.lengths.max()) for one in places.by_horizon], dtype=np.int64)
    noise = rms_of_motion(sigma**2, places.spread) if np.any(sigma > 0) else np.nan
    return Predictions(
        names=tuple(s.name for s in simulator.signals),
        units=tuple(s.unit for s in simulator.signals),
        seconds=np.nan if simulator.control_step is None else simulator.control_step,
        begins=rows - origins[data.trajectory[rows]],
        measured=_by_window(simulator.targets(places.shown), places.shown),
        rows=data.next_observations[places.shown.steps],
        spread=places.spread,
        horizons=horizons,
        noise=np.full(len(horizons), noise),
        rows_after=int(places.by_signal.lengths.max()),
        held_out=problem.held_out is not None,
        before=sides[0],
        after=sides[1],
        run=whole_run(problem, simulator, seen, (value, fit.mean), int(horizons[-1])),
    )


def _horizon(fit: Fit) -> int | None:
    """The horizon that the fit chose [control steps]; None where it chose none."""
    return None if fit.horizon_choice is None else fit.horizon_choice.chosen


def _known_before(problem: Problem) -> tuple[str, Array]:
    """What stood for the parameters before any fit, in words and as (d,)."""
    nominal = problem.simulator.nominal
    if nominal is None or problem.truth is not None:
        middle = np.full(len(problem.space), 0.5)
        return "middle of the search intervals", problem.space.from_unit(middle)
    return "the model's own numbers", np.asarray(nominal, dtype=float)


def _places(problem: Problem, settings: PredictionSettings) -> _PredictedParts:
    """The data held out, or all where nothing is, as segments for each purpose."""
    data = problem.trajectories if problem.held_out is None else problem.held_out
    part = whole_part(data)
    longest = max(stop - start for start, stop in data.spans)
    horizons = sorted({min(horizon, longest) for horizon in settings.horizons})
    segments = problem.cut(data)
    count = max(1, int(settings.rows / segments.lengths.mean()))
    return _PredictedParts(
        part=part,
        shown=_shown(problem, part, horizons[-1], settings.shown),
        calibration=segments.take(segments.thin(count)),
        by_horizon=[horizon_segments(problem, part, horizon) for horizon in horizons],
        by_signal=compared_segments(problem, part),
        spread=noise_free_spread(problem.simulator, part, stated_noise(problem)),
    )


def _shown(problem: Problem, part: DataPart, length: int, count: int) -> Segments:
    """Windows one after another, in the middle of the longest trajectory; the first trajectories
    where the state in the middle of one is not all measured.
    """
    data = part.trajectories
    starts = [np.arange(start, stop - length + 1, length) for start, stop in data.spans]
    if problem.reset != "transition":
        first: Ints = np.concatenate([own[:1] for own in starts]).astype(np.int64)
        return data.from_rows(first[:count], length, every_step=True)
    longest = starts[int(np.argmax([stop - start for start, stop in data.spans]))]
    middle = max(0, (len(longest) - count) // 2)
    return data.from_rows(longest[middle : middle + count], length, every_step=True)


def _side(
    problem: Problem,
    name: str,
    values: Array,
    places: _PredictedParts,
    sigma: Array,
    rng: np.random.Generator,
    settings: PredictionSettings,
) -> Side:
    """What one model predicts; values: (1 + K, d), the line's and the band's."""
    simulator = problem.simulator
    predicted = simulator.predict(values, places.shown)
    shape = (len(values) - 1, settings.noise_draws, *predicted.shape[1:])
    drawn = predicted[1:, None] + sigma * rng.standard_normal(shape)
    levels = [(1 - LEVEL) / 2, (1 + LEVEL) / 2]
    ends = _quantiles(drawn.reshape(-1, *predicted.shape[1:]), levels)
    draws = simulator.predict(values[1:], places.calibration)
    targets = simulator.targets(places.calibration)
    by_horizon = [_errors(problem, values[0], segments, places) for segments in places.by_horizon]
    return Side(
        name=name,
        line=_by_window(predicted[0], places.shown),
        band=np.stack([_by_window(end, places.shown) for end in ends]),
        by_horizon=np.array([errors.overall for errors in by_horizon]),
        by_signal=_errors(problem, values[0], places.by_signal, places).by_signal,
        pit=_pit(draws, targets, sigma, problem.noise_degrees),
    )


def _errors(
    problem: Problem, value: Array, segments: Segments, places: _PredictedParts
) -> HorizonErrors:
    """The errors of one parameter vector (d,) on some segments."""
    predictions = problem.simulator.predict(value[None], segments)
    return errors_of(problem.simulator, predictions, segments, places.spread)[0]


def _pit(draws: Array, targets: Array, sigma: Array, degrees: float | None) -> Array:
    """(R p,) the share of the prediction (K, R, p), with its noise, below each target (R, p)."""
    tiny = 1e-12 * np.maximum(np.abs(targets).max(axis=0), 1e-300)
    z = (targets - draws) / np.maximum(sigma, tiny)
    below = np.mean(ndtr(z) if degrees is None else student_below(z, degrees), axis=0)
    return np.asarray(below[np.isfinite(below)])


def _by_window(rows: Array, segments: Segments) -> Array:
    """(W L, p) -> (W, L, p)."""
    return rows.reshape(len(segments), segments.steps.shape[1], -1)


def _quantiles(draws: Array, shares: list[float]) -> Array:
    """Over the first axis, without draws that failed; NaN where all did."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # all failed
        return np.asarray(np.nanquantile(draws, shares, axis=0))
