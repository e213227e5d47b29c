"""Windows held out beside what the model predicts, as it was and with what was found."""

import numpy as np
from scipy import stats

from dropo.core.contracts.problem import Problem
from dropo.core.records.predictions import LEVEL, Predictions, Side
from dropo.core.records.trajectories import Ints
from dropo.core.services.validation import Array
from dropo.diagnosis.search.linearization import Library, LinearizedWindows, linearize, moved
from dropo.diagnosis.search.selection import State
from dropo.diagnosis.search.whitening import DEGREES
from dropo.diagnosis.search.windows import FEWEST, Windows, held_out_windows, spread_of

REACHES = (
    20,
    10,
    5,
    1,
    # control steps: the longest of which there are enough windows, unless those of the diagnosis are
    # longer
)
# windows that are kept; control steps, about, that errors are taken from
SHOWN = 4
JUDGED = 320
ENTRIES = 400  # of a window that are made independent of each other


def motion(problem: Problem, library: Library, first: State, last: State) -> Predictions | None:
    """None where the data held out are too few."""
    reaches = sorted({*REACHES, last.test.windows.length}, reverse=True)
    tried = (held_out_windows(problem, reach, max(FEWEST, JUDGED // reach)) for reach in reaches)
    windows = next((found for found in tried if len(found) >= FEWEST), None)
    if windows is None:
        return None
    end = linearize(library, windows, last.theta, last.train.whiten.sigma)
    begin = moved(library, end, first.theta, first.train.whiten.sigma)
    spread = spread_of(library.simulator, windows)
    shown = _neighbours(windows)
    steps = windows.segments.steps[shown, 0]
    begins = (
        steps
        - np.array([start for start, _ in windows.segments.trajectories.spans])[
            windows.segments.trajectories.trajectory[steps]
        ]
    )
    names = (
        "the model as it is",
        "the model with the cause" if last.accepted else "the model as it is",
    )
    sides = [
        _side(name, seen, state, shown, spread)
        for name, seen, state in zip(names, (begin, end), (first, last), strict=True)
    ]
    noise = _deviations(end) ** 2
    step = library.simulator.control_step
    return Predictions(
        tuple(s.name for s in library.simulator.signals),
        tuple(s.unit for s in library.simulator.signals),
        np.nan if step is None else step,
        begins,
        _by_window(windows.measured, spread)[shown],
        windows.segments.trajectories.next_observations[windows.segments.steps[shown]],
        spread,
        np.sqrt(np.mean(_by_window(noise, spread)[~end.lost] / spread**2, axis=(0, 2))),
        last.test.windows.length,
        True,
        *sides,
    )


def _side(name: str, seen: LinearizedWindows, state: State, shown: Ints, spread: Array) -> Side:
    line = seen.predicted + seen.shift
    half = stats.t.ppf((1 + LEVEL) / 2, DEGREES) * _deviations(seen)
    errors = _by_window(seen.windows.measured - line, spread)[~seen.lost] / spread
    ends = state.test.residuals[~state.test.lost, -len(spread) :]
    return Side(
        name,
        _by_window(line, spread)[shown],
        np.stack([_by_window(line + sign * half, spread)[shown] for sign in (-1, 1)]),
        np.sqrt(np.mean(errors**2, axis=(0, 2))),
        np.sqrt(np.mean(ends**2, axis=0)),
        _pit(state.test),
    )


def _deviations(seen: LinearizedWindows) -> Array:
    """(W, n) standard deviations by the noise of the measurement and of the measured start."""
    return np.sqrt(
        seen.whiten.rows**2 + np.sum((seen.whiten.loadings * seen.whiten.scale) ** 2, axis=2)
    )


def _pit(seen: LinearizedWindows) -> Array:
    """Probabilities below the residuals of some steps, made independent by the Cholesky factor of
    each window's covariance.
    """
    good = ~seen.lost
    length = seen.windows.length
    p = len(seen.whiten.sigma)
    steps = np.unique(
        np.linspace(0, length - 1, max(1, min(length, ENTRIES // p))).round().astype(np.int64)
    )
    entries = (steps[:, None] * p + np.arange(p)).ravel()
    loadings = (seen.whiten.loadings * seen.whiten.scale)[good][:, entries]
    covariance = loadings @ loadings.swapaxes(1, 2) + np.diag(seen.whiten.rows[entries] ** 2)
    white = np.linalg.solve(np.linalg.cholesky(covariance), seen.residuals[good][:, entries, None])
    return np.asarray(stats.t.cdf(white.ravel(), DEGREES))


def _neighbours(windows: Windows) -> Ints:
    """Windows one after another: the first of the block that has most."""
    most = np.bincount(windows.block).argmax()
    return np.flatnonzero(windows.block == most)[:SHOWN]


def _by_window(rows: Array, spread: Array) -> Array:
    """(W, L p) -> (W, L, p)."""
    return rows.reshape(len(rows), -1, len(spread))
