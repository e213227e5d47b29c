"""Filtered start states: all past measurements say more of a state than the one at its start."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dropo.core.contracts.estimator import Run
from dropo.core.contracts.family import Family
from dropo.core.contracts.likelihood import LocalLogLikelihood
from dropo.core.contracts.noise import Noise
from dropo.core.contracts.problem import Problem
from dropo.core.contracts.simulator import STEP, Simulator, describe_failures
from dropo.core.contracts.support.maximize import SearchResult
from dropo.core.contracts.support.mean_prior import MeanPrior
from dropo.core.numerics.finite_differences import axial_design, difference_quotients
from dropo.core.numerics.kalman import Sensors, predict, update
from dropo.core.numerics.tails import chi2_of_tail
from dropo.core.records.fits.fit import Status
from dropo.core.records.fits.fit_parts import StartFilter
from dropo.core.records.trajectories import Segments
from dropo.core.services.errors import Incompatible, SimulationFailed
from dropo.core.services.validation import Array


@dataclass(frozen=True)
class FilterSettings:
    """How start states are filtered.

    Attributes
    ----------
    passes : int
        Passes of the filter at one estimate; each is linearized at the states of the one before.
    reset_probability : float
        An innovation that would be larger with this probability only, as at a contact, restarts
        the filter from the measurement.
    minimum_step : float
        Smallest half width of differences in the states, as a fraction of each signal's standard
        deviation.
    maximum_step : float
        Largest half width of them, as a fraction of the same.
    iterations : int
        Filter and fit alternate at most so often.
    tolerance : float
        The alternation ends when no mean moves by more than this fraction of its standard error.
    initial_width : float
        Width of a fit that begins at the last one, as a fraction of the parameters' intervals.
    """

    passes: int = 2
    reset_probability: float = 1e-4
    minimum_step: float = 1e-5
    maximum_step: float = 0.02
    iterations: int = 6
    tolerance: float = 0.05
    initial_width: float = 0.01


DEFAULTS = FilterSettings()


@dataclass(frozen=True, eq=False)
class FilteredStates:
    """What the filter says of the state before each transition, from the measurements up to it.

    Attributes
    ----------
    value : (d,) array
        Parameters at which it was filtered.
    offsets : (N, p) array
        Filtered less measured state.
    covariance : (N, p, p) array
        Covariance of the filtered states.
    jacobian : (N, p, d) array
        d state / d parameter.
    resets : int
        How often an innovation was too large.
    """

    value: Array
    offsets: Array
    covariance: Array
    jacobian: Array
    resets: int


@dataclass(frozen=True, eq=False)
class _LinearizedPredictions:
    """Predictions (R, p) with Jacobians in the start (R, p, p) and in the parameters (R, p, d)."""

    predicted: Array
    of_start: Array
    of_value: Array


class FilteredStarts(Simulator):
    """A simulator whose segments start from filtered states, which follow the parameters.

    Parameters
    ----------
    inner : Simulator
        The simulator that replays the segments.
    states : FilteredStates
        The states from which it starts.
    """

    def __init__(self, inner: Simulator, states: FilteredStates):
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
        moved = np.einsum("npd,kd->knp", states.jacobian[first], values - states.value)
        moved = states.offsets[first] + moved
        if offsets is not None:
            moved = moved + offsets
        return self.inner.predict(values, segments, offsets=moved)


def filter_starts(
    problem: Problem,
    run: Run,
    value: Array,
    spread: Array,
    epsilon: Array,
    settings: FilterSettings = DEFAULTS,
) -> tuple[Problem, Array, FilteredStates]:
    """Filter the states that a problem's segments start from, by an extended Kalman filter.

    Innovations are uncorrelated with all before them, so that scores from such starts have mean 0.

    Parameters
    ----------
    problem : Problem
        The problem with measured starts.
    run : Run
        Counts the simulations.
    value : (d,) array
        Parameters.
    spread : (d, d) array
        Their covariance, taken as drawn anew in every transition.
    epsilon : (p,) array
        Variance of every measurement.
    settings : FilterSettings
        How it is done.

    Returns
    -------
    problem : Problem
        The problem from filtered starts.
    added : (R, p, p) array
        Covariance that the errors of the starts add to the rows.
    states : FilteredStates

    Raises
    ------
    Incompatible
        If segments do not start from measured states whose columns are the compared signals.

    References
    ----------
    Jazwinski, Stochastic Processes and Filtering Theory (1970), chapter 8.
    """
    simulator = problem.simulator
    _require_measured_starts(problem)
    each = problem.trajectories.segments(1)
    step = _state_steps(each, epsilon, settings)
    offsets = np.zeros_like(each.starts)
    with run.counting(evaluations=settings.passes + 1):
        for _ in range(settings.passes):
            linear = _linearize(simulator, each, value, offsets, step)
            states = _filter(each, value, offsets, linear, spread, epsilon, settings)
            offsets = states.offsets
        first = problem.segments.steps[:, 0]
        along = _linearize(simulator, problem.segments, value, offsets[first], step).of_start
    segment = problem.segments.rows[0]
    own = states.covariance[first][segment]
    filtered_problem = replace(problem, simulator=FilteredStarts(simulator, states))
    return filtered_problem, along @ own @ along.swapaxes(1, 2), states


def _require_measured_starts(problem: Problem) -> None:
    """Raise Incompatible where a start is no measured row of the compared signals."""
    simulator = problem.simulator
    signals = len(simulator.signals)
    columns = problem.segments.starts.shape[1]
    measured = simulator.start_size == signals and columns == signals
    if not measured or problem.reset != "transition":
        raise Incompatible(
            "Filtered starts need segments that start from a measured state whose columns are the"
            f" compared signals, without rotations: {type(simulator).__name__} has"
            f" {simulator.start_size} start coordinates, {columns} columns and {signals} signals,"
            f" and the reset is {problem.reset!r}. Use starts='measured'."
        )


def _state_steps(segments: Segments, epsilon: Array, settings: FilterSettings) -> Array:
    """(p,) standard deviations of the noise, bounded by the signals' spread."""
    spread = np.std(segments.starts, axis=0)
    step = np.sqrt(epsilon)
    bounded = np.clip(step, settings.minimum_step * spread, settings.maximum_step * spread)
    return np.where(spread > 0, bounded, step)


