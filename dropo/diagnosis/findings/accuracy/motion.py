"""Windows held out beside what the model predicts, as it was and with what was found."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dropo.core.contracts.problem import Problem
from dropo.core.numerics.tails import student_below, student_quantile
from dropo.core.records.predictions import LEVEL, Predictions, Side
from dropo.core.records.trajectories import Ints
from dropo.core.services.validation import Array
from dropo.diagnosis.findings.accuracy.horizons import Horizon
from dropo.diagnosis.search.linearization import (
    Library,
    LinearizedWindows,
    linearize,
    shift_linearization,
)
from dropo.diagnosis.search.trials import State
from dropo.diagnosis.search.whitening import DEGREES
from dropo.diagnosis.search.windows import SETTINGS as WINDOWS
from dropo.diagnosis.search.windows import Windows, windows_from
from dropo.evaluation.held_out import (
    DataPart,
    held_out_part,
    noise_free_spread,
    thin,
    window_starts,
)
from dropo.evaluation.whole_run import whole_run


@dataclass(frozen=True)
class ShownMotionSettings:
    """What pictures of a diagnosis show of the motion.

    Attributes
    ----------
    lengths : tuple of int
        Control steps in a window that is drawn: the longest of which there are enough, unless the
        diagnosis has longer ones.
    steps : int
        Control steps, about, in the windows from which neighbours are taken.
    shown : int
        Windows that are drawn.
    entries : int
        Measurements of a window that are made independent of each other for the calibration.
    """

    lengths: tuple[int, ...] = (20, 10, 5, 1)
    steps: int = 320
    shown: int = 4
    entries: int = 400


SETTINGS = ShownMotionSettings()


def motion(
    problem: Problem,
    library: Library,
    first: State,
    last: State,
    before: Sequence[Horizon],
    after: Sequence[Horizon],
    settings: ShownMotionSettings = SETTINGS,
) -> Predictions | None:
    """Return measured windows and what both models predict for them.

    Parameters
    ----------
    problem : Problem
        Whose held-out part is shown.
    library : Library
        The simulator with every effect.
    first, last : State
        The model as it is, and with what was found.
    before, after : sequence of Horizon
        Their errors by horizon, which are shown as they are.
    settings : ShownMotionSettings
        How much is shown.

    Returns
    -------
    Predictions or None
        None where the data held out are too few.
    """
    part = held_out_part(problem, last.train.windows.length)
    windows = _neighbours(library, part, last.test.windows.length, settings)
    if windows is None or not after:
        return None
    simulator = library.simulator
    end = linearize(library, windows, last.theta, last.train.whiten.noise)
    begin = shift_linearization(library, end, first.theta, first.train.whiten.noise)
    rows = windows.segments.steps[:, 0]
    data = windows.segments.trajectories
    origins = np.array([start for start, _ in data.spans])
    name = "the model with the cause" if last.accepted else "the model as it is"
    return Predictions(
        names=tuple(s.name for s in simulator.signals),
        units=tuple(s.unit for s in simulator.signals),
        seconds=np.nan if simulator.control_step is None else simulator.control_step,
        begins=rows - origins[data.trajectory[rows]],
        measured=_by_window(windows.measured, len(simulator.signals)),
        rows=data.next_observations[windows.segments.steps],
        spread=noise_free_spread(simulator, part, last.train.whiten.sigma**2),
        horizons=np.array([horizon.steps for horizon in after], dtype=np.int64),
        noise=np.array([horizon.noise for horizon in after]),
        rows_after=last.test.windows.length,
        held_out=True,
        before=_side("the model as it is", begin, first, before, settings),
        after=_side(name, end, last, after, settings),
        run=whole_run(problem, simulator, part, (first.theta, last.theta), windows.length),
    )


def _side(
    name: str,
    linearized: LinearizedWindows,
    state: State,
    errors: Sequence[Horizon],
    settings: ShownMotionSettings,
) -> Side:
    """What one model predicts for the windows that are shown, and its errors."""
    p = len(linearized.whiten.sigma)
    line = linearized.predicted + linearized.shift
    half = student_quantile((1 + LEVEL) / 2, DEGREES) * linearized.whiten.deviations
    own = next((one for one in errors if one.steps == state.test.windows.length), errors[-1])
    return Side(
        name=name,
        line=_by_window(line, p),
        band=np.stack([_by_window(line + sign * half, p) for sign in (-1, 1)]),
        by_horizon=np.array([one.rmse for one in errors]),
        by_signal=own.by_signal,
        pit=_pit(state.test, settings.entries),
    )


def _pit(linearized: LinearizedWindows, entries: int) -> Array:
    """Probabilities below the residuals of some steps, made independent by the Cholesky factor of
    each window's covariance.
    """
    p = len(linearized.whiten.sigma)
    good = ~linearized.lost
    length = linearized.windows.length
    count = max(1, min(length, entries // p))
    steps = np.unique(np.linspace(0, length - 1, count).round().astype(np.int64))
    places = (steps[:, None] * p + np.arange(p)).ravel()
    covariance = linearized.whiten.covariance(places)[good]
    roots = _square_roots(covariance)
    white = np.linalg.solve(roots, linearized.residuals[good][:, places, None])
    return np.asarray(student_below(white.ravel(), DEGREES))


def _square_roots(covariance: Array) -> Array:
    """Square roots (W, n, n) of covariances: Cholesky factors, or where rounding leaves one without
    such a factor, those of its correlations with eigenvalues of at least rounding's size.
    """
    try:
        return np.asarray(np.linalg.cholesky(covariance), dtype=np.float64)
    except np.linalg.LinAlgError:
        sd = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
        correlation = covariance / (sd[:, :, None] * sd[:, None, :])
        values, vectors = np.linalg.eigh(correlation)
        lowest = len(sd[0]) * np.finfo(float).eps * values[:, -1:]
        root = vectors * np.sqrt(np.maximum(values, lowest))[:, None, :]
        return np.asarray(sd[:, :, None] * root)


def _neighbours(
    library: Library, part: DataPart, longest: int, settings: ShownMotionSettings
) -> Windows | None:
    """Windows one after another, of the block that has most; None where there are too few."""
    for length in sorted({*settings.lengths, longest}, reverse=True):
        starts = window_starts(part, length)
        if len(starts) < WINDOWS.fewest:
            continue
        starts = thin(starts, max(WINDOWS.fewest, settings.steps // length))
        block = part.block[starts]
        largest = np.bincount(block).argmax()
        chosen: Ints = np.flatnonzero(block == largest)[: settings.shown]
        segments = part.trajectories.from_rows(starts[chosen], length, every_step=True)
        return windows_from(library.simulator, segments, block[chosen])
    return None


def _by_window(rows: Array, p: int) -> Array:
    """(W, L p) -> (W, L, p)."""
    return rows.reshape(len(rows), -1, p)
