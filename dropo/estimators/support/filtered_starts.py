"""Filtered start states: where every measurement carries noise, past ones say more of a state than
the one at a segment's start.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from dropo.core.contracts.estimator import Run
from dropo.core.contracts.family import Family
from dropo.core.contracts.local_likelihood import LocalLogLikelihood
from dropo.core.contracts.maximize import SearchResult
from dropo.core.contracts.noise import Noise
from dropo.core.contracts.problem import Problem
from dropo.core.contracts.simulator import STEP, Simulator, describe_failures
from dropo.core.records.fit import Status
from dropo.core.records.trajectories import Segments
from dropo.core.services.errors import Incompatible, SimulationFailed
from dropo.core.services.validation import Array

PASSES = 2  # of the filter at one estimate: the second is linearised at the first one's states
# an innovation that would be larger with this probability only starts the filter anew (a contact,
# say)
GATE = 1e-4
# filter and fit in turn, until means move by less than this share of their errors
TURNS = 6
STILL = 0.05
WIDTH = 0.01  # of the box: the first design of a fit that begins at the last one
# of a signal's spread: the least and the largest step of the differences in the states
SMALL = 1e-5
LARGE = 0.02


@dataclass(frozen=True, eq=False)
class States:
    """What the filter says of the state before each of the N transitions, from measurements up to
    it.

    offsets: (N, p) from the measured state; covariance: (N, p, p); slope: (N, p, d) d state / d
    parameter around `value` (d,);
    resets: how often an innovation was too large.
    """

    value: Array
    offsets: Array
    covariance: Array
    slope: Array
    resets: int


class FilteredStarts(Simulator):
    """A simulator whose segments start from filtered states, which follow the parameters, and not
    from the measured ones.
    """

    def __init__(self, inner: Simulator, states: States):
        self.inner = inner
        self.states = states
        self.space = inner.space
        self.signals = inner.signals
        self.nominal = inner.nominal
        self.steps_per_action = inner.steps_per_action
        self.control_step = inner.control_step

    @property
    def start_size(self) -> int:
        return self.inner.start_size

    def targets(self, segments: Segments) -> Array:
        return self.inner.targets(segments)

    def in_contact(self, segments: Segments) -> NDArray[np.bool_]:
        return self.inner.in_contact(segments)

    def _predict(self, values: Array, segments: Segments, offsets: Array | None) -> Array:
        first = segments.steps[:, 0]
        states = self.states
        moved = states.offsets[first] + np.einsum(
            "npd,kd->knp", states.slope[first], values - states.value
        )
        return self.inner.predict(
            values, segments, offsets=moved if offsets is None else moved + offsets
        )


def filtered(
    problem: Problem, run: Run, value: Array, spread: Array, epsilon: Array
) -> tuple[Problem, Array, States]:
    """The problem from filtered starts, the covariance (R, p, p) that their own errors add to its
    rows, and the states.

    value: (d,) the parameters, spread: (d, d) their covariance, taken as new in every transition;
    epsilon: (p,) of every measurement. An extended Kalman filter: x' = f(x) + A (x - x_hat), A by
    central differences (Jazwinski 1970, chapter 8). An innovation is uncorrelated with all before
    it, so that scores from such starts have mean zero.
    """
    simulator = problem.simulator
    p = len(simulator.signals)
    if (
        simulator.start_size != p
        or problem.segments.starts.shape[1] != p
        or problem.reset != "transition"
    ):
        raise Incompatible(
            "Filtered starts need segments that start from a measured state whose columns "
            "are the compared signals, without"
            f" rotations: {type(simulator).__name__} has {simulator.start_size} start "
            f"coordinates, {problem.segments.starts.shape[1]}"
            f" columns and {p} signals, and the reset is {problem.reset!r}. Use starts='measured'."
        )
    each = problem.trajectories.segments(1)
    step = _state_steps(each, epsilon)
    offsets = np.zeros_like(each.starts)
    with run.counting(evaluations=PASSES + 1):
        for _ in range(PASSES):
            states = _filter(
                each,
                value,
                offsets,
                _linearised(simulator, each, value, offsets, step),
                spread,
                np.diag(epsilon),
            )
            offsets = states.offsets
        first = problem.segments.steps[:, 0]
        _, slope, _ = _linearised(simulator, problem.segments, value, offsets[first], step)
    segment = problem.segments.rows[0]
    own = states.covariance[first][segment]
    return (
        replace(problem, simulator=FilteredStarts(simulator, states)),
        slope @ own @ slope.swapaxes(1, 2),
        states,
    )


def _state_steps(segments: Segments, epsilon: Array) -> Array:
    """(p,) a standard deviation of the noise, within shares of the signal's spread."""
    spread = np.std(segments.starts, axis=0)
    step = np.sqrt(epsilon)
    return np.where(spread > 0, np.clip(step, SMALL * spread, LARGE * spread), step)


