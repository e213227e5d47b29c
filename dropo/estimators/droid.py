"""DROID: means by squared distance, the distribution from the search's own covariance."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from dropo.core.contracts.estimator import Estimator, Run
from dropo.core.contracts.problem import Problem
from dropo.core.contracts.support.maximize import maximize
from dropo.core.records.fits.fit import Fit
from dropo.core.records.fits.search_records import DistanceSearch
from dropo.core.services.errors import Incompatible
from dropo.core.services.registry import find
from dropo.core.services.validation import Array, require
from dropo.estimators.support.standard_errors import rounding
from dropo.estimators.support.summary import summarize


@dataclass(frozen=True, kw_only=True)
class DROID(Estimator):
    """Minimise the squared distance of simulated to measured states over the means, by CMA-ES.

    The distribution is the final covariance of CMA-ES itself: how far the search had converged, not
    how much the parameters vary.

    Attributes
    ----------
    optimizer : str
        The name of one that ends with a `covariance` (m, m) in the unit box.
    budget : int
        Evaluations of the distance at most, one simulation of all segments each.

    Raises
    ------
    BadArgument
        If `budget` is below 1.
    Incompatible
        By `fit`, if the optimizer ends without a covariance.

    References
    ----------
    Tiboni 2021, section 6.1.
    """

    optimizer: str = "cma-es"
    budget: int = 1000
    name = "droid"

    def __post_init__(self) -> None:
        require(self.budget >= 1, "budget", "at least 1", self.budget, "DROID")

    def _fit(self, problem: Problem, run: Run) -> Fit:
        """The Gaussian around the least distance, with the covariance of the search."""
        simulator = problem.simulator
        segments = problem.segments
        space = problem.space
        targets = simulator.targets(segments)

        def minus_distance(points: Array) -> Array:
            predictions = simulator.predict(space.from_unit(points), segments)
            return -np.sum((predictions - targets) ** 2, axis=(1, 2))

        search = self._make_search(len(space), run.rng)
        found = maximize(minus_distance, space, search, run, batched=True)
        width = space.high - space.low
        covariance = search.covariance * np.outer(width, width)
        family = find("families", "full")(space)

        # The noise is what the means leave.
        with run.counting():
            predicted = simulator.predict(found.point[None], segments)[0]
        residual = np.mean((predicted - targets) ** 2, axis=0)
        noise = np.maximum(residual, rounding(problem))
        density = float(np.sum(np.log(2 * np.pi * noise) + residual / noise))
        return summarize(
            problem,
            run,
            method=self.name,
            family=family,
            family_name="full",
            phi=family.phi_of(found.point, covariance),
            epsilon=noise,
            weighted_by=np.ones(targets.shape[1]),
            log_likelihood=-0.5 * density * len(targets),
            mean_prediction=predicted,
            message=found.reason,
            status=found.status,
            search_record=DistanceSearch(-found.value),
        )

    def _make_search(self, d: int, rng: np.random.Generator) -> Any:
        """The optimizer, which must have a covariance."""
        further = {"restarts": 0} if self.optimizer == "cma-es" else {}
        search = find("optimizers", self.optimizer)(d, rng, budget=self.budget, **further)
        if search.covariance is None:
            raise Incompatible(
                "DROID reads its distribution from the optimizer's covariance, and"
                f" {self.optimizer!r} has none. Use 'cma-es'."
            )
        return search
