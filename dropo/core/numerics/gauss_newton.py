"""Gauss-Newton within a box, whose steps an objective is checked against.

`maximize` keeps a step only where the objective grows, tries shorter ones, and keeps a Jacobian as
long as it predicts well. `fit_reweighted` climbs the likelihood of a Student t by it, in which
rows weigh as well as they fit.
"""

from dataclasses import dataclass, field
from typing import Protocol, TypeVar

import numpy as np

from dropo.core.numerics.robust_statistics import deviation, student_t_weights
from dropo.core.services.validation import Array

S = TypeVar("S")


@dataclass(frozen=True)
class GaussNewtonSettings:
    """How `maximize` steps.

    Attributes
    ----------
    iterations : int
        Steps at most.
    tolerance : float
        A step that gains less than this is the last one, in the objective's unit.
    sufficient_gain : float
        Fraction of the promised gain that a whole step must bring.
    slow_gain : float
        A step that promises more than this fraction of what the one before promised is slow: the
        Jacobian does not describe the objective near by.
    fractions : tuple of float
        Fractions of a step that are tried where the whole of it brings too little.
    multiples : tuple of float
        Multiples of a slow step that are tried beyond it where it brings what it promises.
    prior_width : float
        Standard deviation of the prior that holds each step back, as a fraction of the box.
    """

    iterations: int = 5
    tolerance: float = 0.1
    sufficient_gain: float = 0.2
    slow_gain: float = 0.5
    fractions: tuple[float, ...] = (0.5, 0.25, 0.1, 0.02)
    multiples: tuple[float, ...] = (1.0, 3.0, 7.0, 15.0)
    prior_width: float = 0.1


class SteppedObjective(Protocol[S]):
    """What `maximize` asks of a problem whose states are of any type."""

    def differentiate(self, state: S, close: bool) -> Array:
        """Differentiate the predictions at a state.

        Parameters
        ----------
        state : S
            Where to differentiate.
        close : bool
            Whether by narrow differences, for predictions that bend within the usual width.

        Returns
        -------
        array
            The Jacobian, of whatever shape `step` takes.
        """

    def step(self, state: S, jacobian: Array) -> tuple[Array, float]:
        """Find the step by a Jacobian; see `damped_step`.

        Parameters
        ----------
        state : S
            Where the step begins.
        jacobian : array
            As `differentiate` gave it, there or at an earlier state.

        Returns
        -------
        step : (f,) array
            In the free numbers of the state.
        gain : float
            What the linear model promises of it, in nats.
        """

    def try_steps(self, state: S, steps: Array) -> tuple[S, float]:
        """Take the best of several steps.

        Parameters
        ----------
        state : S
            Where the steps begin.
        steps : (K, f) array
            In the free numbers of the state.

        Returns
        -------
        state : S
            The best state; the same one if no step gains.
        gain : float
            Its gain in nats; 0 if no step gains.
        """


def maximize(
    problem: SteppedObjective[S],
    state: S,
    settings: GaussNewtonSettings,
    *,
    jacobian: Array | None = None,
    close: bool = False,
) -> tuple[S, Array | None]:
    """Climb by Gauss-Newton steps, whole ones where they gain what they promise, else shorter ones.

    The Jacobian is found anew where a step gains too little, or where there is none yet; and by
    narrow differences where that does not help, or where step after step promises the same:
    predictions then bend within the usual width of differences. Where step after step gains what it
    promises, they are too short, and longer ones are tried first.

    Parameters
    ----------
    problem : SteppedObjective
        Differentiates and steps.
    state : S
        Where to begin.
    settings : GaussNewtonSettings
        How it steps.
    jacobian : array, optional
        A Jacobian from near by that may be used at first.
    close : bool
        Whether to differentiate by narrow differences from the first step on.

    Returns
    -------
    state : S
        Where it ended.
    jacobian : array or None
        The last Jacobian, where it still describes the objective.
    """
    fresh = jacobian is None
    promised_before = np.inf
    for _ in range(settings.iterations):
        if jacobian is None:
            jacobian = problem.differentiate(state, close)
            fresh = True
        step, promised = problem.step(state, jacobian)
        state, gain = problem.try_steps(state, step[None])
        sufficient = gain > settings.sufficient_gain * promised
        slow = promised > settings.slow_gain * promised_before
        promised_before = promised
        if fresh and not sufficient:
            fractions = np.array(settings.fractions)
            state, more = problem.try_steps(state, fractions[:, None] * step)
            gain += more
        if slow and sufficient:
            multiples = np.array(settings.multiples)
            state, more = problem.try_steps(state, multiples[:, None] * step)
            slow = more < gain
            gain += more
        small = gain < settings.tolerance
        if small and (sufficient or close or promised < settings.tolerance):
            break
        close = close or (fresh and (slow or small))
        if slow or not sufficient:
            jacobian = None
        fresh = False
    return state, jacobian


