"""What a residual of a correct model cannot follow: state, command, their signs and sizes, and
smooth functions of them.
"""

from dataclasses import dataclass

import numpy as np

from dropo.core.contracts.problem import Problem
from dropo.core.numerics.ridge_regression import fourier_features
from dropo.core.records.trajectories import Ints, Segments
from dropo.core.services.validation import Array

FOURIER = 150  # random features
LONG_TAIL = 5.0  # standard deviations at which a feature is cut


@dataclass(frozen=True, eq=False)
class Features:
    """named: (n, F) one column a name, of size about 1, the first a constant; smooth: (n, F')
    random Fourier features of state and command; rows: (n,) the compared rows that have them.
    """

    names: tuple[str, ...]
    named: Array
    smooth: Array
    rows: Ints


def features_of(problem: Problem, predicted: Array, rng: np.random.Generator) -> Features:
    """Features of the compared rows, from the mean predictions (R, p).

    The state is that before the step as the model predicts it from one row earlier, not as it was
    measured there: measured, it would share its noise with the residual. Rows without a row before
    them are left out, unless they are most.
    """
    segments = problem.segments
    state, state_names, rows = _states(problem, predicted)
    action, before = _commands(segments)
    names = (
        [f"action[{i}]" for i in range(action.shape[1])]
        if action.shape[1] > 1
        else ["action"] * action.shape[1]
    )
    base = np.concatenate([state, action, before], axis=1)[rows]
    base_names = [*state_names, *names, *(f"the previous {name}" for name in names)]
    base, base_names = _moving(base, base_names)
    columns = [np.ones((len(rows), 1))]
    labels = ["a constant"]
    for form, function in (("{}", np.positive), ("sign({})", np.sign), ("|{}|", np.abs)):
        values, kept = _moving(function(base), [form.format(name) for name in base_names])
        columns.append(_standard(values))
        labels += kept
    return Features(
        tuple(labels), np.concatenate(columns, axis=1), _fourier(_standard(base), rng), rows
    )


def _states(problem: Problem, predicted: Array) -> tuple[Array, list[str], Ints]:
    """The state before each row (R, S) with its names, and the rows where it is known."""
    segments = problem.segments
    simulator = problem.simulator
    segment, step = segments.rows
    starts = segments.starts[segment]
    time = segments.steps[segment, step]
    order = np.lexsort((time, segments.trajectory[segment]))
    follows = segments.trajectory[segment][order][1:] == segments.trajectory[segment][order][:-1]
    now = order[1:][follows]
    before = order[:-1][follows]
    as_observed = predicted.shape[1] == starts.shape[1]
    names = (
        [signal.name for signal in simulator.signals]
        if as_observed
        else [f"observation[{i}]" for i in range(starts.shape[1])]
    )
    if len(now) < len(order) / 2:
        return starts, names, np.arange(len(order))
    state = np.zeros_like(starts)
    state[now] = predicted[before] if as_observed else starts[before]
    return state, names, np.sort(now)


def _commands(segments: Segments) -> tuple[Array, Array]:
    """(R, q) the mean action from a segment's start to each row, and the action before the segment."""
    segment, step = segments.rows
    total = np.cumsum(segments.actions, axis=1)[segment, step]
    first = segments.steps[:, 0]
    trajectory = segments.trajectories.trajectory
    earlier = np.where((first > 0) & (trajectory[first - 1] == trajectory[first]), first - 1, first)
    return total / (step + 1)[:, None], segments.trajectories.actions[earlier][segment]


def _moving(values: Array, names: list[str]) -> tuple[Array, list[str]]:
    """The columns that change."""
    moves = np.std(values, axis=0) > 1e-9 * np.maximum(np.abs(values).max(axis=0), 1e-300)
    return values[:, moves], [name for name, kept in zip(names, moves, strict=True) if kept]


def _standard(values: Array) -> Array:
    if values.shape[1] == 0:
        return values
    sd = values.std(axis=0)
    mean = values.mean(axis=0)
    centre = np.where(
        np.abs(mean) > sd, mean, 0.0
    )  # what swings about 0 stays proportional to itself, as a damping's slope is
    return np.clip((values - centre) / sd, -LONG_TAIL, LONG_TAIL)


def _fourier(base: Array, rng: np.random.Generator) -> Array:
    """Random features of a Gaussian kernel of width sqrt(number of columns)."""
    n = base.shape[1]
    if n == 0:
        return np.zeros((len(base), 0))
    frequencies = rng.standard_normal((n, FOURIER)) / np.sqrt(n)
    phases = rng.uniform(0, 2 * np.pi, FOURIER)
    return fourier_features(base, frequencies, phases)
