"""Optimizers of SciPy, each in a thread of its own."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from dropo.core.contracts.optimizer import CallbackOptimizer
from dropo.core.services.validation import Array, require

Cost = Callable[[Array], tuple[float, Array | None]]
"""A cost and its gradient (m,), or None, at a point (m,) of the unit box."""


def _value_of(cost: Cost) -> Callable[[Array], float]:
    """Returns the cost without its gradient."""
    return lambda point: cost(point)[0]


def _unit_box(dimension: int) -> Any:
    """Returns the bounds of the unit box."""
    import scipy.optimize

    return scipy.optimize.Bounds(np.zeros(dimension), np.ones(dimension))


def _describe_end(method: str, result: Any) -> str:
    """Returns a sentence on why a method stopped."""
    return f"SciPy's {method} stopped: {str(result.message).strip().rstrip('.')}."


class NelderMead(CallbackOptimizer):
    """The simplex method, with coefficients that depend on the dimension.

    Attributes
    ----------
    point_tolerance : float
        Size of the simplex, as a fraction of the box, below which the search ends. Posteriors of
        noise-free data can be as narrow as 1e-9 of the box.

    References
    ----------
    Nelder and Mead (1965), "A simplex method for function minimization", The Computer Journal 7.
    Gao and Han (2012), "Implementing the Nelder-Mead simplex algorithm with adaptive parameters",
    Computational Optimization and Applications 51.
    """

    point_tolerance = 1e-11

    def _minimise(self, cost: Cost) -> str:
        import scipy.optimize

        # corner i of the simplex is the start, with coordinate i one step away inside the box
        forward = self.start + self.step
        inward = np.where(forward <= 1, forward, self.start - self.step)
        corners = np.where(np.eye(self.dimension, dtype=bool), np.clip(inward, 0, 1), self.start)
        options: Any = {
            "initial_simplex": np.vstack([self.start, corners]),
            "xatol": self.point_tolerance,
            "fatol": np.inf,
            "maxfev": self.budget + 1,
            "adaptive": True,
        }
        result = scipy.optimize.minimize(
            _value_of(cost),
            self.start,
            method="Nelder-Mead",
            bounds=_unit_box(self.dimension),
            options=options,
        )
        return _describe_end("Nelder-Mead", result)


class LbfgsB(CallbackOptimizer):
    """Limited-memory BFGS with bounds; it chooses its own first step.

    References
    ----------
    Byrd, Lu, Nocedal and Zhu (1995), "A limited memory algorithm for bound constrained
    optimization", SIAM Journal on Scientific Computing 16.
    """

    needs_gradients = True

    def _minimise(self, cost: Cost) -> str:
        import scipy.optimize

        options: Any = {
            "maxfun": self.budget + 1,
            "maxiter": self.budget + 1,
            "ftol": np.finfo(float).eps,
            "gtol": 0.0,
        }
        value_and_gradient: Any = cost
        result = scipy.optimize.minimize(
            value_and_gradient,
            self.start,
            jac=True,
            method="L-BFGS-B",
            bounds=_unit_box(self.dimension),
            options=options,
        )
        return _describe_end("L-BFGS-B", result)


class DifferentialEvolution(CallbackOptimizer):
    """A global random search that takes differences within a population as steps.

    Parameters
    ----------
    dimension : int
        Number m of coordinates.
    rng : numpy.random.Generator
        Source of all random numbers.
    start : (m,) array, optional
        First point, in the unit box; the middle by default.
    step : float or (m,) array
        Width of the first steps, in the unit box.
    budget : int
        Maximum number of evaluations.
    population : int, optional
        Number of points, by default 15 m.

    Attributes
    ----------
    cost_tolerance : float
        Relative spread of the population's costs below which the search ends. The cost's unit is
        not known here, so that no absolute difference is small.

    Raises
    ------
    BadArgument
        If `population` is below 5, or an argument of `Optimizer` is refused.

    References
    ----------
    Storn and Price (1997), "Differential evolution: a simple and efficient heuristic for global
    optimization over continuous spaces", Journal of Global Optimization 11.
    """

    cost_tolerance = 1e-12

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

        rng = self.rng.spawn(1)[0]
        first = qmc.LatinHypercube(self.dimension, rng=rng).random(max(5, self.population))
        result = scipy.optimize.differential_evolution(
            _value_of(cost),
            _unit_box(self.dimension),
            init=first,
            x0=self.start,
            rng=rng,
            maxiter=self.budget + 1,
            tol=self.cost_tolerance,
            atol=0.0,
            polish=False,
        )
        return _describe_end("differential evolution", result)
