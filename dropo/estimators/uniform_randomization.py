"""UDR: uniform distributions on bounds drawn at random, the usual way to randomize a simulator."""

from dataclasses import dataclass

import numpy as np

from dropo.core.contracts.estimator import Estimator, Run
from dropo.core.contracts.problem import Problem
from dropo.core.records.fit import Fit, Status
from dropo.core.records.search_records import IntervalHistory
from dropo.core.services.registry import find
from dropo.core.services.validation import Array, require
from dropo.estimators.support.summary import summarize


@dataclass(frozen=True, kw_only=True)
class UniformRandomization(Estimator):
    """Uniform distributions on `count` bounds drawn at random from the search space (thesis,
    section 6.1); fits nothing.

    The fit is the one number `which` of them; all are in `search_record.bounds` (count, 2, d). Its
    log-likelihood, at the problem's epsilon or else the residuals' variance, is that of `draws`
    draws.
    """

    count: int = 10
    which: int = 0
    draws: int = 100
    name = "uniform-randomization"

    def __post_init__(self) -> None:
        require(self.count >= 1, "count", "at least 1", self.count, "UniformRandomization")
        require(
            0 <= self.which < self.count,
            "which",
            f"0 to {self.count - 1}",
            self.which,
            "UniformRandomization",
        )

    def _fit(self, problem: Problem, run: Run) -> Fit:
        randomness, base = run.rng.spawn(2)
        bounds = random_bounds(problem, self.count, randomness)
        low, high = bounds[self.which]
        family = find("families", "uniform")(problem.space)
        phi = family.phi((low + high) / 2, (high - low) / 2)
        likelihood = find("likelihoods", "monte-carlo")(draws=self.draws)
        targets = problem.simulator.targets(problem.segments)
        with run.counting(evaluations=1):
            mean = likelihood.bind(problem.simulator, problem.segments, family, 1.0, base).mean(phi)
        epsilon = (
            np.mean((mean - targets) ** 2, axis=0)
            if problem.epsilon is None
            else np.broadcast_to(problem.epsilon, targets.shape[1:])
        )
        with run.counting(evaluations=1):
            value = likelihood.bind(
                problem.simulator, problem.segments, family, np.asarray(epsilon, dtype=float), base
            )(phi)
        return summarize(
            problem,
            run,
            method=self.name,
            family=family,
            family_name="uniform",
            phi=phi,
            epsilon=np.asarray(epsilon, dtype=float),
            log_likelihood=value,
            mean_prediction=mean,
            status=Status.DONE,
            message="Bounds drawn at random; nothing was fitted.",
            search_record=IntervalHistory(bounds),
        )


def random_bounds(problem: Problem, count: int, rng: np.random.Generator) -> Array:
    """(count, 2, d): for each parameter two points of its interval, the lower first."""
    points = np.sort(rng.random((count, 2, len(problem.space))), axis=1)
    return problem.space.low + points * (problem.space.high - problem.space.low)
