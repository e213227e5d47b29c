"""Least squares, the classical system identification."""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import scipy.optimize

from dropo.core.contracts.estimator import Estimator, Run
from dropo.core.contracts.problem import Problem
from dropo.core.contracts.simulator import describe_failures
from dropo.core.records.fit import Fit, Status
from dropo.core.services.errors import SimulationFailed
from dropo.core.services.registry import find
from dropo.core.services.validation import Array, float_array, known, require
from dropo.estimators.support.standard_errors import DIFFERENCES, rounding
from dropo.estimators.support.summary import summarize


@dataclass(frozen=True)
class PointEstimate:
    """value: (d,); noise: (p,) the residuals' variance; weighted_by: (p,) the variances behind the
    weights; predicted: (R, p); jacobian: (R, p, d) where the search ended; evaluations: of the
    residuals and Jacobian.
    """

    value: Array
    noise: Array
    weighted_by: Array
    predicted: Array
    jacobian: Array
    evaluations: int
    converged: bool
    message: str


@dataclass(frozen=True, kw_only=True)
class LeastSquares(Estimator):
    """The parameters with the least weighted squared error, xi* = argmin sum_t |s_{t+1} -
    s_{t+1}^xi|_W^2 (thesis, eq. 3.1).

    weights: "noise", the inverse variance of each signal's residuals, found in a second pass;
    "equal", as in eq. 3.1; or one number for each signal. By Gauss-Newton in a trust region
    (scipy's "trf"), Jacobians by central differences.
    budget: evaluations of the residuals in each pass at most. step: half the width of the
    differences, as a share of each parameter's interval; None: a hundredth in a first pass, one
    standard error in a second, but no less than a thousandth: contacts that switch give slopes
    without bound as differences shrink.
    """

    weights: Literal["noise", "equal"] | tuple[float, ...] = "noise"
    budget: int = 100
    step: float | None = None
    name = "least-squares"

    def __post_init__(self) -> None:
        require(self.budget >= 1, "budget", "at least 1", self.budget, "LeastSquares")
        require(
            self.step is None or 0 < self.step <= 0.5,
            "step",
            "a share of the interval in (0, 0.5]",
            self.step,
            "LeastSquares",
        )
        if isinstance(self.weights, str):
            known("weights", self.weights, ("noise", "equal"))

    def _fit(self, problem: Problem, run: Run) -> Fit:
        found = estimate(problem, run, self.weights, self.budget, self.step)
        family = find("families", "point")(problem.space)
        rows = len(problem.segments.rows[0])
        noise = np.maximum(found.noise, rounding(problem))  # a perfect fit would have no density
        log_likelihood = (
            -0.5 * rows * float(np.sum(np.log(2 * np.pi * noise) + found.noise / noise))
        )
        return summarize(
            problem,
            run,
            method=self.name,
            family=family,
            family_name="point",
            phi=family.phi(found.value, np.zeros(len(problem.space))),
            epsilon=noise,
            weighted_by=found.weighted_by,
            log_likelihood=log_likelihood,
            mean_prediction=found.predicted,
            status=Status.CONVERGED if found.converged else Status.OUT_OF_BUDGET,
            message=found.message,
        )


def estimate(
    problem: Problem,
    run: Run,
    weights: str | tuple[float, ...] = "noise",
    budget: int = 100,
    step: float | None = None,
) -> PointEstimate:
    """The point estimate from the middle of the box, in two passes: the second from the first one's
    end, with its noise and steps.
    """
    space = problem.space
    targets = problem.simulator.targets(problem.segments)
    p = targets.shape[1]
    middle = space.from_unit(np.full(len(space), 0.5))
    width = space.high - space.low
    if weights == "noise":
        given = misfit(problem, run)
    else:
        given = 1 / (
            np.ones(p)
            if weights == "equal"
            else float_array("weights", weights, (p,), "LeastSquares")
        )
    first = _solve(
        problem, run, given, middle, budget, (DIFFERENCES.largest if step is None else step) * width
    )
    if weights == "noise":
        given = np.maximum(
            first.noise, np.maximum(1e-16 * np.var(targets, axis=0), 1e-300)
        )  # rounding, where the model is perfect
    second = _solve(
        problem,
        run,
        given,
        first.value,
        budget,
        plain_errors(first, width) if step is None else step * width,
    )
    return replace(second, evaluations=first.evaluations + second.evaluations)