def _linearize(
    simulator: Simulator, segments: Segments, value: Array, offsets: Array, step: Array
) -> _LinearizedPredictions:
    """Predict from moved starts, with both Jacobians from one batch."""
    d = len(value)
    p = len(step)
    half = STEP * (simulator.space.high - simulator.space.low)
    # The parameters move in the first 1 + 2 d simulations, the starts in the 2 p others.
    by_value = axial_design(half, -half)
    by_start = axial_design(step, -step)[1:]
    design = value + np.concatenate([by_value, np.zeros((2 * p, d))])
    design = simulator.space.feasible(design)
    moves = np.concatenate([np.zeros((1 + 2 * d, p)), by_start])
    predictions = simulator.predict(design, segments, offsets=offsets + moves[:, None])
    if not np.isfinite(predictions).all():
        failures = describe_failures(predictions, design, simulator.space)
        raise SimulationFailed(f"In the filter, {failures} Use starts='measured'.")
    widths = np.diagonal(design[1 : 1 + d] - design[1 + d : 1 + 2 * d])
    return _LinearizedPredictions(
        predictions[0],
        difference_quotients(predictions[2 * d :], 2 * step),
        difference_quotients(predictions[: 1 + 2 * d], widths),
    )


def _filter(
    each: Segments,
    value: Array,
    offsets: Array,
    linear: _LinearizedPredictions,
    spread: Array,
    epsilon: Array,
    settings: FilterSettings,
) -> FilteredStates:
    """The states, with the transitions linearized at the measured states plus offsets."""
    data = each.trajectories
    n, p = linear.predicted.shape
    sensors = Sensors.of(epsilon)
    limit = float(chi2_of_tail(settings.reset_probability, p))
    out = np.zeros((n, p))
    covariances = np.empty((n, p, p))
    jacobians = np.zeros((n, p, len(value)))
    resets = 0
    for start, stop in data.spans:
        covariances[start] = sensors.covariance
        for t in range(start, stop - 1):
            along = linear.of_start[t]
            by_value = linear.of_value[t]
            process = by_value @ spread @ by_value.T
            away = out[t] - offsets[t]
            state, covariance = predict(away, covariances[t], along, process, linear.predicted[t])
            jacobian = along @ jacobians[t] + by_value
            for measured in _measurements(data.next_observations[t], data.observations[t + 1]):
                found = update(state, covariance, measured, sensors)
                if found.squared_distance > limit:
                    resets += 1
                    state = measured
                    covariance = sensors.covariance
                    jacobian = np.zeros_like(jacobian)
                else:
                    state = found.state
                    covariance = found.covariance
                    jacobian = jacobian - found.gain @ jacobian
            out[t + 1] = state - data.observations[t + 1]
            covariances[t + 1] = covariance
            jacobians[t + 1] = jacobian
    return FilteredStates(value, out, covariances, jacobians, resets)


