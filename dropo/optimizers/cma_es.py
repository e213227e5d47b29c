"""CMA-ES by pycma (Hansen 2016, arXiv:1604.00772), scaled as in the thesis, with restarts that
double the population.
"""

import warnings
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from dropo.core.contracts.optimizer import Optimizer
from dropo.core.services.validation import Array, require

# thesis, section 5.3: every coordinate lies in [0, 4], the search starts at 2 with sigma_0 = 1
WIDTH = 4.0
TOLERANCE = (
    1e-12  # of a coordinate: posteriors of noise-free data can be as narrow as 1e-9 of the box
)
ROUNDING = (
    1e-12  # a restart that lowers the cost by less than this share has found the same optimum
)
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


class CMAES(Optimizer):
    """Covariance matrix adaptation. The first run begins at `start`, further ones at random points.

    population: points in a generation of the first run, by default pycma's 4 + 3 ln m; each restart
    doubles it (IPOP, Auger and Hansen 2005). restarts: how many at most; by default as many as the
    budget has room for, 0 for none.
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
    ):
        super().__init__(dimension, rng, start=start, step=step, budget=budget)
        require(
            population is None or population >= 4, "population", "at least 4", population, "CMAES"
        )
        require(restarts is None or restarts >= 0, "restarts", "0 or more", restarts, "CMAES")
        self.population = population or 4 + int(3 * np.log(dimension))
        self.restarts = restarts
        # restarts so far, costs told, and those told before this run
        self._run = 0
        self._told = 0
        self._first = 0
        self._earlier = (
            ""  # why the run that holds the best point ended, where it is not the present one
        )
        self._kept: Array | None = None  # that run's covariance
        self._least = float(np.finfo(float).max)
        self._asked: list[Array] = []
        self._es = self._begin(self.start)

    @property
    def covariance(self) -> Array:
        """(m, m) final covariance of the run that found the best point, in unit-box coordinates.

        Near a bound these are the search's own coordinates, before pycma folds them into the box.
        """
        return self._present_covariance() if self._kept is None else self._kept

    def _begin(self, start: Array) -> Any:
        with warnings.catch_warnings():  # its plots want matplotlib, which is not needed here
            warnings.simplefilter("ignore", UserWarning)
            import cma

        widest = float(self.step.max())
        return cma.CMAEvolutionStrategy(
            WIDTH * start,
            WIDTH * widest,
            {
                "CMA_stds": (self.step / widest).tolist(),
                "bounds": [0.0, WIDTH],
                "popsize": self.population * 2**self._run,
                "randn": lambda *shape: self.rng.standard_normal(shape),
                "seed": np.nan,  # together they keep off numpy's global stream
                "maxstd_boundrange": 1 / 3
                if self.dimension > 1
                else np.inf,  # pycma 4.5 cannot shorten a step in one dimension
                "tolfun": 0.0,
                "tolfunhist": 0.0,  # the cost's unit is not known here, so no difference is small
                "tolx": TOLERANCE,
                "tolxstagnation": [TOLERANCE, 20, 0.1],
                "tolflatfitness": 5,  # a generation may fail as a whole
                "maxiter": np.inf,
                "verbose": -10,
                "verb_log": 0,
                "verb_disp": 0,  # -10: no messages, no files, not even one to listen to
            },
        )

    def _ask(self) -> Array:
        if self._ended() is not None:
            self._restart()
        self._asked = self._es.ask()
        return np.array(self._asked) / WIDTH

    def _tell(self, points: Array, costs: Array, gradients: Array | None) -> None:
        require(
            len(points) == len(self._asked),
            "points",
            f"the {len(self._asked)} asked for",
            len(points),
            "CMAES.tell",
        )
        if costs.min() < self._least - ROUNDING * abs(self._least):
            self._least = float(costs.min())
            self._earlier = ""
            self._kept = None
        self._es.tell(
            self._asked, costs.tolist()
        )  # pycma knows its own points, bit for bit, by what it asked for
        self._told += len(points)

    def _stop(self) -> str | None:
        reason = self._ended()
        if reason is None:
            cut_short = self._told + self._es.popsize > self.budget and self._earlier
            return (
                f"{self._earlier} Restart {self._run} found no better before the budget ran out."
                if cut_short
                else None
            )
        if self._room():
            return None
        return (
            reason
            if self._run == 0
            else f"{self._earlier or reason} {self._run} restarts are done."
        )

    def _ended(self) -> str | None:
        """Why the present run is over, or None."""
        if self._told == self._first:
            return None
        keys = list(self._es.stop())
        return REASONS.get(keys[0], f"pycma stopped: {keys[0]}.") if keys else None

    def _room(self) -> bool:
        """Whether another run is due; twice the population takes about twice the evaluations."""
        if self.restarts is not None:
            return self._run < self.restarts
        return self.budget - self._told >= 2 * (self._told - self._first)

    def _restart(self) -> None:
        if self._kept is None:
            self._earlier, self._kept = self._ended() or "", self._present_covariance()
        self._run = self._run + 1
        self._first = self._told
        self._es = self._begin(self.rng.random(self.dimension))

    def _present_covariance(self) -> Array:
        deviations = (
            self._es.sigma * np.broadcast_to(self._es.sigma_vec.scaling, self.dimension) / WIDTH
        )
        return np.asarray(
            deviations[:, None]
            * np.reshape(self._es.sm.C, (self.dimension, self.dimension))
            * deviations
        )
