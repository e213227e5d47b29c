"""Fisher scoring within bounds, with Levenberg damping, for local likelihoods."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dropo.core.contracts.likelihood import LocalLogLikelihood
from dropo.core.services.validation import Array

NEXT_TO_NOTHING = 1e-12  # of a variance that no longer matters


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
    good, poor : float
        Fractions of the promised gain: a step that gains more is damped less next time, one that
        gains less is damped more.
    rounding : float
        Fraction of the log-likelihood below which a difference is one of rounding.
    largest_damping : float
        It stops where even a step of more damping gains nothing.
    """

    tolerance: float = 1e-9
    evaluations: int = 100
    largest_factor: float = 50.0
    first_damping: float = 1e-3
    smallest_damping: float = 1e-12
    good: float = 0.75
    poor: float = 0.25
    rounding: float = 1e-10
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

    def vanished(self, theta: Array, shrinking: NDArray[np.bool_]) -> Array:
        """Theta with those variances that shrink as far as they may at their bound, or at next to
        nothing: they are so small that nothing is to be gained any more.
        """
        least = np.maximum(self.low, NEXT_TO_NOTHING * theta)
        return np.where(self.is_scale & shrinking, np.minimum(least, theta), theta)

    def room(self, theta: Array) -> tuple[Array, Array]:
        """How far each coordinate may go in one step, down (m,) and up (m,)."""
        below = self.limit(theta, np.full(len(theta), -np.inf))
        above = self.limit(theta, np.full(len(theta), np.inf))
        return below - theta, above - theta


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
        room = coordinates.room(theta)
        whole = _boxed_step(score, information, room, settings.smallest_damping)
        if _promise(score, information, whole) < settings.tolerance:
            target = coordinates.vanished(theta, whole <= room[0])
            if np.any(target < theta):
                new = evaluate(target)
                evaluations += 1
                if new[0] > value - settings.rounding * abs(value):
                    theta, value, score, information = target, *new
            converged = True
            break
        step = _boxed_step(score, information, room, damping)
        # What a bound stops is on it, whatever rounding makes of the sum.
        target = coordinates.limit(theta, theta + step)
        new = evaluate(target)
        evaluations += 1
        gain = new[0] - value
        promised = _promise(score, information, step)
        if np.isfinite(new[0]) and gain > 0:
            theta, value, score, information = target, *new
            # A step that gains what it promises is damped less next time.
            if gain > settings.good * promised:
                damping = max(damping / 10, settings.smallest_damping)
            elif gain < settings.poor * promised:
                damping *= 3
        elif damping > settings.largest_damping:
            converged = True
            break
        else:
            damping *= 10
    phi = coordinates.to_phi(theta)
    return Maximum(phi, value, score, information, evaluations, converged)


def _boxed_step(
    score: Array, information: Array, room: tuple[Array, Array], damping: float
) -> Array:
    """The Levenberg step (m,) within the room below and above, in units of the information's
    diagonal.

    It goes towards the best step of all unknowns until the first of them is at the edge of its
    room, which stops there, then towards the best one of the others; what would gain by leaving its
    edge again goes on, so that it gains all the way to the best step within the room.
    """
    root = np.sqrt(np.maximum(np.diagonal(information), 1e-300))
    low, high = room[0] * root, room[1] * root
    matrix = information / np.outer(root, root) + damping * np.eye(len(score))
    scaled = score / root
    step = np.zeros(len(score))
    stopped = _pushed_out(scaled, step, low, high)
    for _ in range(4 * len(score)):
        free = np.flatnonzero(~stopped)
        pulled = scaled[free] - matrix[np.ix_(free, stopped)] @ step[stopped]
        move = np.linalg.solve(matrix[np.ix_(free, free)], pulled) - step[free]
        edge = np.where(move > 0, high[free], low[free])
        there = np.abs(edge - step[free]) <= np.abs(move)
        if there.any():
            share = np.ones(len(free))
            share[there] = (edge - step[free])[there] / move[there]
            first = share <= share.min()
            step[free] += share.min() * move
            step[free[first]] = edge[first]
            stopped[free[first]] = True
            continue
        step[free] += move
        left = scaled - matrix @ step
        inward = np.where(stopped & ~_pushed_out(left, step, low, high), np.abs(left), 0.0)
        if inward.max(initial=0.0) <= 1e-12 * np.abs(scaled).max(initial=0.0):
            break
        stopped[inward.argmax()] = False
    return np.asarray(step / root)


def _pushed_out(score: Array, step: Array, low: Array, high: Array) -> NDArray[np.bool_]:
    """Which unknowns are at an edge of their room, and pushed out of it by the score."""
    return ((step <= low) & (score <= 0)) | ((step >= high) & (score >= 0))


def _promise(score: Array, information: Array, step: Array) -> float:
    """The gain of a step (m,) were the log-likelihood quadratic [nats]."""
    return float(score @ step - 0.5 * step @ information @ step)
