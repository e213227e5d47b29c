"""CMA-ES by pycma, scaled as in the thesis, with restarts that double the population."""

import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from dropo.core.contracts.optimizer import Optimizer
from dropo.core.services.validation import Array, require

REASONS = {
    "tolx": "The steps became too small to matter.",
    "tolfun": "The costs no longer differ.",
    "tolfunhist": "The best costs no longer change.",
    "tolflatfitness": "All points of several generations cost the same.",
    "tolstagnation": "The costs stopped falling.",
    "tolxstagnation": "The mean stopped moving.",
    "noeffectaxis": "The steps are lost in rounding.",
    "noeffectcoord": "The steps are lost in rounding.",
    "tolconditioncov": "The cost is too badly conditioned: some direction hardly matters.",
    "tolfacupx": "The steps grew a thousandfold: the first ones were far too small.",
    "tolupsigma": "The steps grew without an end: the cost hardly changes anywhere.",
}
"""A sentence for each of pycma's reasons to stop."""


@dataclass(frozen=True, kw_only=True)
class CMAESSettings:
    """Scaling and tolerances of CMA-ES.

    Attributes
    ----------
    width : float
        Length of a coordinate's interval inside pycma. In the thesis (section 5.3) every coordinate
        lies in [0, 4], and the search starts at 2 with sigma_0 = 1.
    tolerance : float
        Change of a coordinate of length `width` that is too small to matter. Posteriors of
        noise-free data can be as narrow as 1e-9 of the box.
    improvement : float
        Relative decrease of the cost below which a restart has found the same optimum again.
    flat_generations : int
        Number of generations without any difference of costs after which a run ends. A single
        generation may fail as a whole.
    stagnation_generations : int
        Number of generations without a movement of the mean after which a run ends.
    """

    width: float = 4.0
    tolerance: float = 1e-12
    improvement: float = 1e-12
    flat_generations: int = 5
    stagnation_generations: int = 20


DEFAULTS = CMAESSettings()


