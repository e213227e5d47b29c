"""States estimated with the model, for logs that lack velocities or are noisy.

The simulator, linearized along the logged motion, is the state-space model of an extended Kalman
filter and of the smoother behind it (`dropo.logs.signals.state_space`). How noisy the measurements
are, and how much the model misses in each control step, is learned on the first rows; then all of
them are filtered or smoothed.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from dropo.core.contracts.problem import Problem
from dropo.core.contracts.simulator import Simulator
from dropo.core.records.trajectories import Signal, Trajectories
from dropo.core.services.errors import Incompatible
from dropo.core.services.tables import Report, Table
from dropo.core.services.tables import number as format_number
from dropo.core.services.validation import Array, float_array, known, require
from dropo.logs.signals.state_space import (
    DEFAULTS,
    SmootherSettings,
    StateSpaceModel,
    estimate_along,
    learn_noise,
    replace_states,
    state_row_before,
)


@dataclass(frozen=True, eq=False, repr=False)
class StateEstimate(Report):
    """Trajectories of estimated states in place of measured ones, and how well they are known.

    Attributes
    ----------
    trajectories : Trajectories
        The N transitions between estimated states.
    covariance : (N, p, p) array
        Covariance of the error of the state before each transition.
    noise : (p,) array
        Variance of the measurements, in squared signal units; infinite where a column was not
        measured.
    process : (p, p) array
        Covariance of the process noise: of what the model misses in each control step.
    causal : bool
        Whether a state was estimated from the measurements up to it alone (a filter), or from all
        (a smoother).
    signals : tuple of Signal
        Names and units of the p columns.
    """

    trajectories: Trajectories
    covariance: Array
    noise: Array
    process: Array
    causal: bool
    signals: tuple[Signal, ...]

    @property
    def start_variance(self) -> Array:
        """(p,) mean variance of the states' errors, for the epsilon of a fit from these states."""
        return np.asarray(np.mean(np.diagonal(self.covariance, axis1=1, axis2=2), axis=0))

    def to_json(self) -> dict[str, Any]:
        """Return the standard deviations of each signal.

        Returns
        -------
        dict
            "causal", and by signal its unit and the standard deviations of its measurement (None
            where there was none), of its state, and of what the model misses of it in a step.
        """
        measured_sd = np.sqrt(self.noise)
        state_sd = np.sqrt(self.start_variance)
        missed_sd = np.sqrt(np.diagonal(self.process))
        signals = {}
        for i, signal in enumerate(self.signals):
            was_measured = bool(np.isfinite(measured_sd[i]))
            signals[signal.name] = {
                "measured_sd": float(measured_sd[i]) if was_measured else None,
                "state_sd": float(state_sd[i]),
                "missed_a_step_sd": float(missed_sd[i]),
                "unit": signal.unit,
            }
        return {"causal": self.causal, "signals": signals}

    def parts(self) -> list[str | Table]:
        """Return a sentence and a table of the standard deviations.

        Returns
        -------
        list
        """
        if self.causal:
            how = "by the measurements up to each (a filter, causal)"
        else:
            how = "by all measurements (a smoother, not causal)"
        sentence = f"{len(self.trajectories)} states estimated with the model, {how}."

        header = ("signal", "unit", "noise sd", "state sd", "missed in a step")
        rows = []
        for name, summary in self.to_json()["signals"].items():
            measured_sd = summary["measured_sd"]
            row = (
                name,
                summary["unit"],
                "-" if measured_sd is None else format_number(measured_sd),
                format_number(summary["state_sd"]),
                format_number(summary["missed_a_step_sd"]),
            )
            rows.append(row)
        return [sentence, Table("", header, tuple(rows))]


