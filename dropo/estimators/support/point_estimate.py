"""The parameters of the least weighted squared error, in passes from wide to narrow differences."""

from dataclasses import dataclass, replace

import numpy as np

from dropo.core.contracts.estimator import Run
from dropo.core.contracts.problem import Problem
from dropo.core.contracts.simulator import describe_failures
from dropo.core.contracts.support.mean_prior import MeanPrior
from dropo.core.records.fits.fit import interrupted
from dropo.core.records.parameters import ParameterSpace
from dropo.core.services.errors import SimulationFailed
from dropo.core.services.validation import Array, float_array
from dropo.estimators.support.standard_errors import DIFFERENCES, JacobianStepSettings


@dataclass(frozen=True)
class PriorPassSettings:
    """How passes with a prior that is not normal follow each other.

    Attributes
    ----------
    passes : int
        So many passes are made at most, each with the normal prior of the same slope and curvature.
    settled : float
        Passes end where no centre moves by more of its prior's standard deviations.
    """

    passes: int = 20
    settled: float = 1e-4


PRIOR_PASSES = PriorPassSettings()


@dataclass(frozen=True)
class PointEstimate:
    """An estimate by least squares.

    Attributes
    ----------
    value : (d,) array
        The parameters.
    noise : (p,) array
        Mean squared residual of each signal [signal unit^2].
    weighted_by : (p,) array
        The variances whose inverses were the weights.
    predicted : (R, p) array
        The predictions there.
    jacobian : (R, p, d) array
        Their Jacobian in the parameters.
    evaluations : int
        Of the residuals and the Jacobian.
    converged : bool
        Whether the search came to its own end.
    message : str
        How it ended.
    """

    value: Array
    noise: Array
    weighted_by: Array
    predicted: Array
    jacobian: Array
    evaluations: int
    converged: bool
    message: str


class InterruptedEstimate(KeyboardInterrupt):
    """An estimate was interrupted; `best` has the best point so far."""

    def __init__(self, best: PointEstimate):
        super().__init__()
        self.best = best


def estimate(
    problem: Problem,
    run: Run,
    weights: str | tuple[float, ...] = "noise",
    budget: int = 100,
    step: float | None = None,
    start: Array | None = None,
    settings: JacobianStepSettings = DIFFERENCES,
    prior: MeanPrior | None = None,
) -> PointEstimate:
    """Estimate the parameters by least squares in two passes.

    The second pass begins where the first ended, with the noise and the steps found there, and with
    the prior.

    Parameters
    ----------
    problem : Problem
    run : Run
        Counts the simulations.
    weights, budget, step
        As those of `LeastSquares`.
    start : (d,) array, optional
        Where the first pass begins; the middle of the box if None.
    settings : JacobianStepSettings
        Limits of the steps that are not given.
    prior : MeanPrior, optional
        Of the parameters. One that is not normal takes further passes.

    Returns
    -------
    PointEstimate

    Raises
    ------
    BadArgument
        If weights are not one finite number for each signal.
    SimulationFailed
        If a simulation on the way diverges.
    InterruptedEstimate
        If it is interrupted once a point was evaluated.
    """
    space = problem.space
    targets = problem.simulator.targets(problem.segments)
    width = space.high - space.low
    begin = space.from_unit(np.full(len(space), 0.5)) if start is None else start

    variances = _first_variances(problem, run, weights)
    largest = settings.largest if step is None else step
    first = _solve(problem, run, variances, begin, budget, largest * width)

    if weights == "noise":
        # A perfect model leaves rounding errors.
        lowest = np.maximum(1e-16 * np.var(targets, axis=0), 1e-300)
        variances = np.maximum(first.noise, lowest)
    half = plain_errors(first, width, settings) if step is None else step * width
    left = max(1, budget - first.evaluations)
    try:
        if prior:
            begin = prior.within.clip(first.value)
            last = _with_prior(problem, run, variances, begin, left, half, prior)
        else:
            last = _solve(problem, run, variances, first.value, left, half)
    except InterruptedEstimate:
        raise
    except KeyboardInterrupt:  # before the first point of this pass
        message = interrupted(first.evaluations)
        raise InterruptedEstimate(replace(first, message=message)) from None
    return replace(last, evaluations=first.evaluations + last.evaluations)