def damped_step(
    jacobian: Array, residuals: Array, room: tuple[Array, Array], prior_sd: Array
) -> tuple[Array, float]:
    """Solve the linear least-squares problem of a step within a box, held back by a prior.

    The prior keeps a step from running along directions that the data do not determine.

    Parameters
    ----------
    jacobian : (f, N) array
        Weighted derivatives of N predictions by f numbers.
    residuals : (N,) array
        Weighted residuals, measured less predicted.
    room : tuple of (f,) arrays
        How far each number may go down (not above 0) and up (not below 0).
    prior_sd : (f,) array
        Standard deviation of a normal prior around no step.

    Returns
    -------
    step : (f,) array
    promised : float
        Gain of the log-likelihood without the prior, were predictions linear [nats].

    References
    ----------
    Levenberg, Quarterly of Applied Mathematics 2 (1944), 164.
    """
    from scipy.optimize import lsq_linear  # slow to import

    # Columns of like length, and at least as long as the prior's.
    scale = np.maximum(np.linalg.norm(jacobian, axis=1), 1 / prior_sd)
    q, r = np.linalg.qr((jacobian / scale[:, None]).T)
    rows = np.concatenate([r, np.diag(1 / (prior_sd * scale))])
    target = np.concatenate([q.T @ residuals, np.zeros(len(jacobian))])
    # A number at its bound still needs an interval that is not empty.
    low = np.minimum(room[0], -1e-12 / scale) * scale
    high = np.maximum(room[1], 1e-12 / scale) * scale
    step = lsq_linear(rows, target, bounds=(low, high)).x / scale
    change = step @ jacobian
    return step, float(change @ residuals) - 0.5 * float(change @ change)


@dataclass(frozen=True)
class ReweightingSettings:
    """How `fit_reweighted` steps.

    Attributes
    ----------
    steps : GaussNewtonSettings
        Steps, with gains in nats; their prior is in units of the widths.
    degrees : float
        Degrees of freedom of the Student t whose weights the rows have.
    maximum_step : float
        Longest step, as a fraction of the widths.
    rounds : int
        How often at most the scale of the errors is found anew.
    same_scale : float
        A smaller relative change of it needs no further round.
    """

    steps: GaussNewtonSettings = field(
        default_factory=lambda: GaussNewtonSettings(iterations=20, tolerance=0.01, prior_width=1e3)
    )
    degrees: float = 3.0
    maximum_step: float = 0.25
    rounds: int = 8
    same_scale: float = 0.02


@dataclass(frozen=True, eq=False)
class ReweightedFit:
    """Where a reweighted fit ended, and its rows there in units of the widths.

    Attributes
    ----------
    value : (d,) array
        The parameters.
    information : (d, d) array
        J' W J of the scaled rows.
    inverse : (d, d) array
        Its inverse under the prior.
    scores : (R, d) array
        Weighted score of each row.
    """

    value: Array
    information: Array
    inverse: Array
    scores: Array


class FittedRows(Protocol):
    """What `fit_reweighted` asks of a problem of R rows of p numbers and d parameters."""

    def errors(self, values: Array) -> Array:
        """Compare rows with their predictions.

        Parameters
        ----------
        values : (K, d) array
            Parameters.

        Returns
        -------
        (K, R, p) array
            Measured less predicted; NaN where nothing is predicted.
        """

    def jacobian(self, value: Array, close: bool) -> Array:
        """Differentiate the predictions.

        Parameters
        ----------
        value : (d,) array
            Where.
        close : bool
            Whether by narrow differences.

        Returns
        -------
        (R, p, d) array
        """


