"""Fitting some of theta to windows: robust Gauss-Newton, with the noise learned in between."""

import numpy as np

from dropo.core.checks import Array
from dropo.core.data import Ints
from dropo.diagnosis.model import Library, Look, look, moved, noise_of

LENGTHS = np.array([1.0, 0.5, 0.2, 0.05, 0.01])  # shares of a step that are tried at once
SETTLED = 0.1  # [nats] below which a round of steps gains nothing more
NONE = np.zeros(0, dtype=np.int64)
SCAN = np.array([0.05, 0.15, 0.3, 0.5, 0.7, 0.85, 1.15, 1.4, 1.8, 2.5, 4.0])  # multiples of a size where steps cannot be trusted


def refit(library: Library, seen: Look, free: np.ndarray, floor: Array, *, rounds: int = 2, rough: Ints = NONE, renew: bool = True) -> Look:
    """The windows of a look at the theta that they are most likely under in the free numbers, and under the noise that fits it.

    rough: which numbers a line scan looks for first, since predictions are not smooth in them. renew: find the start noise's
    way anew in each round; else it stays as it is in `seen`, which a comparison of candidates can do with.
    """
    for _ in range(rounds):
        before = float(seen.log_likelihood.sum())
        for number in rough:
            seen = _scan(library, seen, int(number))
        seen = _steps(library, seen, free)
        sigma = noise_of(seen, seen.whiten.sigma, floor)
        seen = look(library, seen.windows, seen.theta, sigma) if renew else moved(library, seen, seen.theta, sigma)
        if abs(float(seen.log_likelihood.sum()) - before) < SETTLED:
            break
    return seen


def _steps(library: Library, seen: Look, free: np.ndarray, most: int = 4) -> Look:
    """Gauss-Newton steps with the noise as it is, each as long as gains most of the lengths tried; in bounds."""
    space = library.simulator.space
    for _ in range(most if len(free) else 0):
        slopes, target = seen.flat(library.slopes(seen.theta, free, seen.windows)), seen.flat(seen.residuals)
        scale = np.maximum(np.linalg.norm(slopes, axis=1), 1e-300)
        step = np.linalg.lstsq((slopes / scale[:, None]).T, target, rcond=1e-6)[0] / scale
        tried = np.repeat(seen.theta[None], len(LENGTHS), axis=0)
        tried[:, free] = np.clip(seen.theta[free] + LENGTHS[:, None] * step, space.low[free], space.high[free])
        seen, gain = _best(library, seen, tried)
        if gain < SETTLED:
            break
    return seen


def _scan(library: Library, seen: Look, number: int) -> Look:
    """One number of theta at multiples of its size."""
    space = library.simulator.space
    tried = np.repeat(seen.theta[None], len(SCAN), axis=0)
    tried[:, number] = np.clip(SCAN * seen.theta[number], space.low[number], space.high[number])
    return _best(library, seen, tried)[0]


def _best(library: Library, seen: Look, tried: Array) -> tuple[Look, float]:
    """The best of several thetas (K, m) where it is better than the present one, and the nats gained; the noise stays."""
    predictions = library.predict(tried, seen.windows)
    values = seen.of(predictions).sum(axis=1)
    k = int(np.nanargmax(np.where(np.isfinite(values), values, -np.inf)))
    gain = float(values[k] - seen.log_likelihood.sum())
    if not gain > 0:
        return seen, 0.0
    residuals = seen.windows.measured - predictions[k] - seen.shift
    bad = seen.lost | ~np.isfinite(residuals).all(axis=1)
    residuals[bad] = seen.residuals[bad]
    return Look(seen.windows, tried[k], residuals, seen.shift, seen.whiten, seen.lost), gain