def plain_errors(found: PointEstimate, width: Array) -> Array:
    """(d,) standard errors of a point estimate with independent noise, kept between `DIFFERENCES`
    of the intervals (d,).
    """
    white = (found.jacobian * width / np.sqrt(np.maximum(found.noise, 1e-300))[:, None]).reshape(
        -1, len(width)
    )
    values, vectors = np.linalg.eigh(white.T @ white)
    errors = np.sqrt(
        np.sum(vectors**2 / np.maximum(values, 1e-14 * max(float(values[-1]), 1.0)), axis=1)
    )
    return np.asarray(np.clip(errors, DIFFERENCES.least, DIFFERENCES.largest) * width)


def misfit(problem: Problem, run: Run) -> Array:
    """(p,) the mean squared error of each signal at the middle of the box: the scale of what is to
    be explained.
    """
    middle = problem.space.from_unit(np.full(len(problem.space), 0.5))
    targets = problem.simulator.targets(problem.segments)
    with run.counting(evaluations=1):
        predicted = problem.simulator.predict(middle[None], problem.segments)
    if not np.isfinite(predicted).any():
        raise SimulationFailed(
            "In the middle of the box, "
            f"{describe_failures(predicted, middle[None], problem.space)} Narrow the "
            "bounds."
        )
    errors = predicted[0] - targets
    floor = np.maximum(1e-16 * np.var(targets, axis=0), 1e-30)
    return np.maximum(np.nanmean(errors**2, axis=0), floor)


def _solve(
    problem: Problem, run: Run, variances: Array, start: Array, budget: int, step: Array
) -> PointEstimate:
    simulator = problem.simulator
    segments = problem.segments
    space = problem.space
    targets = simulator.targets(segments)
    root = 1 / np.sqrt(variances)
    width = space.high - space.low
    kept: dict[bytes, tuple[Array, Array]] = {}

    def linearized(unit: Array) -> tuple[Array, Array]:
        if unit.tobytes() not in kept:
            with run.counting(evaluations=1):
                kept.clear()
                kept[unit.tobytes()] = simulator.linearize(
                    space.low + unit * width, segments, step=step
                )
            run.progress(
                min(0.99, run.evaluations / budget), f"least squares, {run.evaluations} evaluations"
            )
        return kept[unit.tobytes()]

    def residuals(unit: Array) -> Array:
        return ((linearized(unit)[0] - targets) * root).ravel()

    def jacobian(unit: Array) -> Array:
        return (linearized(unit)[1] * root[:, None] * width).reshape(-1, len(space))

    before = run.evaluations
    unit = np.clip((start - space.low) / width, 1e-9, 1 - 1e-9)
    try:
        result = scipy.optimize.least_squares(
            residuals,
            unit,
            jacobian,
            bounds=(0.0, 1.0),
            xtol=1e-14,
            ftol=1e-14,
            gtol=1e-14,
            max_nfev=budget,
        )
    except SimulationFailed as error:
        raise SimulationFailed(
            f"Least squares met a simulation that diverged: {error} Narrow the bounds."
        ) from None
    value = space.low + result.x * width
    predicted, slopes = linearized(result.x)
    noise = np.mean((predicted - targets) ** 2, axis=0)
    message = (
        "The estimate stopped moving."
        if result.status > 0
        else f"The budget of {budget} evaluations ran out first."
    )
    return PointEstimate(
        value,
        noise,
        variances,
        predicted,
        slopes,
        run.evaluations - before,
        result.status > 0,
        message,
    )