def _with_prior(
    problem: Problem,
    run: Run,
    variances: Array,
    start: Array,
    budget: int,
    step: Array,
    prior: MeanPrior,
    settings: PriorPassSettings = PRIOR_PASSES,
) -> PointEstimate:
    """Passes with normal priors of the prior's own slope where the pass before ended."""
    evaluations = 0
    normal = prior.as_normal(start)
    found: PointEstimate | None = None
    for _ in range(settings.passes):
        try:
            found = _solve(problem, run, variances, start, budget, step, prior.within, normal)
        except InterruptedEstimate:
            raise
        except KeyboardInterrupt:  # before the first point of this pass
            if found is None:
                raise
            message = interrupted(evaluations)
            raise InterruptedEstimate(replace(found, message=message)) from None
        evaluations += found.evaluations
        start = found.value
        last, normal = normal, prior.as_normal(start)
        moved = np.abs(normal[0] - last[0]) * np.sqrt(normal[1])
        if np.all((moved < settings.settled) | (normal[1] == 0)):
            break
    assert found is not None
    return replace(found, evaluations=evaluations)


def _first_variances(problem: Problem, run: Run, weights: str | tuple[float, ...]) -> Array:
    """(p,) the variances whose inverses are the weights of the first pass."""
    signals = len(problem.simulator.signals)
    if weights == "noise":
        return misfit(problem, run)
    if weights == "equal":
        return np.ones(signals)
    return 1 / float_array("weights", weights, (signals,), "LeastSquares")


def plain_errors(
    found: PointEstimate, width: Array, settings: JacobianStepSettings = DIFFERENCES
) -> Array:
    """Find the standard errors of a point estimate if the noise is independent.

    Parameters
    ----------
    found : PointEstimate
    width : (d,) array
        Of the parameters' intervals.
    settings : JacobianStepSettings

    Returns
    -------
    (d,) array
        Kept within the least and the largest step of differences.
    """
    whitened = found.jacobian * width / np.sqrt(np.maximum(found.noise, 1e-300))[:, None]
    flat = whitened.reshape(-1, len(width))
    values, vectors = np.linalg.eigh(flat.T @ flat)
    lowest = 1e-14 * max(float(values[-1]), 1.0)
    errors = np.sqrt(np.sum(vectors**2 / np.maximum(values, lowest), axis=1))
    return np.asarray(np.clip(errors, settings.least, settings.largest) * width)


def misfit(problem: Problem, run: Run) -> Array:
    """Find the mean squared error of each signal in the middle of the box.

    Parameters
    ----------
    problem : Problem
    run : Run
        Counts the simulation.

    Returns
    -------
    (p,) array
        At least 1e-16 of the signal's variance.

    Raises
    ------
    SimulationFailed
        If all predictions diverge.
    """
    middle = problem.space.from_unit(np.full(len(problem.space), 0.5))
    targets = problem.simulator.targets(problem.segments)
    with run.counting(evaluations=1):
        predicted = problem.simulator.predict(middle[None], problem.segments)
    if not np.isfinite(predicted).any():
        failures = describe_failures(predicted, middle[None], problem.space)
        raise SimulationFailed(f"In the middle of the box, {failures} Narrow the bounds.")
    errors = predicted[0] - targets
    lowest = np.maximum(1e-16 * np.var(targets, axis=0), 1e-30)
    return np.maximum(np.nanmean(errors**2, axis=0), lowest)


