"""States estimated with the model: an extended Kalman filter, and the smoother behind it, for logs
that lack velocities or are noisy.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dropo.core.contracts.problem import Problem
from dropo.core.contracts.simulator import Simulator, describe_failures
from dropo.core.records.trajectories import Signal, Trajectories
from dropo.core.services.errors import Incompatible, SimulationFailed
from dropo.core.services.tables import Report, Table
from dropo.core.services.tables import number as written
from dropo.core.services.validation import Array, float_array, known, require

PASSES = 3  # of linearising at the last pass' states
# of learning: linearised anew in each round, steps of expectation-maximisation within
ROUNDS = 4
TURNS = 5
SHARES = (
    10.0,
    5.6,
    3.0,
    1.8,
    1.0,
    0.3,
    0.1,
    0.03,
)  # of what was learned to be missed, that are tried after each round
# of log-likelihood: the largest share within so much of the best is taken, since too small a one
# makes errors look small
NATS = 2.0
ROWS = 500  # transitions that the noise is learned from
# of a signal's spread: the least and the largest step of the differences
LEAST = 1e-5
LARGEST = 0.02
UNKNOWN = 1e2  # spreads: the standard deviation of a start that was not measured


@dataclass(frozen=True, eq=False, repr=False)
class StateEstimate(Report):
    """The trajectories with estimated states in place of the measured ones, and how well they are
    known.

    covariance: (N, p, p) of the state before each transition; noise: (p,) variance of the
    measurements, inf where a column was not measured; process: (p, p) covariance of what the model
    misses in each control step. causal: whether a state was estimated from measurements up to it
    alone (a filter), or from all (a smoother).
    """

    trajectories: Trajectories
    covariance: Array
    noise: Array
    process: Array
    causal: bool
    signals: tuple[Signal, ...]

    def to_json(self) -> dict[str, Any]:
        """Standard deviations by signal: of the measurement (None where there was none), of the
        state, and of what the model misses.
        """
        measured = np.sqrt(self.noise)
        process = np.sqrt(np.diagonal(self.process))
        rows = zip(
            self.signals,
            measured.tolist(),
            np.sqrt(self.start_variance).tolist(),
            process.tolist(),
            strict=True,
        )
        names = ("measured_sd", "state_sd", "missed_a_step_sd")
        told = {
            s.name: dict(zip(names, (x if np.isfinite(x) else None, *y), strict=True))
            | {"unit": s.unit}
            for s, x, *y in rows
        }
        return {"causal": self.causal, "signals": told}

    def parts(self) -> list[str | Table]:
        """A table of them."""
        table = [
            (
                name,
                told["unit"],
                *(
                    "-" if told[key] is None else written(told[key])
                    for key in ("measured_sd", "state_sd", "missed_a_step_sd")
                ),
            )
            for name, told in self.to_json()["signals"].items()
        ]
        header = ("signal", "unit", "noise sd", "state sd", "missed in a step")
        how = (
            "by the measurements up to each (a filter, causal)"
            if self.causal
            else "by all measurements (a smoother, not causal)"
        )
        return [
            f"{len(self.trajectories)} states estimated with the model, {how}.",
            Table("", header, tuple(table)),
        ]

    @property
    def start_variance(self) -> Array:
        """(p,) the mean variance of the states that a fit starts from, for its epsilon beside the
        sensors' own.
        """
        return np.asarray(np.mean(np.diagonal(self.covariance, axis1=1, axis2=2), axis=0))


def estimate_states(
    simulator: Simulator,
    trajectories: Trajectories,
    values: ArrayLike,
    *,
    measured: ArrayLike | None = None,
    noise: ArrayLike | None = None,
    causal: bool = False,
) -> StateEstimate:
    """States of measured trajectories under the simulator with these parameter values (d,), which
    must observe whole states.

    measured: (p,) bool, which columns were; the others hold a first guess, such as
    `estimate_velocities` gives, which only says where to linearise. noise: (p,) the measurements'
    standard deviations; left out, they are learned. causal: by the measurements up to each state
    alone. What the model misses is learned always, by expectation-maximisation (Shumway and Stoffer
    1982), so that a poor model is trusted little. The smoother is the Rauch-Tung-Striebel recursion
    on central differences at the last pass' states (Bell 1994).
    """
    p = len(simulator.signals)
    if simulator.start_size != p or trajectories.observations.shape[1] != p:
        raise Incompatible(
            "States are estimated for simulators that start from what they compare, "
            f"without rotations: this one has {p} signals,"
            f" {simulator.start_size} start coordinates, and "
            f"{trajectories.observations.shape[1]} columns were given."
        )
    value = float_array("values", values, (len(simulator.space),), "estimate_states")
    seen = np.ones(p, dtype=bool) if measured is None else np.array(measured, dtype=bool)
    require(
        seen.shape == (p,) and bool(seen.any()),
        "measured",
        f"({p},) with at least one True",
        measured,
        "estimate_states",
    )
    given = None if noise is None else float_array("noise", noise, (p,), "estimate_states") ** 2
    problem = _Linear(simulator, value, trajectories.head(min(ROWS, len(trajectories))), seen)
    variance, process = _learned(problem, given)
    whole = replace(problem, trajectories=trajectories)
    states, covariance = whole.estimates(variance, process, causal)
    return StateEstimate(
        _with_states(trajectories, states),
        covariance[_before(trajectories)],
        np.where(seen, variance, np.inf),
        process,
        causal,
        tuple(simulator.signals),
    )


def with_states(
    problem: Problem, unmeasured: Sequence[str] = (), *, causal: bool = False
) -> tuple[Problem, StateEstimate]:
    """The problem with states estimated under its nominal parameters in place of the measured ones,
    and what `estimate_states` says of the data to fit; data held out are estimated by
    themselves. unmeasured: signals whose data are a guess.
    """
    if problem.simulator.nominal is None:
        raise Incompatible(
            "States are estimated under a model's nominal parameters, which "
            f"{type(problem.simulator).__name__} has not."
        )
    names = [signal.name for signal in problem.simulator.signals]
    guessed = {known("signal", name, names) for name in unmeasured}
    seen = np.array([name not in guessed for name in names])
    nominal = np.asarray(problem.simulator.nominal)
    sides = [problem.trajectories, *([] if problem.held_out is None else [problem.held_out])]
    found = [
        estimate_states(problem.simulator, side, nominal, measured=seen, causal=causal)
        for side in sides
    ]
    held_out = found[1].trajectories if len(found) > 1 else None
    return replace(
        problem, trajectories=found[0].trajectories, held_out=held_out, everything=None
    ), found[0]


def _before(trajectories: Trajectories) -> NDArray[np.int64]:
    """(N,) where the state before each transition stands among all states: each trajectory has one
    more than transitions.
    """
    return np.arange(len(trajectories)) + trajectories.trajectory


def _with_states(trajectories: Trajectories, states: Array) -> Trajectories:
    before = _before(trajectories)
    return replace(trajectories, observations=states[before], next_observations=states[before + 1])


def _measurements(trajectories: Trajectories) -> Array:
    """(N + trajectories, p) every state once: those before the transitions, and the one behind each
    trajectory's last.
    """
    out = np.empty(
        (len(trajectories) + len(trajectories.spans), trajectories.observations.shape[1])
    )
    out[_before(trajectories) + 1] = trajectories.next_observations
    out[_before(trajectories)] = trajectories.observations
    return out


@dataclass(frozen=True, eq=False)
class _Linear:
    """The simulator at fixed values as a state-space model along trajectories, `seen` (p,) of whose
    columns were measured.
    """

    simulator: Simulator
    value: Array
    trajectories: Trajectories
    seen: NDArray[np.bool_]

    def linearised(self, states: Array, step: Array) -> tuple[Array, Array]:
        """f (N, p) and its slopes A (N, p, p) at states (N + trajectories, p)."""
        at = _with_states(self.trajectories, states).segments(1)
        p = len(step)
        moves = np.concatenate([np.zeros((1, p)), np.diag(step), -np.diag(step)])
        values = np.repeat(self.value[None], len(moves), axis=0)
        found = self.simulator.predict(
            values, at, offsets=np.repeat(moves[:, None], len(at), axis=1)
        )
        if not np.isfinite(found).all():
            raise SimulationFailed(
                "While states were estimated, "
                f"{describe_failures(found, values, self.simulator.space)}"
            )
        return found[0], np.moveaxis(found[1 : p + 1] - found[p + 1 :], 0, -1) / (2 * step)

    def steps(self, states: Array, noise: Array) -> Array:
        """(p,) half widths of the differences: the noise, within shares of the spread."""
        spread = np.maximum(states.std(axis=0), 1e-9)
        return np.clip(
            np.where(self.seen, np.sqrt(noise), LARGEST * spread), LEAST * spread, LARGEST * spread
        )

    def estimates(self, noise: Array, process: Array, causal: bool) -> tuple[Array, Array]:
        """States (N + trajectories, p) and covariances, after a few passes."""
        states = measured = _measurements(self.trajectories)
        for _ in range(PASSES):
            smooth = _Pass.of(self, measured, states, noise, process)
            states = smooth.states
        return (
            (smooth.filtered, smooth.filtered_covariance)
            if causal
            else (smooth.states, smooth.covariance)
        )


@dataclass(frozen=True, eq=False)
class _Pass:
    """One filter and smoother, with the log-likelihood of the innovations.

    States (M, p) and covariances (M, p, p), filtered and smoothed; `lagged` (N, p, p), the
    covariance of the state behind each transition with the one before it; the linear model f (N,
    p), A (N, p, p) around `at` (M, p).
    """

    filtered: Array
    filtered_covariance: Array
    states: Array
    covariance: Array
    lagged: Array
    follows: Array
    slopes: Array
    at: Array
    log_likelihood: float

    @staticmethod
    def of(
        model: _Linear,
        measured: Array,
        at: Array,
        noise: Array,
        process: Array,
        linear: tuple[Array, Array] | None = None,
    ) -> "_Pass":
        data = model.trajectories
        p = measured.shape[1]
        follows, slopes = model.linearised(at, model.steps(at, noise)) if linear is None else linear
        see = np.eye(p)[model.seen]
        wide = np.where(model.seen, noise, (UNKNOWN * np.maximum(at.std(axis=0), 1e-9)) ** 2)
        states = np.empty_like(measured)
        cover = np.empty((len(measured), p, p))
        smooth = np.empty_like(measured)
        smooth_cover = np.empty_like(cover)
        lagged = np.empty_like(slopes)
        total = 0.0
        for number, (start, stop) in enumerate(data.spans):
            first = start + number
            states[first], cover[first] = (
                np.where(model.seen, measured[first], at[first]),
                np.diag(wide),
            )
            ahead = [
                _step(
                    states,
                    cover,
                    k,
                    k + number,
                    (follows, slopes, at),
                    process,
                    measured,
                    see,
                    noise[model.seen],
                )
                for k in range(start, stop)
            ]
            last = stop + number
            total = total + sum(log for _, _, log in ahead)
            smooth[last], smooth_cover[last] = states[last], cover[last]
            for k in range(stop - 1, start - 1, -1):
                row = k + number
                (predicted, known, _) = ahead[k - start]
                gain = np.linalg.solve(known, slopes[k] @ cover[row]).T
                smooth[row] = states[row] + gain @ (smooth[row + 1] - predicted)
                smooth_cover[row] = cover[row] + gain @ (smooth_cover[row + 1] - known) @ gain.T
                lagged[k] = smooth_cover[row + 1] @ gain.T
        return _Pass(states, cover, smooth, smooth_cover, lagged, follows, slopes, at, total)

    def missed(self, data: Trajectories) -> Array:
        """(p, p) the expected outer product of what the linear model misses in a step."""
        before = _before(data)
        gap = (
            self.states[before + 1]
            - self.follows
            - np.einsum("nij,nj->ni", self.slopes, self.states[before] - self.at[before])
        )
        turned = self.slopes @ self.covariance[before] @ self.slopes.swapaxes(1, 2)
        mixed = self.slopes @ self.lagged.swapaxes(1, 2)
        spread = self.covariance[before + 1] + turned - mixed - mixed.swapaxes(1, 2)
        return np.asarray(gap.T @ gap / len(gap) + spread.mean(axis=0))


def _step(
    states: Array,
    cover: Array,
    k: int,
    row: int,
    linear: tuple[Array, Array, Array],
    process: Array,
    measured: Array,
    see: Array,
    noise: Array,
) -> tuple[Array, Array, float]:
    """Predicts over transition k, and corrects the state at row + 1 by its measurement, in place;
    returns what was predicted, and the log density of the measurement.
    """
    follows, slopes, at = linear
    predicted = follows[k] + slopes[k] @ (states[row] - at[row])
    known = slopes[k] @ cover[row] @ slopes[k].T + process
    total = see @ known @ see.T + np.diag(noise)
    innovation = see @ (measured[row + 1] - predicted)
    gain = np.linalg.solve(total, see @ known).T
    states[row + 1] = predicted + gain @ innovation
    rest = np.eye(len(known)) - gain @ see
    cover[row + 1] = rest @ known @ rest.T + (gain * noise) @ gain.T  # Joseph's form stays positive
    log = -0.5 * (innovation @ np.linalg.solve(total, innovation) + np.linalg.slogdet(total)[1])
    return predicted, known, float(log)


def _learned(model: _Linear, noise: Array | None) -> tuple[Array, Array]:
    """The measurements' variances (p,), where they are not given, and the process' covariance (p,
    p), most likely on the first rows.
    """
    measured = _measurements(model.trajectories)
    spread = np.maximum(measured.var(axis=0), 1e-18)
    pushed = np.array(
        [signal.unit.endswith("/s") for signal in model.simulator.signals]
    )  # forces act on velocities
    pushed |= ~pushed.any()
    floor = np.diag(1e-12 * spread)
    block = np.outer(pushed, pushed)
    variance = 1e-4 * spread if noise is None else noise
    process = np.diag(np.where(pushed, 1e-4, 0) * spread) + floor
    states = measured
    for _ in range(ROUNDS):
        at = states
        linear = model.linearised(at, model.steps(at, variance))
        for _ in range(TURNS):
            found = _Pass.of(model, measured, at, variance, process, linear)
            process = np.where(block, found.missed(model.trajectories), 0.0) + floor
            if noise is None:
                errors = np.mean(
                    (measured - found.states) ** 2
                    + np.diagonal(found.covariance, axis1=1, axis2=2),
                    axis=0,
                )
                variance = np.where(model.seen, np.maximum(errors, 1e-16 * spread), variance)
        tried = [
            _Pass.of(model, measured, at, variance, share * process, linear) for share in SHARES
        ]
        likelihoods = np.array([one.log_likelihood for one in tried])
        states = tried[int(np.argmax(likelihoods))].states
        process = SHARES[int(np.argmax(likelihoods))] * process
    enough = int(np.flatnonzero(likelihoods >= likelihoods.max() - NATS)[0])
    return variance, process * SHARES[enough] / SHARES[int(np.argmax(likelihoods))]