def _measurements(end: Array, start: Array) -> list[Array]:
    """A transition's end and the next one's start: one measurement of a state, or two."""
    return [end] if np.array_equal(end, start) else [end, start]


Refit = Callable[[Problem, Noise, Array, Array], tuple[LocalLogLikelihood, SearchResult]]


def fit_from_filtered_starts(
    refit: Refit,
    problem: Problem,
    run: Run,
    family: Family,
    noise: Noise,
    objective: LocalLogLikelihood,
    found: SearchResult,
    settings: FilterSettings = DEFAULTS,
) -> tuple[Problem, LocalLogLikelihood, SearchResult, StartFilter]:
    """Filter at the estimate and fit from there, in turn, until the means stay where they are.

    Parameters
    ----------
    refit : callable
        Fits a problem under a noise, from a centre (d,) and a width (d,).
    problem : Problem
        The problem with measured starts.
    run : Run
        Counts the simulations.
    family : Family
        Of the distribution that is fitted.
    noise : Noise
        Noise of the rows.
    objective : LocalLogLikelihood
        Of the fit that propagates the noise of the starts.
    found : SearchResult
        That fit.
    settings : FilterSettings
        How it is done.

    Returns
    -------
    tuple
        The last problem, likelihood and maximum; and by how many standard errors the means moved
        at each turn, with how often the filter began anew.
    """
    current = problem
    resets = 0
    moves: list[float] = []
    d = len(problem.space)
    width = problem.space.high - problem.space.low
    prior = MeanPrior(problem.priors, problem.space)
    while len(moves) < settings.iterations and found.status is not Status.INTERRUPTED:
        own = found.point[: len(family.unknowns)]
        mean = family.mean(own)
        sd = family.sd(own)
        spread = family.correlation(own) * np.outer(sd, sd)
        epsilon = objective.epsilon(found.point)
        current, added, states = filter_starts(problem, run, mean, spread, epsilon, settings)
        resets = states.resets
        start = replace(noise, start=False, rows=added)
        objective, found = refit(current, start, mean, settings.initial_width * width)
        # How far the means moved, in their standard errors.
        information = objective.value_score_information(found.point)[2][:d, :d]
        information += np.diag(prior.information(mean))
        errors = np.sqrt(np.diagonal(np.linalg.pinv(information, hermitian=True)))
        moved = np.abs(family.mean(found.point[: len(family.unknowns)]) - mean)
        moves.append(float(np.max(moved / np.maximum(errors, 1e-12 * width))))
        if moves[-1] < settings.tolerance:
            break
    return current, objective, found, StartFilter(tuple(moves), resets)
