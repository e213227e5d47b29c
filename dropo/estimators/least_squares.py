"""Least squares, the classical system identification."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from dropo.core.contracts.estimator import Estimator, Run
from dropo.core.contracts.problem import Problem
from dropo.core.contracts.support.mean_prior import MeanPrior, within_prior
from dropo.core.records.fits.fit import Fit, Status
from dropo.core.records.start_mean import Start, checked_start, given_start
from dropo.core.services.errors import Incompatible
from dropo.core.services.registry import find
from dropo.core.services.validation import known, require
from dropo.estimators.support.point_estimate import InterruptedEstimate, estimate
from dropo.estimators.support.standard_errors import rounding
from dropo.estimators.support.summary import summarize


@dataclass(frozen=True, kw_only=True)
class LeastSquares(Estimator):
    """Find the parameters with the least weighted squared error.

    By Gauss-Newton in a trust region (scipy's "trf"), with Jacobians by central differences.

    Attributes
    ----------
    weights : {"noise", "equal"} or tuple of float
        "noise": the inverse variance of each signal's residuals, found in a second pass. "equal":
        1, as in eq. 3.1. Or one number for each signal.
    budget : int
        Evaluations of the residuals in each pass, at most.
    step : float or None
        Half the width of the differences, as a fraction of each parameter's interval. None: a
        hundredth in a first pass, one standard error in a second, but no less than a thousandth:
        contacts that switch give slopes without bound as differences shrink.
    start : {"middle"}, mapping, sequence of float or Fit
        Where the first pass begins, as that of `DROPO`.

    Notes
    -----
    xi* = argmin sum_t |s_{t+1} - s_{t+1}^xi|_W^2 (Tiboni 2021, eq. 3.1). With priors of the
    problem, argmin of half of this sum less the log prior: the most probable parameters under the
    noise that the first pass leaves without priors.

    Raises
    ------
    BadArgument
        If `budget` is below 1, `step` is not in (0, 0.5], or a value of `start` is no finite
        number.
    UnknownName
        If `weights` or `start` is a name that is none of those above.
    Incompatible
        Where the problem has priors and weights are not "noise": a prior is weighed against noise.
    """

    weights: Literal["noise", "equal"] | tuple[float, ...] = "noise"
    budget: int = 100
    step: float | None = None
    start: Start = "middle"
    name = "least-squares"
    uses_priors = True

    def __post_init__(self) -> None:
        require(self.budget >= 1, "budget", "at least 1", self.budget, "LeastSquares")
        possible = self.step is None or 0 < self.step <= 0.5
        rule = "a fraction of the interval in (0, 0.5]"
        require(possible, "step", rule, self.step, "LeastSquares")
        if isinstance(self.weights, str):
            known("weights", self.weights, ("noise", "equal"))
        object.__setattr__(self, "start", checked_start(self.start, ("middle",)))

    def _fit(self, problem: Problem, run: Run) -> Fit:
        """The estimate as a family without spread."""
        prior = MeanPrior(problem.priors, problem.space)
        if prior and self.weights != "noise":
            raise Incompatible(
                f"A prior is weighed against the noise, of which weights {self.weights!r} say"
                " nothing. Use weights 'noise', or leave 'prior' out."
            )
        start = given_start(self.start, problem.space)
        try:
            found = estimate(problem, run, self.weights, self.budget, self.step, start, prior=prior)
            status = Status.CONVERGED if found.converged else Status.OUT_OF_BUDGET
        except InterruptedEstimate as stopped:
            found = stopped.best
            status = Status.INTERRUPTED
        family = within_prior(find("families", "point")(problem.space), prior)
        rows = len(problem.segments.rows[0])
        noise = np.maximum(found.noise, rounding(problem))  # a perfect fit would have no density
        density = np.log(2 * np.pi * noise) + found.noise / noise
        return summarize(
            problem,
            run,
            method=self.name,
            family=family,
            family_name="point",
            phi=family.phi(found.value, np.zeros(len(problem.space))),
            epsilon=noise,
            weighted_by=found.weighted_by,
            log_likelihood=-0.5 * rows * float(np.sum(density)),
            mean_prediction=found.predicted,
            status=status,
            message=found.message,
        )
