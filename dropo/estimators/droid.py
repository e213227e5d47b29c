"""DROID: means by squared distance, the distribution from the search's own covariance."""

from dataclasses import dataclass

import numpy as np

from dropo.core.contracts.estimator import Estimator, Run
from dropo.core.contracts.maximize import maximize
from dropo.core.contracts.problem import Problem
from dropo.core.records.fit import Fit
from dropo.core.records.search_records import DistanceSearch
from dropo.core.services.errors import Incompatible
from dropo.core.services.registry import find
from dropo.core.services.validation import Array, require
from dropo.estimators.support.standard_errors import rounding
from dropo.estimators.support.summary import summarize


@dataclass(frozen=True, kw_only=True)
class DROID(Estimator):
    """Least squared distance of simulated to measured states over the means alone, by CMA-ES
    (thesis, section 6.1).

    Its distribution is the final covariance of CMA-ES itself: how far the search had converged, not
    how much the parameters vary. optimizer: the name of one that ends with a `covariance` (m, m) in
    the unit box; budget: evaluations of the distance at most, one simulation of all segments each.
    """

    optimizer: str = "cma-es"
    budget: int = 1000
    name = "droid"

    def __post_init__(self) -> None:
        require(self.budget >= 1, "budget", "at least 1", self.budget, "DROID")

    def _fit(self, problem: Problem, run: Run) -> Fit:
        simulator = problem.simulator
        segments = problem.segments
        space = problem.space
        targets = simulator.targets(segments)

        def minus_distance(points: Array) -> Array:
            predictions = simulator.predict(space.from_unit(points), segments)
            return -np.sum((predictions - targets) ** 2, axis=(1, 2))

        search = find("optimizers", self.optimizer)(
            len(space),
            run.rng,
            budget=self.budget,
            **({"restarts": 0} if self.optimizer == "cma-es" else {}),
        )
        if not hasattr(search, "covariance"):
            raise Incompatible(
                "DROID reads its distribution from the optimizer's covariance, and "
                f"{self.optimizer!r} has none. Use 'cma-es'."
            )
        result = maximize(minus_distance, space, search, run, batched=True)
        width = space.high - space.low
        covariance = search.covariance * np.outer(width, width)
        family = find("families", "full")(space)
        with run.counting():
            predicted = simulator.predict(result.point[None], segments)[0]
        residual = np.mean((predicted - targets) ** 2, axis=0)
        noise = np.maximum(residual, rounding(problem))
        log_likelihood = (
            -0.5 * float(np.sum(np.log(2 * np.pi * noise) + residual / noise)) * len(targets)
        )
        return summarize(
            problem,
            run,
            method=self.name,
            family=family,
            family_name="full",
            phi=family.phi_of(result.point, covariance),
            epsilon=noise,
            weighted_by=np.ones(targets.shape[1]),
            log_likelihood=log_likelihood,
            mean_prediction=predicted,
            message=result.reason,
            status=result.status,
            search_record=DistanceSearch(-result.value),
        )
