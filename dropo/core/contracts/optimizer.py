"""The contract of optimizers: ask and tell, in the unit box.

They never call the objective, so budgets and logs stay outside.
"""

import queue
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from dropo.core.services.validation import Array, check_shape, float_array, require


class Optimizer(ABC):
    """Minimises a cost over [0, 1]^m. A plug-in writes `_ask`, `_tell` and `_stop`.

    dimension: m; rng: its own generator; start: (m,), the middle by default; step: (m,) the width
    of the first steps, where the method has one; budget: the evaluations that it may plan with
    (those that stop by themselves need none).
    """

    needs_gradients = False

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
        self.start = float_array(
            "start", np.full(dimension, 0.5) if start is None else start, (dimension,), caller
        )
        require(
            bool((self.start >= 0).all() and (self.start <= 1).all()),
            "start",
            "inside [0, 1]",
            self.start,
            caller,
        )
        self.step = float_array("step", np.broadcast_to(step, (dimension,)), (dimension,), caller)
        require(bool((self.step > 0).all()), "step", "positive", self.step, caller)
        self.best: tuple[Array, float] = (self.start, np.inf)

    def ask(self) -> Array:
        """(P, m) points of the unit box to evaluate next."""
        points = np.atleast_2d(self._ask())
        check_shape("points", points, (None, self.dimension), type(self).__name__)
        return np.clip(points, 0.0, 1.0)

    def tell(self, points: ArrayLike, costs: ArrayLike, gradients: ArrayLike | None = None) -> None:
        """Their costs (P,), finite, and the gradients (P, m) for optimizers that need them."""
        caller = f"{type(self).__name__}.tell"
        points = float_array("points", points, (None, self.dimension), caller)
        costs = float_array("costs", costs, (len(points),), caller)
        require(
            gradients is not None or not self.needs_gradients, "gradients", "given", None, caller
        )
        i = int(costs.argmin())
        if costs[i] < self.best[1]:
            self.best = (points[i], float(costs[i]))
        self._tell(points, costs, None if gradients is None else np.asarray(gradients, dtype=float))

    def stop(self) -> str | None:
        """None while there is more to do, else the reason in a sentence."""
        return self._stop()

    def close(self) -> None:  # noqa: B027, most hold nothing
        """Frees what the optimizer holds; it cannot go on afterwards."""

    @abstractmethod
    def _ask(self) -> Array: ...

    @abstractmethod
    def _tell(self, points: Array, costs: Array, gradients: Array | None) -> None: ...

    @abstractmethod
    def _stop(self) -> str | None: ...


class _Closed(BaseException):
    """Unwinds a minimiser whose optimizer was closed."""


class CallbackOptimizer(Optimizer):
    """Ask and tell around a library that wants to call the objective itself.

    A plug-in writes `_minimise` alone.

    The minimiser runs in a thread of its own and waits, in its objective, for the cost to be told.
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
        self._questions: queue.Queue[Array | str | BaseException] = queue.Queue()
        self._answers: queue.Queue[tuple[float, Array | None] | None] = queue.Queue()
        self._pending: Array | str | BaseException | None = None
        self._thread: threading.Thread | None = None

    @abstractmethod
    def _minimise(self, cost: Callable[[Array], tuple[float, Array | None]]) -> str:
        """Minimises cost(x (m,)) -> (value, gradient (m,) or None) from `self.start`; returns why
        it stopped.
        """

    def _run(self) -> None:
        try:
            self._questions.put(self._minimise(self._cost))
        except _Closed:
            self._questions.put("The optimizer was closed.")
        except BaseException as error:  # handed to the caller of ask or stop
            self._questions.put(error)

    def _cost(self, point: Array) -> tuple[float, Array | None]:
        self._questions.put(np.clip(np.array(point, dtype=float), 0.0, 1.0))
        answer = self._answers.get()
        if answer is None:
            self._answers.put(None)  # for a minimiser that catches the exception and asks again
            raise _Closed
        return answer

    def _next(self) -> Array | str:
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
        require(
            not isinstance(point, str),
            "optimizer",
            "unfinished",
            point,
            f"{type(self).__name__}.ask",
        )
        return np.asarray(point, dtype=float)

    def _tell(self, points: Array, costs: Array, gradients: Array | None) -> None:
        self._pending = None
        self._answers.put((float(costs[0]), None if gradients is None else gradients[0]))

    def _stop(self) -> str | None:
        point = self._next()
        return point if isinstance(point, str) else None

    def close(self) -> None:
        self._answers.put(None)
        if self._thread is not None:
            self._thread.join()
            self._pending = self._pending if isinstance(self._pending, str) else None
