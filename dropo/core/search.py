"""Drives an optimizer over an objective: budget, failures, journal, progress."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from dropo.core.checks import Array
from dropo.core.errors import Incompatible
from dropo.core.estimator import Run
from dropo.core.likelihood import LogLikelihood
from dropo.core.optimizer import Optimizer
from dropo.core.parameters import ParameterSpace

Objective = Callable[[Array], float]


@dataclass(frozen=True)
class SearchResult:
    """point: (m,) in the space's own units; value: the objective there; reason: why it stopped, a sentence."""

    point: Array
    value: float
    evaluations: int
    reason: str
    converged: bool


class _Costs:
    """-objective, made finite: a failed point costs more than the worst so far, by the spread seen so far."""

    def __init__(self) -> None:
        self.least, self.most = np.inf, -np.inf

    def finite(self, cost: float) -> float:
        if np.isfinite(cost):
            self.least, self.most = min(self.least, cost), max(self.most, cost)
            return cost
        return 1e12 if self.most < self.least else self.most + 1.0 + (self.most - self.least)


def maximise(objective: LogLikelihood | Objective, space: ParameterSpace, optimizer: Optimizer, run: Run) -> SearchResult:
    """The point of the space's box with the highest objective, by the optimizer, in at most `optimizer.budget` evaluations."""
    gradients = optimizer.needs_gradients
    if gradients and not getattr(objective, "has_gradients", False):
        raise Incompatible(
            f"{type(optimizer).__name__} needs gradients and {type(objective).__name__} gives none."
            " Use an optimizer without gradients, such as 'cma-es' or 'nlopt-sbplx', or a likelihood with them."
        )
    evaluate = _with_gradients(objective, space) if gradients else _values(objective, space)  # type: ignore[arg-type]
    costs, done, best = _Costs(), 0, -np.inf
    try:
        while (reason := optimizer.stop()) is None and done < optimizer.budget:
            points = optimizer.ask()
            answers = run.evaluate(points, evaluate)  # (P,) or (P, 1 + m)
            answers = answers.reshape(len(points), -1)
            told = np.array([costs.finite(-value) for value in answers[:, 0]])
            optimizer.tell(points, told, -answers[:, 1:] if gradients else None)
            done += len(points)
            best = max(best, float(np.nanmax(np.append(answers[:, 0], -np.inf))))
            run.progress(done / optimizer.budget, f"{done} evaluations, best {best:.6g}")
    finally:
        optimizer.close()
    point, cost = optimizer.best
    value = best if np.isfinite(best) else -cost
    sentence = reason or f"The budget of {optimizer.budget} evaluations ran out first: raise it, or go on from this fit."
    return SearchResult(space.from_unit(point), value, done, sentence, converged=reason is not None)


def _values(objective: Objective, space: ParameterSpace) -> Callable[[Array], Array]:
    return lambda points: np.array([objective(space.from_unit(point)) for point in points])


def _with_gradients(objective: LogLikelihood, space: ParameterSpace) -> Callable[[Array], Array]:
    """(P, 1 + m): the value, and its gradient in the unit box."""

    def evaluate(points: Array) -> Array:
        out = []
        for point in points:
            phi = space.from_unit(point)
            slope = np.where(space.is_log, phi * np.log(space.high / np.where(space.is_log, space.low, 1.0)), space.high - space.low)
            out.append(np.concatenate([[objective(phi)], objective.gradient(phi) * slope]))
        return np.array(out)

    return evaluate