def estimate_states(
    simulator: Simulator,
    trajectories: Trajectories,
    values: ArrayLike,
    *,
    measured: ArrayLike | None = None,
    noise: ArrayLike | None = None,
    causal: bool = False,
    settings: SmootherSettings = DEFAULTS,
) -> StateEstimate:
    """Estimate the states of measured trajectories with the simulator.

    Columns that are no state, such as an IMU's, are measurements like the others, and stay as they
    were measured. What the model misses is always learned, by expectation-maximization, so that a
    poor model is trusted little. The smoother is the Rauch-Tung-Striebel recursion; each pass is
    linearized by central differences at the states of the pass before.

    Parameters
    ----------
    simulator : Simulator
        Must observe whole states, without rotations.
    trajectories : Trajectories
        The measured transitions, with p columns.
    values : (d,) array_like
        The simulator's parameters, in their units.
    measured : (p,) array_like of bool, optional
        Which columns were measured; by default all. The others hold a first guess, such as
        `estimate_velocities` gives, which only says where to linearize.
    noise : (p,) array_like, optional
        Standard deviations of the measurements in their units; by default they are learned.
    causal : bool
        Whether to estimate each state by the measurements up to it alone.
    settings : SmootherSettings
        How it is done.

    Returns
    -------
    StateEstimate

    Raises
    ------
    Incompatible
        If the simulator does not start from the columns that it compares.
    BadArgument
        If `values`, `measured` or `noise` has another shape, is not finite, or names no column.
    SimulationFailed
        If a simulation diverges.

    References
    ----------
    Shumway and Stoffer, Journal of Time Series Analysis 3 (1982), 253; Bell, SIAM Journal on
    Optimization 4 (1994), 626.
    """
    # Check what came in.
    caller = "estimate_states"
    p = len(simulator.signals)
    columns = trajectories.observations.shape[1]
    if simulator.start_size != p or columns != p:
        raise Incompatible(
            "States are estimated for simulators that start from what they compare, without"
            f" rotations of joints or sensors: this one has {p} signals, {simulator.start_size}"
            f" start coordinates, and {columns} columns were given."
        )
    value = float_array("values", values, (len(simulator.space),), caller)
    if measured is None:
        is_measured = np.ones(p, dtype=bool)
    else:
        is_measured = np.array(measured, dtype=bool)
    valid = is_measured.shape == (p,) and bool(is_measured.any())
    require(valid, "measured", f"({p},) with at least one True", measured, caller)
    known_variance = None
    if noise is not None:
        known_variance = float_array("noise", noise, (p,), caller) ** 2

    # Learn the noise on the first rows, then estimate the states of all.
    model = StateSpaceModel(simulator, value, trajectories, is_measured, settings)
    first_rows = trajectories.head(min(settings.learning_rows, len(trajectories)))
    model_of_first_rows = replace(model, trajectories=first_rows)
    variance, process = learn_noise(model_of_first_rows, known_variance)
    states, covariance = estimate_along(model, variance, process, causal)
    return StateEstimate(
        trajectories=_with_sensors(replace_states(trajectories, states), trajectories, simulator),
        covariance=covariance[state_row_before(trajectories)],
        noise=np.where(is_measured, variance, np.inf),
        process=process,
        causal=causal,
        signals=tuple(simulator.signals),
    )


def _with_sensors(
    estimated: Trajectories, measured: Trajectories, simulator: Simulator
) -> Trajectories:
    """The estimated states, with what is no state, such as an IMU's numbers, as it was measured."""
    no_state = ~simulator.state_coordinates
    return replace(
        estimated,
        observations=np.where(no_state, measured.observations, estimated.observations),
        next_observations=np.where(
            no_state, measured.next_observations, estimated.next_observations
        ),
    )


def with_states(
    problem: Problem, unmeasured: Sequence[str] = (), *, causal: bool = False
) -> tuple[Problem, StateEstimate]:
    """Replace a problem's measured states by states estimated under its nominal parameters.

    Parameters
    ----------
    problem : Problem
        The problem. Data held out are estimated by themselves, with noise learned on them.
    unmeasured : sequence of str
        Names of the signals whose data are a guess.
    causal : bool
        As of `estimate_states`.

    Returns
    -------
    problem : Problem
        The problem with estimated states.
    estimate : StateEstimate
        Of its data to fit.

    Raises
    ------
    Incompatible
        If the simulator has no nominal parameters.
    """
    simulator = problem.simulator
    if simulator.nominal is None:
        raise Incompatible(
            "States are estimated under a model's nominal parameters, which"
            f" {type(simulator).__name__} has not."
        )
    names = [signal.name for signal in simulator.signals]
    not_measured = {known("signal", name, names) for name in unmeasured}
    measured = np.array([name not in not_measured for name in names])
    nominal = np.asarray(simulator.nominal)

    def estimate(data: Trajectories) -> StateEstimate:
        return estimate_states(simulator, data, nominal, measured=measured, causal=causal)

    estimated = estimate(problem.trajectories)
    held_out = problem.held_out
    if held_out is not None:
        held_out = estimate(held_out).trajectories
    # `everything`, of which the trajectories are the first part, holds measured states: it goes.
    with_estimates = replace(
        problem, trajectories=estimated.trajectories, held_out=held_out, everything=None
    )
    return with_estimates, estimated
