"""Drives an optimizer over an objective: budget, failures, evaluation log, progress."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from dropo.core.contracts.estimator import Run
from dropo.core.contracts.likelihood import LogLikelihood
from dropo.core.contracts.optimizer import Optimizer
from dropo.core.contracts.simulator import WITHOUT_GRADIENTS
from dropo.core.records.fit import Status
from dropo.core.records.parameters import ParameterSpace
from dropo.core.services.errors import Incompatible
from dropo.core.services.validation import Array, require

Objective = Callable[[Array], Any]


@dataclass(frozen=True)
class SearchResult:
    """point: (m,) in the space's own units; value: the objective there, -inf where every point
    failed; reason: why it stopped.
    """

    point: Array
    value: float
    evaluations: int
    reason: str
    status: Status


class _Costs:
    """-objective, made finite: a failed point costs more than the worst so far, by the spread seen
    so far.
    """

    def __init__(self) -> None:
        self.least = np.inf
        self.most = -np.inf

    def finite(self, cost: float) -> float:
        if np.isfinite(cost):
            self.least, self.most = min(self.least, cost), max(self.most, cost)
            return cost
        return 1e12 if self.most < self.least else self.most + 1.0 + (self.most - self.least)


def maximize(
    objective: LogLikelihood | Objective,
    space: ParameterSpace,
    optimizer: Optimizer,
    run: Run,
    *,
    batched: bool = False,
) -> SearchResult:
    """The point of the space's box with the highest objective, by the optimizer, in at most
    `optimizer.budget` evaluations.

    batched: the objective takes points of the unit box, (P, m) -> (P,), at once.
    """
    gradients = optimizer.needs_gradients
    if gradients and not getattr(objective, "has_gradients", False):
        giver = getattr(objective, "simulator", objective)
        raise Incompatible(
            f"{type(optimizer).__name__} needs gradients, and {type(giver).__name__} gives "
            f"none. {WITHOUT_GRADIENTS}"
        )
    evaluate: Any = (
        objective
        if batched
        else _with_gradients(objective, space)
        if gradients
        else _values(objective, space)
    )  # type: ignore[arg-type]
    costs = _Costs()
    done = 0
    best = -np.inf
    reason = None
    status = Status.CONVERGED
    try:
        while (reason := optimizer.stop()) is None and done < optimizer.budget:
            points = optimizer.ask()
            if done + len(points) > optimizer.budget:
                require(
                    done > 0,
                    "budget",
                    f"at least {len(points)}, the first batch",
                    optimizer.budget,
                    type(optimizer).__name__,
                )
                break
            answers = run.evaluate(points, evaluate)  # (P,) or (P, 1 + m)
            answers = answers.reshape(len(points), -1)
            told = np.array([costs.finite(-value) for value in answers[:, 0]])
            slopes = (
                np.nan_to_num(-answers[:, 1:], nan=0.0, posinf=0.0, neginf=0.0)
                if gradients
                else None
            )  # failed points have none
            optimizer.tell(points, told, slopes)
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
        status = Status.INTERRUPTED
        reason = f"Interrupted after {done} evaluations: this is the best so far."
    finally:
        optimizer.close()
    return SearchResult(space.from_unit(optimizer.best[0]), best, done, reason or "", status)


def _values(objective: Objective, space: ParameterSpace) -> Callable[[Array], Array]:
    return lambda points: np.array([objective(space.from_unit(point)) for point in points])


def _with_gradients(objective: LogLikelihood, space: ParameterSpace) -> Callable[[Array], Array]:
    """(P, 1 + m): the value, and its gradient in the unit box."""

    def evaluate(points: Array) -> Array:
        out = []
        for point in points:
            phi = space.from_unit(point)
            slope = np.where(
                space.is_log,
                phi * np.log(space.high / np.where(space.is_log, space.low, 1.0)),
                space.high - space.low,
            )
            out.append(np.concatenate([[objective(phi)], objective.gradient(phi) * slope]))
        return np.array(out)

    return evaluate