def _linearised(
    simulator: Simulator, segments: Segments, value: Array, offsets: Array, step: Array
) -> tuple[Array, Array, Array]:
    """Predictions (R, p) from moved starts, their slopes in the start (R, p, p) and in the
    parameters (R, p, d): one batch.
    """
    p = len(step)
    d = len(value)
    half = STEP * (simulator.space.high - simulator.space.low)
    moves = np.concatenate([np.zeros((1 + 2 * d, p)), np.diag(step), -np.diag(step)])
    design = np.repeat(value[None], 1 + 2 * d + 2 * p, axis=0)
    design[1 : 1 + 2 * d] += np.concatenate([np.diag(half), -np.diag(half)])
    design = simulator.space.feasible(design)
    predictions = simulator.predict(design, segments, offsets=offsets + moves[:, None])
    if not np.isfinite(predictions).all():
        raise SimulationFailed(
            f"In the filter, {describe_failures(predictions, design, simulator.space)} Use "
            "starts='measured'."
        )
    of_value = predictions[1 : 1 + 2 * d]
    of_start = predictions[1 + 2 * d :]
    reach = np.diagonal(design[1 : 1 + d] - design[1 + d : 1 + 2 * d])
    slope = np.moveaxis((of_value[:d] - of_value[d:]) / reach[:, None, None], 0, -1)
    return predictions[0], np.moveaxis(of_start[:p] - of_start[p:], 0, -1) / (2 * step), slope


def _filter(
    each: Segments,
    value: Array,
    offsets: Array,
    model: tuple[Array, Array, Array],
    spread: Array,
    noise: Array,
) -> States:
    """The states from measurements up to them, with the transitions linearised at the measured
    states plus offsets.
    """
    data = each.trajectories
    (predicted, along, by_value) = model
    n, p = predicted.shape
    out = np.zeros((n, p))
    covariance = np.empty((n, p, p))
    slope = np.zeros((n, p, len(value)))
    limit = float(chi2.isf(GATE, p))
    resets = 0
    for start, stop in data.spans:
        covariance[start] = noise
        for t in range(start, stop - 1):
            state = predicted[t] + along[t] @ (out[t] - offsets[t])
            known = along[t] @ covariance[t] @ along[t].T + by_value[t] @ spread @ by_value[t].T
            follows = along[t] @ slope[t] + by_value[t]
            measured = [data.next_observations[t], data.observations[t + 1]]
            for y in measured[
                : 1 if np.array_equal(*measured) else 2
            ]:  # one measurement, or two of the same state
                innovation = y - state
                total = known + noise
                gain = np.linalg.solve(total, known).T
                if innovation @ np.linalg.solve(total, innovation) > limit:
                    state = y
                    known = noise
                    follows = np.zeros_like(follows)
                    resets = resets + 1
                    continue
                state = state + gain @ innovation
                follows = follows - gain @ follows
                known = known - gain @ known
                known = 0.5 * (known + known.T)
            out[t + 1], covariance[t + 1], slope[t + 1] = (
                state - data.observations[t + 1],
                known,
                follows,
            )
    return States(value, out, covariance, slope, resets)


Refit = Callable[[Problem, Noise, Array, Array], tuple[LocalLogLikelihood, SearchResult]]


def from_filtered_starts(
    refit: Refit,
    problem: Problem,
    run: Run,
    family: Family,
    noise: Noise,
    objective: LocalLogLikelihood,
    found: SearchResult,
) -> tuple[Problem, LocalLogLikelihood, SearchResult, dict[str, Any]]:
    """Filters at the estimate and fits from there, in turn, until the means move by less than a
    twentieth of their errors.

    The start is the fit that propagates the noise of the starts. Returns the last problem,
    likelihood and maximum, and for fit.json how far the means moved at each turn, in standard
    errors, and how often the filter began anew.
    """
    seen = problem
    resets = 0
    moves: list[float] = []
    d = len(problem.space)
    while len(moves) < TURNS and found.status is not Status.INTERRUPTED:
        own = found.point[: len(family.unknowns)]
        mean = family.mean(own)
        sd = family.sd(own)
        spread = family.correlation(own) * np.outer(sd, sd)
        seen, added, states = filtered(problem, run, mean, spread, objective.epsilon(found.point))
        start = replace(noise, start=False, rows=added)
        objective, found = refit(
            seen, start, mean, WIDTH * (problem.space.high - problem.space.low)
        )
        errors = np.sqrt(
            np.diagonal(
                np.linalg.pinv(
                    objective.value_score_information(found.point)[2][:d, :d], hermitian=True
                )
            )
        )
        moved = np.abs(family.mean(found.point[: len(family.unknowns)]) - mean)
        moves.append(
            float(
                np.max(moved / np.maximum(errors, 1e-12 * (problem.space.high - problem.space.low)))
            )
        )
        resets = states.resets
        if moves[-1] < STILL:
            break
    return seen, objective, found, {"filter": {"moves": moves, "resets": resets}}
