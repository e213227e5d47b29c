"""Projected Fisher scoring with Levenberg damping, for local likelihoods that know their
information.
"""

from dataclasses import dataclass

import numpy as np

from dropo.core.contracts.local_likelihood import LocalLogLikelihood
from dropo.core.services.validation import Array

REACH = 50.0  # a variance or another positive unknown moves by at most this factor in one step


@dataclass(frozen=True)
class Maximum:
    """phi (m,) with its value; score, information: in the coordinates of `_Coordinates`;
    evaluations made.
    """

    phi: Array
    value: float
    score: Array
    information: Array
    evaluations: int
    converged: bool


class _Coordinates:
    """phi in which scoring moves: scales as variances, whose score at a bound of 0 still means
    something; positive unknowns on a log scale in logarithms; the rest as they are.
    """

    def __init__(self, objective: LocalLogLikelihood):
        space = objective.unknowns
        self.square = np.array([name.startswith("scale.") for name in space.names])
        self.log = space.is_log & ~self.square
        self.low, self.high = self.of(space.low), self.of(space.high)

    def of(self, phi: Array) -> Array:
        return np.where(
            self.square, phi**2, np.where(self.log, np.log(np.where(self.log, phi, 1.0)), phi)
        )

    def phi(self, theta: Array) -> Array:
        return np.where(
            self.square,
            np.sqrt(np.abs(theta)),
            np.where(self.log, np.exp(np.where(self.log, theta, 0.0)), theta),
        )

    def slope(self, phi: Array) -> Array:
        """D phi / d theta (m,)."""
        return np.where(self.square, 0.5 / np.maximum(phi, 1e-300), np.where(self.log, phi, 1.0))

    def limit(self, theta: Array, target: Array) -> Array:
        """A step's target within the bounds and within reach."""
        target = np.where(self.square, np.clip(target, theta / REACH, theta * REACH), target)
        target = np.where(
            self.log, np.clip(target, theta - np.log(REACH), theta + np.log(REACH)), target
        )
        return np.clip(target, self.low, self.high)


def maximize_locally(
    objective: LocalLogLikelihood, start: Array, *, tolerance: float = 1e-9, rounds: int = 100
) -> Maximum:
    """The maximum within the bounds of `objective.unknowns`, from phi `start` (m,).

    Stops where the next step promises less than `tolerance` of a nat, or no damped step gains
    anything.
    """
    at = _Coordinates(objective)

    def value_score_information(theta: Array) -> tuple[float, Array, Array]:
        phi = at.phi(theta)
        value, scores, information = objective.value_score_information(phi)
        slope = at.slope(phi)
        return value, scores.sum(axis=0) * slope, information * np.outer(slope, slope)

    theta = np.clip(at.of(start), at.low, at.high)
    value, score, information = value_score_information(theta)
    damping = 1e-3
    evaluations = 1
    while evaluations < rounds:
        free = ~(((theta <= at.low) & (score <= 0)) | ((theta >= at.high) & (score >= 0)))
        size = np.maximum(np.diagonal(information), 1e-300)
        if not free.any() or _promise(score, information, free, size) < tolerance:
            return Maximum(at.phi(theta), value, score, information, evaluations, True)
        matrix = information[np.ix_(free, free)] + damping * np.diag(size[free])
        target = theta.copy()
        target[free] += np.linalg.solve(
            matrix / np.outer(np.sqrt(size[free]), np.sqrt(size[free])),
            score[free] / np.sqrt(size[free]),
        ) / np.sqrt(size[free])
        moved = at.limit(theta, target)
        new = value_score_information(moved)
        evaluations += 1
        if np.isfinite(new[0]) and new[0] > value:
            theta, (value, score, information), damping = moved, new, max(damping / 10, 1e-12)
        elif damping > 1e8:
            return Maximum(at.phi(theta), value, score, information, evaluations, True)
        else:
            damping *= 10
    return Maximum(at.phi(theta), value, score, information, evaluations, False)


def _promise(score: Array, information: Array, free: np.ndarray, size: Array) -> float:
    """Half of score' information^-1 score over the free unknowns: the gain that a full step
    promises [nats].
    """
    root = np.sqrt(size[free])
    scaled = information[np.ix_(free, free)] / np.outer(root, root) + 1e-12 * np.eye(
        int(free.sum())
    )
    return 0.5 * float((score[free] / root) @ np.linalg.solve(scaled, score[free] / root))