class _WeightedResiduals:
    """Weighted residuals and their Jacobian over the unit box, both from one linearization."""

    def __init__(
        self,
        problem: Problem,
        run: Run,
        variances: Array,
        budget: int,
        step: Array,
        prior: tuple[Array, Array] | None,
    ):
        self.prior = prior
        self.problem = problem
        self.run = run
        self.budget = budget
        self.step = step
        self.variances = variances
        self.weight = 1 / np.sqrt(variances)
        self.width = problem.space.high - problem.space.low
        self.targets = problem.simulator.targets(problem.segments)
        self._point: Array | None = None
        self._linearized = (np.empty(0), np.empty(0))
        self.best: Array | None = None
        self._least = np.inf

    def linearize(self, unit: Array) -> tuple[Array, Array]:
        """Predictions (R, p) and Jacobian (R, p, d); the last point's are kept."""
        if self._point is None or not np.array_equal(self._point, unit):
            value = self.problem.space.low + unit * self.width
            with self.run.counting(evaluations=1):
                self._linearized = self.problem.simulator.linearize(
                    value, self.problem.segments, step=self.step
                )
            self._point = unit.copy()
            done = self.run.evaluations
            self.run.progress(min(0.99, done / self.budget), f"least squares, {done} evaluations")
        return self._linearized

    def residuals(self, unit: Array) -> Array:
        """(R p,) weighted; d more of a normal prior."""
        found = ((self.linearize(unit)[0] - self.targets) * self.weight).ravel()
        if self.prior is not None:
            centre, precision = self.prior
            value = self.problem.space.low + unit * self.width
            found = np.concatenate([found, np.sqrt(precision) * (value - centre)])
        squared = float(found @ found)
        if squared < self._least:
            self._least = squared
            self.best = unit.copy()
        return found

    def jacobian(self, unit: Array) -> Array:
        """Of the residuals in the coordinates of the unit box, d columns."""
        slopes = self.linearize(unit)[1] * self.weight[:, None] * self.width
        of_data = slopes.reshape(-1, len(self.width))
        if self.prior is None:
            return of_data
        return np.concatenate([of_data, np.diag(np.sqrt(self.prior[1]) * self.width)])


def _solve(
    problem: Problem,
    run: Run,
    variances: Array,
    start: Array,
    budget: int,
    step: Array,
    within: ParameterSpace | None = None,
    prior: tuple[Array, Array] | None = None,
) -> PointEstimate:
    """One pass from a start (d,), weighted by the inverse of variances (p,), with steps (d,).

    It stays within the ends of a prior, and has a normal one of centre and precision (d,).
    """
    from scipy.optimize import least_squares  # slow to import

    space = problem.space
    width = space.high - space.low
    before = run.evaluations
    function = _WeightedResiduals(problem, run, variances, budget, step, prior)
    ends = within or space
    low = (ends.low - space.low) / width
    high = (ends.high - space.low) / width
    inside = 1e-9 * (high - low)
    unit = np.clip((start - space.low) / width, low + inside, high - inside)
    try:
        result = least_squares(
            function.residuals,
            unit,
            function.jacobian,
            bounds=(low, high),
            xtol=1e-14,
            ftol=1e-14,
            gtol=1e-14,
            max_nfev=budget,
        )
    except SimulationFailed as error:
        raise SimulationFailed(
            f"Least squares met a simulation that diverged: {error} Narrow the bounds."
        ) from None
    except KeyboardInterrupt:
        if function.best is None:
            raise
        message = interrupted(run.evaluations - before)
        raise InterruptedEstimate(_estimate_at(function.best, function, before, message)) from None
    message = "The estimate stopped moving."
    if result.status <= 0:
        message = f"The budget of {budget} evaluations ran out first."
    found = _estimate_at(result.x, function, before, message)
    return replace(found, converged=result.status > 0)


def _estimate_at(
    unit: Array, function: _WeightedResiduals, before: int, message: str
) -> PointEstimate:
    """The estimate at a point of the unit box, of a search that has not come to its own end."""
    predicted, jacobian = function.linearize(unit)
    return PointEstimate(
        value=function.problem.space.low + unit * function.width,
        noise=np.mean((predicted - function.targets) ** 2, axis=0),
        weighted_by=function.variances,
        predicted=predicted,
        jacobian=jacobian,
        evaluations=function.run.evaluations - before,
        converged=False,
        message=message,
    )
