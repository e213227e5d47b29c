"""The contract of optimizers: ask for points of the unit box, and be told their costs.

They never call the objective, so budgets and evaluation logs stay outside (see `maximize`).
"""

import queue
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from dropo.core.services.validation import Array, check_shape, float_array, require

ROUNDING = 1e-9
"""How far outside the box a point may lie."""


class Optimizer(ABC):
    """Minimises a cost over the unit box [0, 1]^m.

    A plug-in writes `_ask`, `_tell` and `_stop`.

    Parameters
    ----------
    dimension : int
        m.
    rng : numpy.random.Generator
        The optimizer's own generator.
    start : (m,) array_like, optional
        Where to begin; the middle of the box by default.
    step : float or (m,) array_like
        Size of the first steps, where the method has one.
    budget : int
        Evaluations that it may plan with; methods that stop by themselves need none.

    Attributes
    ----------
    dimension : int
        m.
    rng : numpy.random.Generator
        For all that is random.
    start : (m,) array
        Where to begin, inside the box.
    step : (m,) array
        Size of the first steps, positive.
    budget : int
        Evaluations that it may plan with.
    needs_gradients : bool
        Whether `tell` must get gradients.
    covariance : (m, m) array or None
        Of the points around the best one, in the unit box; None of a method that has none.
    best : tuple of (m,) array and float
        The point of lowest cost so far, and its cost; the start and infinity before any is told.

    Raises
    ------
    BadArgument
        If the dimension or budget is less than 1, the start is outside the box, or a step is not
        positive.
    """

    needs_gradients = False

    @property
    def covariance(self) -> Array | None:
        """The covariance (m, m) of points around the best one; None of a method without."""
        return None

    def __init__(
        self,
        dimension: int,
        rng: np.random.Generator,
        *,
        start: ArrayLike | None = None,
        step: ArrayLike = 0.25,
        budget: int = 5000,
    ):
        caller = type(self).__name__
        require(dimension >= 1, "dimension", "at least 1", dimension, caller)
        require(budget >= 1, "budget", "at least 1 evaluation", budget, caller)
        self.dimension = dimension
        self.rng = rng
        self.budget = budget
        first = np.full(dimension, 0.5) if start is None else start
        self.start = float_array("start", first, (dimension,), caller)
        inside = bool((self.start >= 0).all() and (self.start <= 1).all())
        require(inside, "start", "inside [0, 1]", self.start, caller)
        self.step = float_array("step", np.broadcast_to(step, (dimension,)), (dimension,), caller)
        require(bool((self.step > 0).all()), "step", "positive", self.step, caller)
        self.best: tuple[Array, float] = (self.start, np.inf)

    def ask(self) -> Array:
        """Ask which points to evaluate next.

        Returns
        -------
        (P, m) array
            Points of the unit box.

        Raises
        ------
        BadArgument
            If the optimizer has stopped, or its points have another dimension or lie outside the
            box by more than rounding.
        """
        return points_inside(self._ask(), self)

    def tell(self, points: ArrayLike, costs: ArrayLike, gradients: ArrayLike | None = None) -> None:
        """Tell the costs of the points that `ask` gave.

        Parameters
        ----------
        points : (P, m) array_like
            The points.
        costs : (P,) array_like
            Their costs, all finite.
        gradients : (P, m) array_like, optional
            d cost / d point, for optimizers that need them.

        Raises
        ------
        BadArgument
            If an array has another shape or is not finite, or gradients are needed and missing.
        """
        caller = f"{type(self).__name__}.tell"
        points = float_array("points", points, (None, self.dimension), caller)
        costs = float_array("costs", costs, (len(points),), caller)
        complete = gradients is not None or not self.needs_gradients
        require(complete, "gradients", "given", None, caller)
        i = int(costs.argmin())
        if costs[i] < self.best[1]:
            self.best = (points[i], float(costs[i]))
        self._tell(points, costs, None if gradients is None else np.asarray(gradients, dtype=float))

    def stop(self) -> str | None:
        """Say why the optimizer has stopped.

        Returns
        -------
        str or None
            The reason in a sentence; None while there is more to do.
        """
        return self._stop()

    def close(self) -> None:  # noqa: B027, most hold nothing
        """Free what the optimizer holds; it cannot go on afterwards."""

    @abstractmethod
    def _ask(self) -> Array:
        """Points (P, m), or one point (m,), of the unit box to evaluate next."""

    @abstractmethod
    def _tell(self, points: Array, costs: Array, gradients: Array | None) -> None:
        """Take the costs (P,) of points (P, m), and gradients (P, m) if they are needed."""

    @abstractmethod
    def _stop(self) -> str | None:
        """The reason to stop in a sentence; None while there is more to do."""


