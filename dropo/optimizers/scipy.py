"""Optimizers of SciPy, each in a thread of its own."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from dropo.core.contracts.optimizer import CallbackOptimizer
from dropo.core.services.validation import Array, require

Cost = Callable[[Array], tuple[float, Array | None]]
STEP_TOLERANCE = 1e-11  # of the box: posteriors of noise-free data can be as narrow as 1e-9 of it
COST_TOLERANCE = (
    1e-12  # of the cost: its unit is not known here, so no difference is small by itself
)


def _value(cost: Cost) -> Callable[[Array], float]:
    return lambda point: cost(point)[0]


def _box(dimension: int) -> Any:
    import scipy.optimize

    return scipy.optimize.Bounds(np.zeros(dimension), np.ones(dimension))


def _sentence(method: str, result: Any) -> str:
    return f"SciPy's {method} stopped: {str(result.message).strip().rstrip('.')}."


class NelderMead(CallbackOptimizer):
    """The simplex method (Nelder and Mead 1965), with coefficients that depend on the dimension
    (Gao and Han 2012).
    """

    def _minimise(self, cost: Cost) -> str:
        import scipy.optimize

        inward = np.where(
            self.start + self.step <= 1, self.start + self.step, self.start - self.step
        )
        corners = np.where(
            np.eye(self.dimension, dtype=bool), np.clip(inward, 0, 1), self.start
        )  # (m, m)
        options: Any = {
            "initial_simplex": np.vstack([self.start, corners]),
            "xatol": STEP_TOLERANCE,
            "fatol": np.inf,
            "maxfev": self.budget + 1,
            "adaptive": True,
        }
        result = scipy.optimize.minimize(
            _value(cost),
            self.start,
            method="Nelder-Mead",
            bounds=_box(self.dimension),
            options=options,
        )
        return _sentence("Nelder-Mead", result)


class LbfgsB(CallbackOptimizer):
    """Low-storage BFGS with bounds (Byrd, Lu, Nocedal and Zhu 1995); it chooses its own first step."""

    needs_gradients = True

    def _minimise(self, cost: Cost) -> str:
        import scipy.optimize

        options: Any = {
            "maxfun": self.budget + 1,
            "maxiter": self.budget + 1,
            "ftol": np.finfo(float).eps,
            "gtol": 0.0,
        }
        both: Any = cost
        result = scipy.optimize.minimize(
            both,
            self.start,
            jac=True,
            method="L-BFGS-B",
            bounds=_box(self.dimension),
            options=options,
        )
        return _sentence("L-BFGS-B", result)


class DifferentialEvolution(CallbackOptimizer):
    """Differences of a population as steps (Storn and Price 1997); global, random. population:
    points, by default 15 m.
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
    ):
        super().__init__(dimension, rng, start=start, step=step, budget=budget)
        require(
            population is None or population >= 5,
            "population",
            "at least 5",
            population,
            "DifferentialEvolution",
        )
        self.population = population or 15 * dimension

    def _minimise(self, cost: Cost) -> str:
        import scipy.optimize
        from scipy.stats import qmc

        own = self.rng.spawn(1)[0]
        first = qmc.LatinHypercube(self.dimension, rng=own).random(max(5, self.population))
        result = scipy.optimize.differential_evolution(
            _value(cost),
            _box(self.dimension),
            init=first,
            x0=self.start,
            rng=own,
            maxiter=self.budget + 1,
            tol=COST_TOLERANCE,
            atol=0.0,
            polish=False,
        )
        return _sentence("differential evolution", result)
