"""Damped Gauss-Newton descents of a misfit from several points at once."""

from dataclasses import dataclass

import numpy as np

from dropo.core.services.validation import Array
from dropo.estimators.support.first_mean.misfit import Misfit, Slopes


@dataclass(frozen=True)
class DescentSettings:
    """How descents step.

    Attributes
    ----------
    rounds : int
        A descent has so many steps at most, failed ones included.
    longest : float
        Longest step in a coordinate, as a fraction of the unit box.
    tolerance : float
        A descent ends where a step gains less than this [nats].
    hopeless : float
        A descent ends where even this damping, in units of the curvature, gains nothing.
    first_damping : float
        Damping of the first step, in units of the curvature.
    more : float
        The damping is multiplied by this factor behind a step that failed.
    less : float
        The damping is multiplied by this factor behind a step that gained.
    """

    rounds: int = 15
    longest: float = 0.3
    tolerance: float = 0.1
    hopeless: float = 1e4
    first_damping: float = 1e-2
    more: float = 10.0
    less: float = 0.2


SETTINGS = DescentSettings()


def descend(
    misfit: Misfit, start: Array, settings: DescentSettings = SETTINGS
) -> tuple[Array, Array]:
    """Find the minimum of a misfit below each of several points of the unit box.

    All descents step together, so that each round is one batch of simulations.

    Parameters
    ----------
    misfit : Misfit
    start : (K, d) array
        In the unit box.
    settings : DescentSettings

    Returns
    -------
    points : (K, d) array
        Where they ended.
    values : (K,) array
        The misfit there [nats].

    References
    ----------
    Levenberg, Quarterly of Applied Mathematics 2 (1944), 164.
    """
    points = np.clip(start, 0.0, 1.0)
    slopes = misfit.slopes(points)
    damping = np.full(len(points), settings.first_damping)
    active = np.ones(len(points), dtype=bool)
    for _ in range(settings.rounds):
        moving = np.flatnonzero(active)
        if not len(moving):
            break
        target = np.array([_step(slopes, points, damping[k], k, settings) for k in moving.tolist()])
        tried = misfit.slopes(target)
        gain = slopes.value[moving] - tried.value
        better = gain > 0
        accepted = moving[better]
        points[accepted] = target[better]
        for old, new in (
            (slopes.value, tried.value),
            (slopes.gradient, tried.gradient),
            (slopes.curvature, tried.curvature),
        ):
            old[accepted] = new[better]
        damping[moving] *= np.where(better, settings.less, settings.more)
        settled = better & (gain < settings.tolerance)
        active[moving] = ~settled & (damping[moving] < settings.hopeless)
    return points, slopes.value


def _step(
    slopes: Slopes, points: Array, damping: float, k: int, settings: DescentSettings
) -> Array:
    """(d,) the point behind a damped step from point k, held in the box."""
    point = points[k]
    gradient = slopes.gradient[k]
    # Coordinates on a bound stay there where the descent leads out of the box.
    free = ~(((point <= 0) & (gradient > 0)) | ((point >= 1) & (gradient < 0)))
    target = point.copy()
    if not free.any():
        return target
    curvature = slopes.curvature[k][np.ix_(free, free)]
    size = np.maximum(np.diagonal(curvature), 1e-300)
    matrix = curvature + damping * np.diag(size) + 1e-12 * size.max() * np.eye(len(size))
    step = -np.linalg.lstsq(matrix, gradient[free], rcond=None)[0]
    step *= min(1.0, settings.longest / max(float(np.abs(step).max()), 1e-300))
    target[free] = np.clip(point[free] + step, 0.0, 1.0)
    return target