def points_inside(points: ArrayLike, optimizer: Optimizer) -> Array:
    """Check points that an optimizer asks for; its class may have an `ask` of its own.

    Parameters
    ----------
    points : (P, m) or (m,) array_like
        What it asks for.
    optimizer : Optimizer
        Who asks.

    Returns
    -------
    (P, m) array
        The same; those that are outside of the unit box by rounding, on its bound.

    Raises
    ------
    BadArgument
        If the points have another dimension, or lie outside the box by more than rounding.
    """
    caller = type(optimizer).__name__
    asked = np.atleast_2d(np.asarray(points, dtype=float))
    check_shape("points", asked, (None, optimizer.dimension), caller)
    inside = np.clip(asked, 0.0, 1.0)
    outside = ~(np.abs(asked - inside) <= ROUNDING)
    rule = "inside the unit box [0, 1]"
    require(not outside.any(), "points", rule, asked[outside][:3].tolist(), f"{caller}.ask")
    return inside


class _Closed(BaseException):
    """Unwinds a minimiser whose optimizer was closed."""


class CallbackOptimizer(Optimizer):
    """Ask and tell around a library that calls the objective itself.

    A plug-in writes `_minimise` alone. The minimiser runs in a thread of its own; its objective
    waits there until the cost of the point is told.

    Parameters
    ----------
    dimension, rng, start, step, budget
        As of `Optimizer`.
    """

    def __init__(
        self,
        dimension: int,
        rng: np.random.Generator,
        *,
        start: ArrayLike | None = None,
        step: ArrayLike = 0.25,
        budget: int = 5000,
    ):
        super().__init__(dimension, rng, start=start, step=step, budget=budget)
        # What the thread sends: a point to evaluate, the reason why it stopped, or its error.
        self._questions: queue.Queue[Array | str | BaseException] = queue.Queue()
        # What it gets: the cost and gradient of its point, or None to make it stop.
        self._answers: queue.Queue[tuple[float, Array | None] | None] = queue.Queue()
        self._pending: Array | str | BaseException | None = None
        self._thread: threading.Thread | None = None

    @abstractmethod
    def _minimise(self, cost: Callable[[Array], tuple[float, Array | None]]) -> str:
        """Minimise a cost from `self.start`, and return a sentence that says why it stopped.

        The function cost takes x (m,) and gives its value and gradient (m,), or None for that.
        """

    def _run(self) -> None:
        """Run the minimiser, in the thread."""
        try:
            reason = self._minimise(self._cost)
            says_why = isinstance(reason, str) and bool(reason.strip())
            rule = "a sentence that says why it stopped"
            require(says_why, "result", rule, reason, f"{type(self).__name__}._minimise")
            self._questions.put(reason)
        except _Closed:
            self._questions.put("The optimizer was closed.")
        except BaseException as error:  # handed to the caller of ask or stop
            self._questions.put(error)

    def _cost(self, point: Array) -> tuple[float, Array | None]:
        """The cost and gradient of a point (m,), once they are told; called in the thread."""
        self._questions.put(np.array(point, dtype=float))  # `ask` refuses it outside of the box
        answer = self._answers.get()
        if answer is None:
            self._answers.put(None)  # for a minimiser that catches the exception and asks again
            raise _Closed
        return answer

    def _next(self) -> Array | str:
        """The next point (m,), or the reason to stop; the thread starts at the first call."""
        if self._thread is None:
            self._thread = threading.Thread(target=self._run, name=type(self).__name__, daemon=True)
            self._thread.start()
        if self._pending is None:
            self._pending = self._questions.get()
        if isinstance(self._pending, BaseException):
            raise self._pending
        return self._pending

    def _ask(self) -> Array:
        point = self._next()
        caller = f"{type(self).__name__}.ask"
        require(not isinstance(point, str), "optimizer", "unfinished", point, caller)
        return np.asarray(point, dtype=float)

    def _tell(self, points: Array, costs: Array, gradients: Array | None) -> None:
        self._pending = None
        self._answers.put((float(costs[0]), None if gradients is None else gradients[0]))

    def _stop(self) -> str | None:
        point = self._next()
        return point if isinstance(point, str) else None

    def close(self) -> None:
        """End the minimiser and its thread."""
        self._answers.put(None)
        if self._thread is not None:
            self._thread.join()
            if isinstance(self._pending, np.ndarray):
                self._pending = None