def fit_reweighted(
    rows: FittedRows,
    start: Array,
    bounds: tuple[Array, Array],
    width: Array,
    settings: ReweightingSettings,
) -> ReweightedFit:
    """Fit most rows, however large the errors of the others are.

    What grows is the log-likelihood of a Student t of each row's mean square in units of the usual
    errors; these are found by medians, and anew where a fit has ended.

    Parameters
    ----------
    rows : FittedRows
        The rows, their predictions and the derivatives of these.
    start : (d,) array
        Where to begin, within the bounds.
    bounds : tuple of (d,) arrays
        Lower and upper bounds.
    width : (d,) array
        Unit of each parameter.
    settings : ReweightingSettings
        How it steps.

    Returns
    -------
    ReweightedFit

    References
    ----------
    Lange, Little, Taylor, Journal of the American Statistical Association 84 (1989), 881.
    """
    value = start
    errors = rows.errors(start[None])[0]
    jacobian = None
    last_scale = np.full(1, np.inf)
    for _ in range(settings.rounds):
        scale = _usual(errors)
        if np.all(np.abs(scale / last_scale - 1) < settings.same_scale):
            break
        last_scale = scale
        problem = _ReweightedRows(rows, bounds, width, scale, settings)
        begun = problem.at(value, errors)
        state, jacobian = maximize(problem, begun, settings.steps, jacobian=jacobian)
        value = state.value
        errors = state.errors
    if jacobian is None:
        jacobian = problem.differentiate(state, False)
    scaled_jacobian, scaled, weights = problem.scaled(state, jacobian)
    information = np.einsum("w,wpd,wpe->de", weights, scaled_jacobian, scaled_jacobian)
    prior = np.eye(len(start)) / settings.steps.prior_width**2
    return ReweightedFit(
        value=value,
        information=information,
        inverse=np.linalg.inv(information + prior),
        scores=weights[:, None] * np.einsum("wpd,wp->wd", scaled_jacobian, scaled),
    )


def _usual(errors: Array) -> Array:
    """(p,) usual sizes of errors (R, p), a millionth of their root mean square at least."""
    size = np.sqrt(np.mean(errors**2, axis=0))
    return np.where(size > 0, np.maximum(deviation(errors), 1e-6 * size), 1.0)


@dataclass(frozen=True, eq=False)
class _RowsAt:
    """Parameters (d,), the errors (R, p) under them, and their log-likelihood [nats]."""

    value: Array
    errors: Array
    log_likelihood: float


@dataclass(frozen=True, eq=False)
class _ReweightedRows:
    """The objective of `fit_reweighted` under one scale (p,), as `maximize` asks for it."""

    rows: FittedRows
    bounds: tuple[Array, Array]
    width: Array
    scale: Array
    settings: ReweightingSettings

    def at(self, value: Array, errors: Array) -> _RowsAt:
        """Parameters (d,) with the errors (R, p) under them."""
        degrees = self.settings.degrees
        surprise = np.log1p(np.mean((errors / self.scale) ** 2, axis=1) / degrees).sum()
        return _RowsAt(value, errors, -0.5 * (degrees + 1) * float(surprise))

    def scaled(self, state: _RowsAt, jacobian: Array) -> tuple[Array, Array, Array]:
        """Jacobian (R, p, d) and errors (R, p) in units of widths and scale, and weights (R,)."""
        scaled = state.errors / self.scale
        weights = student_t_weights(np.mean(scaled**2, axis=1), 1, self.settings.degrees)
        return jacobian * self.width / self.scale[:, None], scaled, weights

    def differentiate(self, state: _RowsAt, close: bool) -> Array:
        """See `SteppedObjective`."""
        return self.rows.jacobian(state.value, close)

    def step(self, state: _RowsAt, jacobian: Array) -> tuple[Array, float]:
        """See `SteppedObjective`."""
        scaled_jacobian, scaled, weights = self.scaled(state, jacobian)
        root = np.sqrt(weights / len(self.scale))[:, None]
        low, high = ((bound - state.value) / self.width for bound in self.bounds)
        longest = self.settings.maximum_step
        d = len(self.width)
        return damped_step(
            (root[..., None] * scaled_jacobian).reshape(-1, d).T,
            (root * scaled).ravel(),
            (np.maximum(low, -longest), np.minimum(high, longest)),
            np.full(d, self.settings.steps.prior_width),
        )

    def try_steps(self, state: _RowsAt, steps: Array) -> tuple[_RowsAt, float]:
        """See `SteppedObjective`."""
        values = np.clip(state.value + steps * self.width, *self.bounds)
        tried = list(map(self.at, values, self.rows.errors(values)))
        likelihoods = np.nan_to_num([one.log_likelihood for one in tried], nan=-np.inf)
        best = int(np.argmax(likelihoods))
        gain = float(likelihoods[best]) - state.log_likelihood
        return (tried[best], gain) if gain > 0 else (state, 0.0)
