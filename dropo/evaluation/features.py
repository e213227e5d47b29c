"""What a residual of a correct model cannot follow: state, command, their signs and sizes,
and smooth functions of them.
"""

from dataclasses import dataclass

import numpy as np

from dropo.core.contracts.problem import Problem
from dropo.core.records.trajectories import Ints, Segments
from dropo.core.services.validation import Array
from dropo.evaluation.residual_tests import SETTINGS, ResidualTestSettings, random_features


@dataclass(frozen=True, eq=False)
class Features:
    """Features of compared rows.

    Attributes
    ----------
    names : tuple of str
        Of the F named features.
    named : (n, F) array
        One column a name, of size about 1, the first a constant.
    smooth : (n, F') array
        Random Fourier features of state and command.
    rows : (n,) array
        The compared rows that have features.
    """

    names: tuple[str, ...]
    named: Array
    smooth: Array
    rows: Ints


def features_of(
    problem: Problem,
    predicted: Array,
    rng: np.random.Generator,
    settings: ResidualTestSettings = SETTINGS,
    among: Ints | None = None,
) -> Features:
    """Return features of the compared rows.

    The state is that before the step as the model predicts it from one row earlier, not as it was
    measured there: measured, it would share its noise with the residual. Rows without a row before
    them are left out, unless they are most.

    Parameters
    ----------
    problem : Problem
        Its segments have R compared rows.
    predicted : (R, p) array
        Mean predictions.
    rng : numpy.random.Generator
        Draws the random features.
    settings : ResidualTestSettings
        How many random features there are, and at what a feature is cut.
    among : (n,) array of int, optional
        The rows that may have features, in rising order; by default all.

    Returns
    -------
    Features
        Of state and command, their signs and sizes, and smooth functions of them.
    """
    segments = problem.segments
    if among is None:
        among = np.arange(len(predicted))
    state, state_names, rows = _states(problem, predicted, among)
    action, before, change = _commands(segments, rows)
    count = action.shape[1]
    names = [f"action[{i}]" for i in range(count)] if count > 1 else ["action"] * count
    base = np.concatenate([state, action, before, change], axis=1)
    base_names = [
        *state_names,
        *names,
        *(f"the previous {name}" for name in names),
        *(f"the change of {name}" for name in names),
    ]
    base, base_names = _moving(base, base_names)
    columns = [np.ones((len(rows), 1))]
    labels = ["a constant"]
    for form, function in (("{}", np.positive), ("sign({})", np.sign), ("|{}|", np.abs)):
        values, kept = _moving(function(base), [form.format(name) for name in base_names])
        columns.append(_standard(values, settings.cut))
        labels += kept
    smooth = random_features(_standard(base, settings.cut), rng, settings)
    return Features(tuple(labels), np.concatenate(columns, axis=1), smooth, rows)


def _states(problem: Problem, predicted: Array, among: Ints) -> tuple[Array, list[str], Ints]:
    """The state (n, S) before each row of those where it is known, its names, and these rows."""
    segments = problem.segments
    segment, step = segments.rows
    time = segments.steps[segment, step]
    trajectory = segments.trajectory[segment]
    order = np.lexsort((time, trajectory))
    follows = trajectory[order][1:] == trajectory[order][:-1]
    before = np.full(len(order), -1)
    before[order[1:][follows]] = order[:-1][follows]
    rows = among[before[among] >= 0]
    signals = problem.simulator.signals
    observed = segments.starts.shape[1]
    as_observed = predicted.shape[1] == observed
    names = [f"observation[{i}]" for i in range(observed)]
    if as_observed:
        names = [signal.name for signal in signals]
    if len(rows) < len(among) / 2:
        return segments.starts[segment[among]], names, among
    state = predicted[before[rows]] if as_observed else segments.starts[segment[before[rows]]]
    return state, names, rows


def _commands(segments: Segments, rows: Ints) -> tuple[Array, Array, Array]:
    """(n, q) the mean action from a segment's start to each row, the action before it, and how far
    the row's action is from that.
    """
    segment = segments.rows[0][rows]
    step = segments.rows[1][rows]
    total = np.cumsum(segments.actions, axis=1)[segment, step]
    first = segments.steps[:, 0]
    trajectory = segments.trajectories.trajectory
    same = (first > 0) & (trajectory[first - 1] == trajectory[first])
    earlier = np.where(same, first - 1, first)
    before = segments.trajectories.actions[earlier[segment]]
    return total / (step + 1)[:, None], before, segments.actions[segment, step] - before


def _moving(values: Array, names: list[str]) -> tuple[Array, list[str]]:
    """The columns that change."""
    size = np.maximum(np.abs(values).max(axis=0), 1e-300)
    moves = np.std(values, axis=0) > 1e-9 * size
    return values[:, moves], [name for name, kept in zip(names, moves, strict=True) if kept]


def _standard(values: Array, cut: float) -> Array:
    """The columns with a standard deviation of 1, cut at so many of it.

    What swings about 0 stays proportional to itself, as a damping's slope is.
    """
    if values.shape[1] == 0:
        return values
    sd = values.std(axis=0)
    mean = values.mean(axis=0)
    centre = np.where(np.abs(mean) > sd, mean, 0.0)
    return np.clip((values - centre) / sd, -cut, cut)