class CMAES(Optimizer):
    """Covariance matrix adaptation, with restarts from random points.

    Parameters
    ----------
    dimension : int
        Number m of coordinates.
    rng : numpy.random.Generator
        Source of all random numbers.
    start : (m,) array, optional
        Mean of the first run, in the unit box; the middle by default.
    step : float or (m,) array
        Standard deviations of the first generation, in the unit box.
    budget : int
        Number of evaluations that the restarts are planned with.
    population : int, optional
        Points in a generation of the first run, by default pycma's 4 + 3 ln m. Each restart doubles
        it (IPOP).
    restarts : int, optional
        Maximum number of restarts: 0 for none, by default as many as the budget has room for.
    settings : CMAESSettings
        Scaling and tolerances.

    Raises
    ------
    BadArgument
        If `population` is below 4, `restarts` is negative, or an argument of `Optimizer` is
        refused.

    References
    ----------
    Hansen (2016), "The CMA evolution strategy: a tutorial", arXiv:1604.00772.
    Auger and Hansen (2005), "A restart CMA evolution strategy with increasing population size",
    IEEE Congress on Evolutionary Computation.
    """

    def __init__(
        self,
        dimension: int,
        rng: np.random.Generator,
        *,
        start: ArrayLike | None = None,
        step: ArrayLike = 0.25,
        budget: int = 5000,
        population: int | None = None,
        restarts: int | None = None,
        settings: CMAESSettings = DEFAULTS,
    ):
        super().__init__(dimension, rng, start=start, step=step, budget=budget)
        require(
            population is None or population >= 4, "population", "at least 4", population, "CMAES"
        )
        require(restarts is None or restarts >= 0, "restarts", "0 or more", restarts, "CMAES")
        self.population = population or 4 + int(3 * np.log(dimension))
        self.restarts = restarts
        self.settings = settings
        # number of the present run, evaluations in all, and evaluations before the present run
        self._run = 0
        self._evaluations = 0
        self._evaluations_before = 0
        # of the run that found the best point, where it is an earlier one: why it ended, and its
        # covariance
        self._best_reason = ""
        self._best_covariance: Array | None = None
        self._lowest_cost = float(np.finfo(float).max)
        self._asked: list[Array] = []
        self._strategy = self._new_strategy(self.start)

    @property
    def covariance(self) -> Array:
        """The (m, m) final covariance of the run that found the best point, in the unit box.

        Near a bound these are the search's own coordinates, before pycma folds them into the box.
        """
        if self._best_covariance is None:
            return self._present_covariance()
        return self._best_covariance

    def _new_strategy(self, start: Array) -> Any:
        """Returns pycma's strategy of the present run, which begins at `start` (m,)."""
        # pycma warns that its plots want matplotlib, which is not needed here
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)
            import cma

        width = self.settings.width
        widest = float(self.step.max())
        return cma.CMAEvolutionStrategy(width * start, width * widest, self._options(widest))

    def _options(self, widest: float) -> dict[str, Any]:
        """Returns pycma's options of the present run."""
        tolerance = self.settings.tolerance
        search = {
            "CMA_stds": (self.step / widest).tolist(),
            "bounds": [0.0, self.settings.width],
            "popsize": self.population * 2**self._run,
            # pycma 4.5 cannot shorten a step in one dimension
            "maxstd_boundrange": 1 / 3 if self.dimension > 1 else np.inf,
        }
        # these two together keep pycma off numpy's global stream
        randomness = {"randn": lambda *shape: self.rng.standard_normal(shape), "seed": np.nan}
        # the cost's unit is not known here, so no difference of costs is small by itself
        stopping = {
            "tolfun": 0.0,
            "tolfunhist": 0.0,
            "tolx": tolerance,
            "tolxstagnation": [tolerance, self.settings.stagnation_generations, 0.1],
            "tolflatfitness": self.settings.flat_generations,
            "maxiter": np.inf,
        }
        # -10: no messages and no files
        silence = {"verbose": -10, "verb_log": 0, "verb_disp": 0}
        return {**search, **randomness, **stopping, **silence}

    def _ask(self) -> Array:
        if self._end_reason() is not None:
            self._restart()
        self._asked = self._strategy.ask()
        return np.array(self._asked) / self.settings.width

    def _tell(self, points: Array, costs: Array, gradients: Array | None) -> None:
        require(
            len(points) == len(self._asked),
            "points",
            f"the {len(self._asked)} asked for",
            len(points),
            "CMAES.tell",
        )
        margin = self.settings.improvement * abs(self._lowest_cost)
        if costs.min() < self._lowest_cost - margin:
            self._lowest_cost = float(costs.min())
            self._best_reason = ""
            self._best_covariance = None
        # pycma recognises its own points bit for bit, so it gets those that it gave
        self._strategy.tell(self._asked, costs.tolist())
        self._evaluations += len(points)

    def _stop(self) -> str | None:
        reason = self._end_reason()
        if reason is None:
            out_of_budget = self._evaluations + self._strategy.popsize > self.budget
            if out_of_budget and self._best_reason:
                return (
                    f"{self._best_reason} Restart {self._run} found no better before the budget "
                    "ran out."
                )
            return None
        if self._may_restart():
            return None
        if self._run == 0:
            return reason
        return f"{self._best_reason or reason} {self._run} restarts are done."

    def _end_reason(self) -> str | None:
        """Returns why the present run is over, or None while it is not."""
        if self._evaluations == self._evaluations_before:
            return None
        keys = list(self._strategy.stop())
        return REASONS.get(keys[0], f"pycma stopped: {keys[0]}.") if keys else None

    def _may_restart(self) -> bool:
        """Returns whether another run is due; it takes about twice the evaluations of the last."""
        if self.restarts is not None:
            return self._run < self.restarts
        last_run = self._evaluations - self._evaluations_before
        return self.budget - self._evaluations >= 2 * last_run

    def _restart(self) -> None:
        """Begins another run at a random point, with twice the population."""
        if self._best_covariance is None:
            self._best_reason = self._end_reason() or ""
            self._best_covariance = self._present_covariance()
        self._run += 1
        self._evaluations_before = self._evaluations
        self._strategy = self._new_strategy(self.rng.random(self.dimension))

    def _present_covariance(self) -> Array:
        """Returns the covariance (m, m) of the present run, in the unit box."""
        m = self.dimension
        scaling = np.broadcast_to(self._strategy.sigma_vec.scaling, m)
        deviations = self._strategy.sigma * scaling / self.settings.width
        shape = np.reshape(self._strategy.sm.C, (m, m))
        return np.asarray(deviations[:, None] * shape * deviations)


class CMAESOnce(CMAES):
    """The same without restarts, as in the thesis: one run, which ends by itself or by its budget.

    Parameters
    ----------
    dimension : int
        Number m of coordinates.
    rng : numpy.random.Generator
        Source of all random numbers.
    **settings
        Those of `CMAES`, but for `restarts`.
    """

    def __init__(self, dimension: int, rng: np.random.Generator, **settings: Any):
        super().__init__(dimension, rng, **settings, restarts=0)
