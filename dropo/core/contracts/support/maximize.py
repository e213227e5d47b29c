"""Maximizes an objective by an optimizer: budget, failed points, evaluation log, progress."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np

from dropo.core.contracts.estimator import Run
from dropo.core.contracts.likelihood import LogLikelihood
from dropo.core.contracts.optimizer import Optimizer, points_inside
from dropo.core.contracts.simulator import WITHOUT_GRADIENTS
from dropo.core.records.fits.fit import Status, interrupted
from dropo.core.records.parameters import ParameterSpace
from dropo.core.services.errors import Incompatible
from dropo.core.services.validation import Array, require

Objective = Callable[[Array], Any]
"""A function to maximize, of a point (m,) in the space's own units."""


@runtime_checkable
class Differentiable(Protocol):
    """A function to maximize that may know its gradient, as a `LogLikelihood` does.

    Attributes
    ----------
    has_gradients : bool
        Whether `gradient` may be called.
    """

    has_gradients: bool

    def __call__(self, phi: Array) -> Any:
        """The value at a point (m,)."""

    def gradient(self, phi: Array) -> Array:
        """Give the gradient at a point.

        Parameters
        ----------
        phi : (m,) array
            Where.

        Returns
        -------
        (m,) array
        """


@dataclass(frozen=True)
class SearchResult:
    """The best point of a search, and how the search ended.

    Attributes
    ----------
    point : (m,) array
        In the space's own units.
    value : float
        The objective there; -inf where every point failed.
    evaluations : int
        How many were made.
    reason : str
        Why it stopped, in a sentence.
    status : Status
        How it ended.
    """

    point: Array
    value: float
    evaluations: int
    reason: str
    status: Status


class _FiniteCosts:
    """Makes costs finite: a failed point costs more than the highest so far, by their range."""

    def __init__(self) -> None:
        self.lowest = np.inf
        self.highest = -np.inf

    def __call__(self, cost: float) -> float:
        """The cost itself, or one for a failed point."""
        if np.isfinite(cost):
            self.lowest = min(self.lowest, cost)
            self.highest = max(self.highest, cost)
            return cost
        if self.highest < self.lowest:  # no point has succeeded yet
            return 1e12
        return self.highest + 1.0 + (self.highest - self.lowest)


def maximize(
    objective: LogLikelihood | Objective,
    space: ParameterSpace,
    optimizer: Optimizer,
    run: Run,
    *,
    batched: bool = False,
) -> SearchResult:
    """Find the point of a space's box with the highest objective.

    Parameters
    ----------
    objective : callable
        A point (m,) in the space's own units to a number, not finite where it fails; a
        `LogLikelihood` for optimizers that need gradients.
    space : ParameterSpace
        The box.
    optimizer : Optimizer
        Proposes points, at most `optimizer.budget` of them; it is closed at the end.
    run : Run
        Records and counts the evaluations.
    batched : bool
        Whether the objective takes points of the unit box instead, (P, m) to (P,), at once.

    Returns
    -------
    SearchResult
        The best point so far if the search is interrupted by Ctrl-C.

    Raises
    ------
    Incompatible
        If the optimizer needs gradients and the objective gives none.
    BadArgument
        If the budget is less than the optimizer's first batch.
    KeyboardInterrupt
        If the search is interrupted before a point had a finite value.
    """
    evaluate = _in_unit_box(objective, space, optimizer, batched=batched)
    finite_cost = _FiniteCosts()
    done = 0
    best = -np.inf
    reason = None
    status = Status.CONVERGED
    try:
        while (reason := optimizer.stop()) is None and done < optimizer.budget:
            points = points_inside(optimizer.ask(), optimizer)
            if done + len(points) > optimizer.budget:
                rule = f"at least {len(points)}, the first batch"
                require(done > 0, "budget", rule, optimizer.budget, type(optimizer).__name__)
                break
            answers = run.evaluate(points, evaluate)  # (P,) or (P, 1 + m)
            answers = answers.reshape(len(points), -1)
            costs = np.array([finite_cost(-value) for value in answers[:, 0]])
            gradients = None
            if optimizer.needs_gradients:  # failed points have none
                gradients = np.nan_to_num(-answers[:, 1:], nan=0.0, posinf=0.0, neginf=0.0)
            optimizer.tell(points, costs, gradients)
            done += len(points)
            best = max([best, *answers[np.isfinite(answers[:, 0]), 0].tolist()])
            run.progress(done / optimizer.budget, f"{done} evaluations, best {best:.6g}")
        if reason is None:
            status = Status.OUT_OF_BUDGET
            reason = (
                f"The budget of {optimizer.budget} evaluations ran out first: raise it, or go "
                "on from this fit."
            )
    except KeyboardInterrupt:
        if not np.isfinite(best):
            raise
        status = Status.INTERRUPTED
        reason = interrupted(done)
    finally:
        optimizer.close()
    return SearchResult(space.from_unit(optimizer.best[0]), best, done, reason or "", status)


def _in_unit_box(
    objective: Any,
    space: ParameterSpace,
    optimizer: Optimizer,
    *,
    batched: bool,
) -> Objective:
    """The objective of many points of the unit box, with gradients if the optimizer needs them."""
    knows = isinstance(objective, Differentiable) and objective.has_gradients
    if optimizer.needs_gradients and not knows:
        simulator = objective.simulator if isinstance(objective, LogLikelihood) else None
        giver = objective if simulator is None else simulator
        raise Incompatible(
            f"{type(optimizer).__name__} needs gradients, and {type(giver).__name__} gives "
            f"none. {WITHOUT_GRADIENTS}"
        )
    if batched:
        return objective
    if optimizer.needs_gradients:
        return _with_gradients(objective, space)
    return _values(objective, space)


def _values(objective: Objective, space: ParameterSpace) -> Callable[[Array], Array]:
    """The objective (P,) of points (P, m) of the unit box."""
    return lambda points: np.array([objective(space.from_unit(point)) for point in points])


def _with_gradients(objective: Any, space: ParameterSpace) -> Callable[[Array], Array]:
    """The objective and its gradient in the unit box, (P, 1 + m), of points (P, m) of it."""

    def evaluate(points: Array) -> Array:
        rows = []
        for point in points:
            phi = space.from_unit(point)
            logarithmic = phi * np.log(space.high / np.where(space.is_log, space.low, 1.0))
            slope = np.where(space.is_log, logarithmic, space.high - space.low)
            gradient = objective.gradient(phi) * slope
            rows.append(np.concatenate([[objective(phi)], gradient]))
        return np.array(rows)

    return evaluate
