"""UDR: uniform distributions on bounds drawn at random, the usual way to randomize a simulator."""

from dataclasses import dataclass

import numpy as np

from dropo.core.contracts.estimator import Estimator, Run
from dropo.core.contracts.problem import Problem
from dropo.core.records.fits.fit import Fit, Status
from dropo.core.records.fits.search_records import IntervalHistory
from dropo.core.services.registry import find
from dropo.core.services.validation import Array, require
from dropo.estimators.support.summary import summarize


@dataclass(frozen=True, kw_only=True)
class UniformRandomization(Estimator):
    """Draw bounds of uniform distributions at random from the search space; nothing is fitted.

    Attributes
    ----------
    count : int
        Distributions that are drawn; all are in `search_record.bounds` (count, 2, d).
    which : int
        The one that is the fit, counted from 0.
    draws : int
        From it, by which the log-likelihood is estimated: at the problem's epsilon, else at the
        variance of the residuals.

    Raises
    ------
    BadArgument
        If `count` is below 1, or `which` is not from 0 to `count` - 1.

    References
    ----------
    Tiboni 2021, section 6.1.
    """

    count: int = 10
    which: int = 0
    draws: int = 100
    name = "uniform-randomization"

    def __post_init__(self) -> None:
        made = "UniformRandomization"
        require(self.count >= 1, "count", "at least 1", self.count, made)
        inside = 0 <= self.which < self.count
        require(inside, "which", f"0 to {self.count - 1}", self.which, made)

    def _fit(self, problem: Problem, run: Run) -> Fit:
        """One of the distributions, with the log-likelihood of the data under it."""
        bounds_rng, base_rng = run.rng.spawn(2)
        bounds = random_bounds(problem, self.count, bounds_rng)
        low, high = bounds[self.which]
        family = find("families", "uniform")(problem.space)
        phi = family.phi((low + high) / 2, (high - low) / 2)

        # First the mean, which does not depend on the noise, then the likelihood at its residuals.
        likelihood = find("likelihoods", "monte-carlo")(draws=self.draws)
        simulator = problem.simulator
        segments = problem.segments
        with run.counting(evaluations=1):
            mean = likelihood.bind(simulator, segments, family, 1.0, base_rng).mean(phi)
        if problem.epsilon is None:
            epsilon = np.mean((mean - simulator.targets(segments)) ** 2, axis=0)
        else:
            epsilon = np.broadcast_to(problem.epsilon, mean.shape[1:])
        epsilon = np.asarray(epsilon, dtype=float)
        with run.counting(evaluations=1):
            value = likelihood.bind(simulator, segments, family, epsilon, base_rng)(phi)
        return summarize(
            problem,
            run,
            method=self.name,
            family=family,
            family_name="uniform",
            phi=phi,
            epsilon=epsilon,
            log_likelihood=value,
            mean_prediction=mean,
            status=Status.DONE,
            message="Bounds drawn at random; nothing was fitted.",
            search_record=IntervalHistory(bounds),
        )


def random_bounds(problem: Problem, count: int, rng: np.random.Generator) -> Array:
    """Draw two points of each parameter's interval, the lower first.

    Parameters
    ----------
    problem : Problem
    count : int
        How often.
    rng : numpy.random.Generator

    Returns
    -------
    (count, 2, d) array
    """
    points = np.sort(rng.random((count, 2, len(problem.space))), axis=1)
    return problem.space.low + points * (problem.space.high - problem.space.low)
