"""Optimizers of NLopt (Johnson, github.com/stevengj/nlopt), each in a thread of its own."""

from collections.abc import Callable
from typing import Any

import numpy as np

from dropo.core.contracts.optimizer import CallbackOptimizer
from dropo.core.services.validation import Array

TOLERANCE = 1e-11  # of the box: posteriors of noise-free data can be as narrow as 1e-9 of it
REASONS = {
    1: "The method has nothing left to improve.",
    3: "The cost stopped changing.",
    4: f"The point stopped moving, to {TOLERANCE:g} of the box.",
    5: "NLopt's own budget ran out.",
}


class _Nlopt(CallbackOptimizer):
    """A plug-in names NLopt's algorithm."""

    algorithm: str
    tolerance = TOLERANCE
    widest = np.inf  # largest first step that the algorithm accepts [share of the box]

    def _minimise(self, cost: Callable[[Array], tuple[float, Array | None]]) -> str:
        import nlopt

        nlopt.srand(
            int(self.rng.integers(2**31))
        )  # NLopt's generator belongs to the thread, and so to this optimizer
        search = nlopt.opt(getattr(nlopt, self.algorithm), self.dimension)
        search.set_lower_bounds(np.zeros(self.dimension))
        search.set_upper_bounds(np.ones(self.dimension))
        search.set_initial_step(np.minimum(self.step, self.widest))
        search.set_xtol_rel(self.tolerance)
        search.set_xtol_abs(np.full(self.dimension, self.tolerance))
        search.set_maxeval(
            self.budget + 1
        )  # one more than is ever asked for, so that running out is not taken for an end
        objective = _Objective(cost, search.force_stop)
        search.set_min_objective(objective)
        try:
            search.optimize(self.start)
        except nlopt.ForcedStop:
            raise objective.error or RuntimeError("NLopt was stopped from outside.") from None
        except nlopt.RoundoffLimited:
            return "Rounding errors hide any further improvement."
        except (
            RuntimeError,
            nlopt.runtime_error,
        ) as error:  # NLopt's word for a line search that finds nothing lower
            return (
                f"{self.algorithm} found nothing better along its last direction "
                f"({error or 'no reason given'})."
            )
        return REASONS.get(search.last_optimize_result(), "NLopt stopped.")


class _Objective:
    """The cost as NLopt calls it.

    Some of its methods go on after an exception, which Python cannot bear, so it is kept back.
    """

    def __init__(
        self, cost: Callable[[Array], tuple[float, Array | None]], force_stop: Callable[[], None]
    ):
        self.cost = cost
        self.force_stop = force_stop
        self.error: BaseException | None = None

    def __call__(self, point: Array, gradient: Any) -> float:
        if self.error is None:
            try:
                value, slope = self.cost(point)
                if gradient.size:
                    gradient[:] = slope
                return value
            except BaseException as error:
                self.error = error
        self.force_stop()
        return 0.0


class Bobyqa(_Nlopt):
    """Quadratic models in a trust region (Powell 2009); fast where the cost is smooth, lost where
    it is not.
    """

    algorithm = "LN_BOBYQA"
    widest = 0.49  # the trust region must fit twice between the bounds


class Sbplx(_Nlopt):
    """Nelder-Mead in subspaces (Rowan 1990, Johnson's version); survives failed points."""

    algorithm = "LN_SBPLX"


class Crs2(_Nlopt):
    """Controlled random search with local mutation (Kaelo and Ali 2006); global, random, ends with
    the budget alone.
    """

    algorithm = "GN_CRS2_LM"
    # NLopt compares successive best points here, which are close by chance long before the end
    tolerance = 0.0


class DirectL(_Nlopt):
    """Dividing rectangles, biased to local search (Gablonsky and Kelley 2001); global, not random,
    ends with the budget alone.
    """

    algorithm = "GN_DIRECT_L"


class Lbfgs(_Nlopt):
    """Low-storage BFGS (Liu and Nocedal 1989, Luksan's version)."""

    algorithm = "LD_LBFGS"
    needs_gradients = True


class Slsqp(_Nlopt):
    """Sequential quadratic programming (Kraft 1994)."""

    algorithm = "LD_SLSQP"
    needs_gradients = True
