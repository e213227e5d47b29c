"""Projected Fisher scoring with Levenberg damping, for local likelihoods."""

from dataclasses import dataclass

import numpy as np

from dropo.core.contracts.likelihood import LocalLogLikelihood
from dropo.core.services.validation import Array


@dataclass(frozen=True)
class FisherScoringSettings:
    """How `maximize_locally` steps.

    Attributes
    ----------
    tolerance : float
        It stops where the next step promises less than this gain [nats].
    evaluations : int
        Evaluations at most.
    largest_factor : float
        A variance or another positive unknown changes by at most this factor in one step.
    first_damping : float
        Levenberg damping of the first step, as a fraction of the information's diagonal.
    smallest_damping : float
        Smallest damping, after many steps that gained.
    largest_damping : float
        It stops where even a step of more damping gains nothing.
    """

    tolerance: float = 1e-9
    evaluations: int = 100
    largest_factor: float = 50.0
    first_damping: float = 1e-3
    smallest_damping: float = 1e-12
    largest_damping: float = 1e8


@dataclass(frozen=True)
class Maximum:
    """Where scoring ended.

    Score and information are in the coordinates in which scoring steps: scales as variances,
    positive unknowns on a log scale as logarithms, the rest as they are.

    Attributes
    ----------
    phi : (m,) array
        The point.
    value : float
        Its log-likelihood [nats].
    score : (m,) array
        The gradient of the log-likelihood.
    information : (m, m) array
        The Fisher information.
    evaluations : int
        How many were made.
    converged : bool
        Whether it is a maximum, and not only where the evaluations ran out.
    """

    phi: Array
    value: float
    score: Array
    information: Array
    evaluations: int
    converged: bool


class _Coordinates:
    """The coordinates theta in which scoring steps.

    Scales are variances, whose score at a bound of 0 still means something; positive unknowns on a
    log scale are logarithms; the rest are as they are.
    """

    def __init__(self, objective: LocalLogLikelihood, largest_factor: float):
        space = objective.unknowns
        self.largest_factor = largest_factor
        self.is_scale = np.array([name.startswith("scale.") for name in space.names])
        self.is_log = space.is_log & ~self.is_scale
        self.low = self.from_phi(space.low)
        self.high = self.from_phi(space.high)

    def from_phi(self, phi: Array) -> Array:
        """Coordinates theta (m,) of phi (m,)."""
        logarithm = np.log(np.where(self.is_log, phi, 1.0))
        return np.where(self.is_scale, phi**2, np.where(self.is_log, logarithm, phi))

    def to_phi(self, theta: Array) -> Array:
        """The phi (m,) of coordinates theta (m,)."""
        power = np.exp(np.where(self.is_log, theta, 0.0))
        root = np.sqrt(np.abs(theta))
        return np.where(self.is_scale, root, np.where(self.is_log, power, theta))

    def slope(self, phi: Array) -> Array:
        """The derivatives d phi / d theta (m,)."""
        of_scale = 0.5 / np.maximum(phi, 1e-300)
        return np.where(self.is_scale, of_scale, np.where(self.is_log, phi, 1.0))

    def limit(self, theta: Array, target: Array) -> Array:
        """The target of a step from theta, within the bounds and the largest factor."""
        factor = self.largest_factor
        variances = np.clip(target, theta / factor, theta * factor)
        target = np.where(self.is_scale, variances, target)
        logarithms = np.clip(target, theta - np.log(factor), theta + np.log(factor))
        target = np.where(self.is_log, logarithms, target)
        return np.clip(target, self.low, self.high)


def maximize_locally(
    objective: LocalLogLikelihood,
    start: Array,
    settings: FisherScoringSettings | None = None,
) -> Maximum:
    """Find the maximum of a local likelihood within the bounds of its unknowns.

    It stops where the next step promises too little, or where no damped step gains anything.

    Parameters
    ----------
    objective : LocalLogLikelihood
        Gives values, scores and information.
    start : (m,) array
        The phi to begin at.
    settings : FisherScoringSettings, optional
        How it steps.

    Returns
    -------
    Maximum
    """
    settings = settings or FisherScoringSettings()
    coordinates = _Coordinates(objective, settings.largest_factor)

    def evaluate(theta: Array) -> tuple[float, Array, Array]:
        """Value, score and information in the coordinates theta."""
        phi = coordinates.to_phi(theta)
        value, scores, information = objective.value_score_information(phi)
        slope = coordinates.slope(phi)
        return value, scores.sum(axis=0) * slope, information * np.outer(slope, slope)

    theta = np.clip(coordinates.from_phi(start), coordinates.low, coordinates.high)
    value, score, information = evaluate(theta)
    damping = settings.first_damping
    evaluations = 1
    converged = False
    while evaluations < settings.evaluations:
        # Unknowns at a bound that the score pushes outwards stay where they are.
        held_low = (theta <= coordinates.low) & (score <= 0)
        held_high = (theta >= coordinates.high) & (score >= 0)
        free = ~(held_low | held_high)
        size = np.maximum(np.diagonal(information), 1e-300)
        if not free.any() or _promise(score, information, free, size) < settings.tolerance:
            converged = True
            break
        step = _damped_step(score, information, free, size, damping)
        target = theta.copy()
        target[free] += step
        target = coordinates.limit(theta, target)
        new = evaluate(target)
        evaluations += 1
        # A step that gains is kept, and damped less next time.
        if np.isfinite(new[0]) and new[0] > value:
            theta = target
            value, score, information = new
            damping = max(damping / 10, settings.smallest_damping)
        elif damping > settings.largest_damping:
            converged = True
            break
        else:
            damping *= 10
    phi = coordinates.to_phi(theta)
    return Maximum(phi, value, score, information, evaluations, converged)


def _damped_step(
    score: Array, information: Array, free: np.ndarray, size: Array, damping: float
) -> Array:
    """The Levenberg step of the free unknowns, solved in units of the information's diagonal."""
    matrix = information[np.ix_(free, free)] + damping * np.diag(size[free])
    root = np.sqrt(size[free])
    return np.asarray(np.linalg.solve(matrix / np.outer(root, root), score[free] / root) / root)


def _promise(score: Array, information: Array, free: np.ndarray, size: Array) -> float:
    """The gain that a full step of the free unknowns promises [nats].

    It is half of score' information^-1 score.
    """
    root = np.sqrt(size[free])
    ridge = 1e-12 * np.eye(int(free.sum()))
    scaled = information[np.ix_(free, free)] / np.outer(root, root) + ridge
    return 0.5 * float((score[free] / root) @ np.linalg.solve(scaled, score[free] / root))
