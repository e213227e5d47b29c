"""The simulator as a linear state-space model along trajectories, and what is learned with it.

In reading order: `StateSpaceModel` linearizes the simulator, `estimate_along` repeats `_smooth`
and, within it, `_filter` over every trajectory, and `learn_noise` finds the noises that are most
likely. There are two: the noise of the measurements, and the process noise, which is what the model
misses in each step.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dropo.core.contracts.simulator import Simulator
from dropo.core.numerics.kalman import Sensors, predict, smooth, update
from dropo.core.records.trajectories import Signal, Trajectories
from dropo.core.services.errors import SimulationFailed
from dropo.core.services.validation import Array


@dataclass(frozen=True)
class SmootherSettings:
    """How states are estimated, and the noise learned.

    Attributes
    ----------
    passes : int
        Number of passes of the smoother; each is linearized at the states of the one before.
    learning_rows : int
        Number of transitions, from the first on, from which the noise is learned.
    learning_rounds : int
        Number of times that the noise is learned; each is linearized anew.
    em_steps : int
        Number of steps of expectation-maximization each time.
    process_factors : tuple of float
        Factors on the learned process noise that are compared after each round, largest first:
        expectation-maximization is slow to take it down.
    likelihood_tolerance : float
        The largest factor whose log-likelihood is within this of the best is taken [nats]: process
        noise that is too small makes the errors of the states look small.
    initial_variance : float
        First guess of both noises, as a fraction of each signal's variance.
    minimum_noise : float
        Lower bound of the measurement noise's variance, as a fraction of each signal's variance.
    minimum_process : float
        Lower bound of the process noise's variance, as a fraction of each signal's variance.
    minimum_step : float
        Smallest half width of differences, as a fraction of each signal's standard deviation.
    maximum_step : float
        Largest half width of differences, as a fraction of each signal's standard deviation.
    unmeasured_start_sd : float
        Standard deviation of a start that was not measured, in the signal's standard deviations.
    """

    passes: int = 3
    learning_rows: int = 500
    learning_rounds: int = 4
    em_steps: int = 5
    process_factors: tuple[float, ...] = (10.0, 5.6, 3.0, 1.8, 1.0, 0.3, 0.1, 0.03)
    likelihood_tolerance: float = 2.0
    initial_variance: float = 1e-4
    minimum_noise: float = 1e-16
    minimum_process: float = 1e-12
    minimum_step: float = 1e-5
    maximum_step: float = 0.02
    unmeasured_start_sd: float = 1e2


DEFAULTS = SmootherSettings()
SMALLEST_SPREAD = 1e-9  # stands for the standard deviation of a signal that does not vary


# Every trajectory has one state more than transitions. Below, M is the number of all states, N the
# number of transitions, and `states` (M, p) holds all states of the first trajectory, then all of
# the second, and so on: of two trajectories of 3 transitions each, transitions 0, 1, 2 begin at
# rows 0, 1, 2 and end at rows 1, 2, 3; transitions 3, 4, 5 begin at rows 4, 5, 6.


def state_row_before(trajectories: Trajectories) -> NDArray[np.int64]:
    """Find the state before each transition among all states.

    Parameters
    ----------
    trajectories : Trajectories
        N transitions.

    Returns
    -------
    (N,) int array
        Rows of `states` (M, p); the state after the transition is in the row behind.
    """
    return np.arange(len(trajectories)) + trajectories.trajectory


def replace_states(trajectories: Trajectories, states: Array) -> Trajectories:
    """Replace the states of trajectories.

    Parameters
    ----------
    trajectories : Trajectories
        N transitions.
    states : (M, p) array
        Every state once.

    Returns
    -------
    Trajectories
    """
    before = state_row_before(trajectories)
    return replace(trajectories, observations=states[before], next_observations=states[before + 1])


def _measured_states(trajectories: Trajectories) -> Array:
    """(M, p) every state as measured: as a start where there is one, else as an end."""
    before = state_row_before(trajectories)
    count = len(trajectories) + len(trajectories.spans)
    states = np.empty((count, trajectories.observations.shape[1]))
    # Ends first: where the next transition starts there, its start replaces them.
    states[before + 1] = trajectories.next_observations
    states[before] = trajectories.observations
    return states


@dataclass(frozen=True, eq=False)
class _LinearizedTransitions:
    """Every transition as x' = predicted + jacobian (x - at).

    Attributes
    ----------
    at : (M, p) array
        The states at which it is linearized.
    predicted : (N, p) array
        The state after each transition, simulated from `at`.
    jacobian : (N, p, p) array
        Its derivatives by the state before.
    """

    at: Array
    predicted: Array
    jacobian: Array


@dataclass(frozen=True, eq=False)
class StateSpaceModel:
    """The simulator at fixed parameters along trajectories, of N transitions and M states.

    Attributes
    ----------
    simulator : Simulator
        Must observe whole states of p numbers, without rotations.
    value : (d,) array
        Its parameters, in their units.
    trajectories : Trajectories
        The measured transitions.
    measured : (p,) bool array
        Which columns were measured.
    settings : SmootherSettings
        How states are estimated.
    """

    simulator: Simulator
    value: Array
    trajectories: Trajectories
    measured: NDArray[np.bool_]
    settings: SmootherSettings

    def linearize(self, states: Array, noise: Array) -> _LinearizedTransitions:
        """Linearize every transition around its first state.

        Parameters
        ----------
        states : (M, p) array
            Every state once.
        noise : (p,) array
            Variances of the measurements, in squared signal units: differences are as wide as
            their standard deviations.

        Returns
        -------
        _LinearizedTransitions

        Raises
        ------
        SimulationFailed
            If a simulation from one of the states diverges.
        """
        step = self._difference_steps(states, noise)
        segments = replace_states(self.trajectories, states).segments(1)
        try:
            predicted, jacobian = self.simulator.linearize_starts(self.value, segments, step=step)
        except SimulationFailed as error:
            raise SimulationFailed(f"While states were estimated, {error}") from None
        return _LinearizedTransitions(states, predicted, jacobian)

    def _difference_steps(self, states: Array, noise: Array) -> Array:
        """(p,) half widths: the noise's standard deviation, within bounds.

        The upper bound is taken where nothing was measured.
        """
        signal_sd = _signal_sd(states)
        minimum = self.settings.minimum_step * signal_sd
        maximum = self.settings.maximum_step * signal_sd
        wanted = np.where(self.measured, np.sqrt(noise), maximum)
        return np.clip(wanted, minimum, maximum)

    def first_state(self, measured: Array, at: Array) -> Array:
        """Give the first state of a trajectory.

        Parameters
        ----------
        measured : (p,) array
            The first measured state.
        at : (p,) array
            Where the model is linearized.

        Returns
        -------
        (p,) array
            As measured, or where a signal is not measured as in `at`.
        """
        return np.where(self.measured, measured, at)

    def first_covariance(self, states: Array, noise: Array) -> Array:
        """Give the covariance of a trajectory's first state.

        Parameters
        ----------
        states : (M, p) array
            States of all trajectories, whose spread stands for what is not measured.
        noise : (p,) array
            Variances of the measured signals' noise.

        Returns
        -------
        (p, p) array
            Diagonal, and wide where a signal is not measured.
        """
        unmeasured_variance = (self.settings.unmeasured_start_sd * _signal_sd(states)) ** 2
        return np.diag(np.where(self.measured, noise, unmeasured_variance))


def _signal_sd(states: Array) -> Array:
    """(p,) standard deviation of each column of states (M, p), above 0."""
    return np.maximum(states.std(axis=0), SMALLEST_SPREAD)


def estimate_along(
    model: StateSpaceModel, noise: Array, process: Array, causal: bool
) -> tuple[Array, Array]:
    """Estimate the states along the trajectories, in passes that begin at the measured states.

    Parameters
    ----------
    model : StateSpaceModel
        The simulator and the measured transitions.
    noise : (p,) array
        Variances of the measurements, in squared signal units.
    process : (p, p) array
        Covariance of the process noise: of what the model misses in a step.
    causal : bool
        Whether each state is estimated from the measurements up to it alone (the filter), or from
        all (the smoother).

    Returns
    -------
    states : (M, p) array
        Every state once, in the signals' units.
    covariance : (M, p, p) array
        Covariance of the error of each state.

    Raises
    ------
    SimulationFailed
        If a simulation from one of the states diverges.
    """
    states = _measured_states(model.trajectories)
    for _ in range(model.settings.passes):
        linear = model.linearize(states, noise)
        smoothed = _smooth(model, linear, noise, process)
        states = smoothed.states
    if causal:
        return smoothed.filtered.states, smoothed.filtered.covariance
    return smoothed.states, smoothed.covariance


@dataclass(frozen=True, eq=False)
class _Filtered:
    """States (M, p) given the measurements up to them, and what was predicted before each.

    Attributes
    ----------
    states, covariance : (M, p) and (M, p, p) array
        Of every state.
    predicted, predicted_covariance : (N, p) and (N, p, p) array
        Of the state after each transition, by the measurements before it.
    log_likelihood : float
        Of the innovations, up to a constant [nats].
    """

    states: Array
    covariance: Array
    predicted: Array
    predicted_covariance: Array
    log_likelihood: float


@dataclass(frozen=True, eq=False)
class _Smoothed:
    """States (M, p) given all measurements.

    Attributes
    ----------
    filtered : _Filtered
        What the filter found before.
    states, covariance : (M, p) and (M, p, p) array
        Of every state.
    lag_one_covariance : (N, p, p) array
        Covariance of the state after each transition with the one before it.
    """

    filtered: _Filtered
    states: Array
    covariance: Array
    lag_one_covariance: Array


def _filter(
    model: StateSpaceModel, linear: _LinearizedTransitions, noise: Array, process: Array
) -> _Filtered:
    """The Kalman filter over every trajectory."""
    data = model.trajectories
    measured = _measured_states(data)
    # An infinite variance says that a column was not measured.
    sensors = Sensors.of(np.where(model.measured, noise, np.inf))
    first_covariance = model.first_covariance(linear.at, noise)
    count, p = measured.shape
    states = np.empty((count, p))
    covariance = np.empty((count, p, p))
    predicted = np.empty((len(data), p))
    predicted_covariance = np.empty((len(data), p, p))
    log_likelihood = 0.0
    for trajectory, (start, stop) in enumerate(data.spans):
        # The first state has no prediction: it is known as well as it was measured.
        first = start + trajectory
        states[first] = model.first_state(measured[first], linear.at[first])
        covariance[first] = first_covariance
        log_likelihoods = []
        for k in range(start, stop):
            before = k + trajectory
            after = before + 1
            # Predict the state after the transition by the linear model, then correct it.
            deviation = states[before] - linear.at[before]
            predicted[k], predicted_covariance[k] = predict(
                deviation, covariance[before], linear.jacobian[k], process, linear.predicted[k]
            )
            observation = measured[after, sensors.columns]
            corrected = update(predicted[k], predicted_covariance[k], observation, sensors)
            states[after] = corrected.state
            covariance[after] = corrected.covariance
            log_likelihoods.append(float(corrected.log_likelihood))
        log_likelihood += sum(log_likelihoods)
    return _Filtered(states, covariance, predicted, predicted_covariance, log_likelihood)


def _smooth(
    model: StateSpaceModel, linear: _LinearizedTransitions, noise: Array, process: Array
) -> _Smoothed:
    """The filter forwards and the smoother backwards over every trajectory."""
    data = model.trajectories
    filtered = _filter(model, linear, noise, process)
    # The last state of a trajectory was estimated from all its measurements already: it stays.
    states = filtered.states.copy()
    covariance = filtered.covariance.copy()
    lag_one_covariance = np.empty_like(linear.jacobian)
    for trajectory, (start, stop) in enumerate(data.spans):
        for k in reversed(range(start, stop)):
            before = k + trajectory
            after = before + 1
            states[before], covariance[before], lag_one_covariance[k] = smooth(
                (filtered.states[before], filtered.covariance[before]),
                linear.jacobian[k],
                (filtered.predicted[k], filtered.predicted_covariance[k]),
                (states[after], covariance[after]),
            )
    return _Smoothed(filtered, states, covariance, lag_one_covariance)


def learn_noise(model: StateSpaceModel, known_noise: Array | None) -> tuple[Array, Array]:
    """Find the noises that the measurements are most likely under.

    Parameters
    ----------
    model : StateSpaceModel
        The simulator and the transitions to learn from.
    known_noise : (p,) array or None
        Variances of the measurements, in squared signal units; None to learn them too.

    Returns
    -------
    noise : (p,) array
        Variances of the measurements. Those of columns that were not measured mean nothing.
    process : (p, p) array
        Covariance of the process noise: of what the model misses in a step.

    Raises
    ------
    SimulationFailed
        If a simulation from one of the states diverges.

    References
    ----------
    Shumway and Stoffer, Journal of Time Series Analysis 3 (1982), 253.
    """
    settings = model.settings
    measured = _measured_states(model.trajectories)
    signal_variance = np.maximum(measured.var(axis=0), SMALLEST_SPREAD**2)
    # The process noise acts on some columns alone; their covariances with the others are 0.
    forced = _forced_columns(model.simulator.signals)
    learning = _NoiseLearning(
        model,
        measured,
        learns_noise=known_noise is None,
        minimum_noise=settings.minimum_noise * signal_variance,
        minimum_process=np.diag(settings.minimum_process * signal_variance),
        both_forced=np.outer(forced, forced),
    )

    # First guesses.
    if known_noise is None:
        noise = settings.initial_variance * signal_variance
    else:
        noise = known_noise
    first_process = np.where(forced, settings.initial_variance, 0) * signal_variance
    process = np.diag(first_process) + learning.minimum_process
    states = measured

    for _ in range(settings.learning_rounds):
        linear = model.linearize(states, noise)
        for _ in range(settings.em_steps):
            noise, process = learning.em_step(linear, noise, process)
        # The next round is linearized where the best factor on the process noise led.
        scan = _scan_factors(model, linear, noise, process)
        states = scan.states
        process = scan.best * process
    return noise, process * scan.largest_likely / scan.best


@dataclass(frozen=True, eq=False)
class _NoiseLearning:
    """What stays as it is while the noises are learned.

    Attributes
    ----------
    model : StateSpaceModel
    measured : (M, p) array
        Every state as measured.
    learns_noise : bool
        Whether the noise of the measurements is learned too.
    minimum_noise : (p,) array
        Lower bound of the measurements' variances.
    minimum_process : (p, p) array
        Added to the process noise that is learned.
    both_forced : (p, p) bool array
        Where the process noise may be other than 0.
    """

    model: StateSpaceModel
    measured: Array
    learns_noise: bool
    minimum_noise: Array
    minimum_process: Array
    both_forced: NDArray[np.bool_]

    def em_step(
        self, linear: _LinearizedTransitions, noise: Array, process: Array
    ) -> tuple[Array, Array]:
        """A step of expectation-maximization: the variances (p,) of measurements and the covariance
        (p, p) of the process noise become the expected squares of what they stand for.
        """
        smoothed = _smooth(self.model, linear, noise, process)
        missed = _expected_process(self.model.trajectories, linear, smoothed)
        process = np.where(self.both_forced, missed, 0.0) + self.minimum_process
        if self.learns_noise:
            squared_errors = _expected_noise(self.measured, smoothed)
            learned = np.maximum(squared_errors, self.minimum_noise)
            noise = np.where(self.model.measured, learned, noise)
        return noise, process


@dataclass(frozen=True, eq=False)
class _FactorScan:
    """The most likely factor on the process noise, the largest that is nearly as likely, and the
    states (M, p) under the best.
    """

    best: float
    largest_likely: float
    states: Array


def _scan_factors(
    model: StateSpaceModel, linear: _LinearizedTransitions, noise: Array, process: Array
) -> _FactorScan:
    """A line search along the process noise, by the factors of the settings."""
    factors = model.settings.process_factors
    by_factor = [_smooth(model, linear, noise, factor * process) for factor in factors]
    log_likelihoods = np.array([smoothed.filtered.log_likelihood for smoothed in by_factor])
    best = int(np.argmax(log_likelihoods))
    largest = _largest_likely(log_likelihoods, model.settings.likelihood_tolerance)
    return _FactorScan(factors[best], factors[largest], by_factor[best].states)


def _largest_likely(log_likelihoods: Array, tolerance: float) -> int:
    """The index of the largest factor that is nearly as likely as the best: as factors are in
    descending order, the first within the tolerance [nats].
    """
    likely = log_likelihoods >= log_likelihoods.max() - tolerance
    return int(np.flatnonzero(likely)[0])


def _forced_columns(signals: Sequence[Signal]) -> NDArray[np.bool_]:
    """(p,) the columns that unmodelled forces act on: velocities, or all where there are none."""
    is_velocity = np.array([signal.unit.endswith("/s") for signal in signals])
    if not is_velocity.any():
        return np.ones(len(signals), dtype=bool)
    return is_velocity


def _expected_noise(measured: Array, smoothed: _Smoothed) -> Array:
    """(p,) expected squares of the measurements' errors, as the states are known with errors."""
    state_variance = np.diagonal(smoothed.covariance, axis1=1, axis2=2)
    expected = (measured - smoothed.states) ** 2 + state_variance
    return np.asarray(np.mean(expected, axis=0))


def _expected_process(
    trajectories: Trajectories, linear: _LinearizedTransitions, smoothed: _Smoothed
) -> Array:
    """(p, p) expected outer product of what the linear model misses in a step."""
    before = state_row_before(trajectories)
    after = before + 1
    a = linear.jacobian
    # What is missed is x' - predicted - A (x - at), where x and x' are known with errors. Its mean:
    deviation = smoothed.states[before] - linear.at[before]
    missed = smoothed.states[after] - linear.predicted - np.einsum("nij,nj->ni", a, deviation)
    # Its covariance: that of x' and that of A x, less the covariance of both with each other.
    of_end = smoothed.covariance[after]
    of_start = a @ smoothed.covariance[before] @ a.swapaxes(1, 2)
    of_both = a @ smoothed.lag_one_covariance.swapaxes(1, 2)
    covariance = of_end + of_start - of_both - of_both.swapaxes(1, 2)
    return np.asarray(missed.T @ missed / len(missed) + covariance.mean(axis=0))
