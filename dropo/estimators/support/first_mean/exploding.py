"""Segments whose simulation blows up wherever the search may end: named, and left out."""

from dataclasses import dataclass, replace

import numpy as np

from dropo.core.contracts.estimator import Run
from dropo.core.contracts.problem import Problem
from dropo.core.numerics.diverged_simulations import ranges
from dropo.core.numerics.sobol import sobol_points
from dropo.core.records.trajectories import Ints, Segments
from dropo.core.services.validation import Array


@dataclass(frozen=True)
class ExplodingSettings:
    """Which segments blow up, and how many may be left out.

    Attributes
    ----------
    far : float
        A prediction that is off by more than so many ranges of its signal has blown up; of signals
        that do not vary, by more than so many units.
    points : int
        So many points around an estimate are tried, a power of 2.
    width : float
        Half width of the box that they fill, as a fraction of each parameter's interval.
    often : int
        A segment blows up that does so at the estimate, or at so many of the points around.
    most : float
        Where more than this share of the segments blows up, the model is wrong, and none is left
        out.
    named : int
        A warning names so many of the segments.
    """

    far: float = 100.0
    points: int = 8
    width: float = 0.02
    often: int = 2
    most: float = 0.2
    named: int = 3


SETTINGS = ExplodingSettings()


def without_exploding(
    problem: Problem, run: Run, mean: Array, settings: ExplodingSettings = SETTINGS
) -> Problem | None:
    """Leave out the segments whose simulation blows up around an estimate.

    Parameters
    ----------
    problem : Problem
    run : Run
        Counts the simulations.
    mean : (d,) array
        The estimate.
    settings : ExplodingSettings

    Returns
    -------
    Problem or None
        Without them, and with a warning that names them; None where there are none, or too many.
    """
    space = problem.space
    exponent = int(np.log2(settings.points))
    cube = 2 * sobol_points(len(space), exponent, np.random.default_rng(0)) - 1
    around = mean + settings.width * (space.high - space.low) * cube
    points = np.concatenate([mean[None], space.clip(around)])
    count = np.zeros(len(problem.segments), dtype=np.int64)
    for place, point in enumerate(points):
        with run.counting(evaluations=1):
            predicted = problem.simulator.predict(point[None], problem.segments)[0]
        weight = settings.often if place == 0 else 1
        count[exploded(problem, predicted, settings)] += weight
    return _left_out(problem, run, mean, np.flatnonzero(count >= settings.often), settings)


def without_exploded(
    problem: Problem,
    run: Run,
    mean: Array,
    predicted: Array,
    settings: ExplodingSettings = SETTINGS,
) -> Problem | None:
    """Leave out the segments that have blown up in the predictions of a fit.

    Parameters
    ----------
    problem : Problem
    run : Run
        Counts the simulations, of the segments that are named alone.
    mean : (d,) array
        The fit's mean.
    predicted : (R, p) array
        Its mean predictions.
    settings : ExplodingSettings

    Returns
    -------
    Problem or None
        As `without_exploding`.
    """
    return _left_out(problem, run, mean, exploded(problem, predicted, settings), settings)


def exploded(problem: Problem, predicted: Array, settings: ExplodingSettings = SETTINGS) -> Ints:
    """Find the segments with a prediction (R, p) that is not finite, or far off.

    Parameters
    ----------
    problem : Problem
    predicted : (R, p) array
    settings : ExplodingSettings

    Returns
    -------
    (n,) array of int
        Their numbers.
    """
    targets = problem.simulator.targets(problem.segments)
    far = _off(predicted, targets, targets) > settings.far
    return np.unique(problem.segments.rows[0][far.any(axis=1)])


def _off(predicted: Array, targets: Array, every: Array) -> Array:
    """(R, p) how many ranges of all targets predictions are off; infinitely where not finite."""
    reach = ranges(every)
    reach = np.where(np.isfinite(reach), reach, 1.0)
    return np.asarray(np.nan_to_num(np.abs(predicted - targets), nan=np.inf) / reach)


def _left_out(
    problem: Problem, run: Run, mean: Array, segments: Ints, settings: ExplodingSettings
) -> Problem | None:
    """The problem without some segments, where they are few."""
    every = problem.segments
    if not len(segments) or len(segments) > settings.most * len(every):
        return None
    chained = len(every.levels) > 1
    if chained:  # what goes on from a segment that blew up has no start
        behind = np.zeros(len(every), dtype=bool)
        behind[segments] = True
        for i in np.flatnonzero(every.previous >= 0):
            behind[i] |= behind[every.previous[i]]
        segments = np.flatnonzero(behind)
    rows = every.steps[segments]
    kept = np.setdiff1d(np.arange(len(every.trajectories)), rows[rows >= 0])
    if not len(kept):
        return None
    count = f"{len(segments)} of {len(every)} segments"
    which = _named(problem, run, mean, segments[: settings.named], settings)
    more = len(segments) - settings.named
    further = f", and {more} more" if more > 0 else ""
    sentence = f"the simulation of {count} blows up, which are left out: {which}{further}"
    return replace(
        problem,
        trajectories=every.trajectories.rows(kept),
        warnings=(*problem.warnings, sentence),
    )


def _named(
    problem: Problem, run: Run, mean: Array, chosen: Ints, settings: ExplodingSettings
) -> str:
    """Segments by number and trajectory, with the time and the signal in which they blow up."""
    every = problem.segments
    if len(every.levels) > 1:
        own = every.comparing_every_step()
        wanted = chosen
    else:
        own = every.take(chosen).comparing_every_step()
        wanted = np.arange(len(chosen))
    with run.counting(evaluations=1):
        predicted = problem.simulator.predict(mean[None], own)[0]
    off = _off(predicted, problem.simulator.targets(own), problem.simulator.targets(every))
    names = []
    for number, place in zip(chosen.tolist(), wanted.tolist(), strict=True):
        rows = np.flatnonzero(own.rows[0] == place)
        names.append(_name(problem, own, number, rows, off[rows], settings))
    return "; ".join(names)


def _name(
    problem: Problem,
    own: Segments,
    number: int,
    rows: Ints,
    off: Array,
    settings: ExplodingSettings,
) -> str:
    """One segment, of whose rows (n, p) numbers say how far off they are."""
    bad = np.flatnonzero((off > settings.far).any(axis=1))
    segment = int(own.rows[0][rows[0]])
    first = int(own.steps[segment, 0])
    trajectory = int(own.trajectories.trajectory[first])
    where = f"segment {number} (trajectory {trajectory}, {_time(problem, first)})"
    if not len(bad):  # at a point beside the estimate
        return where
    step = int(bad[0])
    # Of a row that is not finite, the signal that was farthest off a step before.
    known = step if np.isfinite(off[step]).all() else step - 1
    steps = f"{step + 1} step" + ("s" if step else "")
    if known < 0:
        return f"{where} in all signals after {steps}"
    signal = problem.simulator.signals[int(off[known].argmax())]
    return f"{where} in {signal.name} after {steps}"


def _time(problem: Problem, row: int) -> str:
    """When a row of the data was, in seconds where these are known."""
    data = problem.trajectories
    if data.time is not None:
        return f"{data.time[row]:.4g} s"
    start = next(start for start, stop in data.spans if start <= row < stop)
    if problem.simulator.control_step is None:
        return f"row {row - start}"
    return f"{(row - start) * problem.simulator.control_step:.4g} s"
