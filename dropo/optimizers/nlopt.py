"""Optimizers of NLopt (Johnson, github.com/stevengj/nlopt), each in a thread of its own."""

from collections.abc import Callable
from typing import Any

import numpy as np

from dropo.core.contracts.optimizer import CallbackOptimizer
from dropo.core.services.validation import Array

Cost = Callable[[Array], tuple[float, Array | None]]
"""A cost and its gradient (m,), or None, at a point (m,) of the unit box."""


class _Nlopt(CallbackOptimizer):
    """Runs the algorithm that a subclass names.

    Attributes
    ----------
    algorithm : str
        NLopt's name of the algorithm.
    tolerance : float
        Movement of the point, as a fraction of the box, below which the search ends. Posteriors of
        noise-free data can be as narrow as 1e-9 of the box.
    max_step : float
        Largest first step that the algorithm accepts, as a fraction of the box.
    """

    algorithm: str
    tolerance = 1e-11
    max_step = np.inf

    def _minimise(self, cost: Cost) -> str:
        import nlopt

        # NLopt's generator belongs to the thread, and so to this optimizer
        nlopt.srand(int(self.rng.integers(2**31)))
        objective = _Objective(cost)
        search = self._search(objective)
        objective.force_stop = search.force_stop
        try:
            search.optimize(self.start)
        except nlopt.ForcedStop:
            raise objective.error or RuntimeError("NLopt was stopped from outside.") from None
        except nlopt.RoundoffLimited:
            return "Rounding errors hide any further improvement."
        except (RuntimeError, nlopt.runtime_error) as error:
            # NLopt raises so where a line search finds nothing lower
            return (
                f"{self.algorithm} found nothing better along its last direction "
                f"({error or 'no reason given'})."
            )
        return self._describe_end(search.last_optimize_result())

    def _search(self, objective: "_Objective") -> Any:
        """Returns NLopt's search over the unit box."""
        import nlopt

        search = nlopt.opt(getattr(nlopt, self.algorithm), self.dimension)
        search.set_lower_bounds(np.zeros(self.dimension))
        search.set_upper_bounds(np.ones(self.dimension))
        search.set_initial_step(np.minimum(self.step, self.max_step))
        search.set_xtol_rel(self.tolerance)
        search.set_xtol_abs(np.full(self.dimension, self.tolerance))
        # one more than is ever asked for, so that an exhausted budget is not taken for convergence
        search.set_maxeval(self.budget + 1)
        search.set_min_objective(objective)
        return search

    def _describe_end(self, code: int) -> str:
        """Returns a sentence on why NLopt stopped, from its result code."""
        reasons = {
            1: "The method has nothing left to improve.",
            3: "The cost stopped changing.",
            4: f"The point stopped moving, to {self.tolerance:g} of the box.",
            5: "NLopt's own budget ran out.",
        }
        return reasons.get(code, "NLopt stopped.")


class _Objective:
    """The cost as NLopt calls it.

    Some of NLopt's methods go on after an exception in the objective. It is therefore stored in
    `error`, and NLopt is asked to stop.
    """

    def __init__(self, cost: Cost):
        self.cost = cost
        self.force_stop: Callable[[], None] = lambda: None
        self.error: BaseException | None = None

    def __call__(self, point: Array, gradient: Any) -> float:
        if self.error is None:
            try:
                value, derivative = self.cost(point)
                if gradient.size:
                    gradient[:] = derivative
                return value
            except BaseException as error:
                self.error = error
        self.force_stop()
        return 0.0


class Bobyqa(_Nlopt):
    """Quadratic models in a trust region: fast where the cost is smooth, unreliable elsewhere.

    References
    ----------
    Powell (2009), "The BOBYQA algorithm for bound constrained optimization without derivatives",
    report NA2009/06, University of Cambridge.
    """

    algorithm = "LN_BOBYQA"
    max_step = 0.49  # the trust region must fit twice between the bounds


class Sbplx(_Nlopt):
    """Nelder-Mead in subspaces, in Johnson's version; it survives failed points.

    References
    ----------
    Rowan (1990), "Functional stability analysis of numerical algorithms", PhD thesis, University of
    Texas at Austin.
    """

    algorithm = "LN_SBPLX"


class Crs2(_Nlopt):
    """Controlled random search with local mutation, a global method that ends with the budget.

    References
    ----------
    Kaelo and Ali (2006), "Some variants of the controlled random search algorithm for global
    optimization", Journal of Optimization Theory and Applications 130.
    """

    algorithm = "GN_CRS2_LM"
    # NLopt compares successive best points here, which are close by chance long before the end
    tolerance = 0.0


class DirectL(_Nlopt):
    """Dividing rectangles, biased to local search: global, deterministic, ends with the budget.

    References
    ----------
    Gablonsky and Kelley (2001), "A locally-biased form of the DIRECT algorithm", Journal of Global
    Optimization 21.
    """

    algorithm = "GN_DIRECT_L"


class Lbfgs(_Nlopt):
    """Limited-memory BFGS, in Luksan's version.

    References
    ----------
    Liu and Nocedal (1989), "On the limited memory BFGS method for large scale optimization",
    Mathematical Programming 45.
    """

    algorithm = "LD_LBFGS"
    needs_gradients = True


class Slsqp(_Nlopt):
    """Sequential quadratic programming.

    References
    ----------
    Kraft (1994), "Algorithm 733: TOMP, Fortran modules for optimal control calculations", ACM
    Transactions on Mathematical Software 20.
    """

    algorithm = "LD_SLSQP"
    needs_gradients = True
