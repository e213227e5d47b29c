"""Even kernels that smooth a log and differentiate it, and the means of commands under them."""

from functools import lru_cache

import numpy as np
from scipy.ndimage import correlate1d
from scipy.special import erf, log_ndtr, ndtr

from dropo.core.services.validation import Array

REACH = 4.0
"""Half the length of a kernel, in its widths."""
FORGOTTEN = 8.0
"""Time constants after which a lag has forgotten a command: 0.03 % are left."""


def derivative_kernels(width: float, step: float) -> Array:
    """Weights that give a signal's smoothed value and its first two derivatives.

    The three act on neighbouring rows, the oldest first. They are a Gaussian and its derivatives,
    with moments corrected on the grid so that the derivatives of parabolas are exact.

    Parameters
    ----------
    width : float
        Standard deviation of the Gaussian [s].
    step : float
        Of the rows [s].

    Returns
    -------
    (3, 2 h + 1) array
        Weights of the value, of the first derivative [1/s] and of the second [1/s^2].
    """
    half = int(np.ceil(REACH * width / step))
    t = step * np.arange(-half, half + 1)
    value = np.exp(-0.5 * (t / width) ** 2)
    value /= value.sum()
    first = value * t
    first /= first @ t
    second = value * (t**2 - value @ t**2)
    second /= 0.5 * (second @ t**2)
    return np.stack([value, first, second])


@lru_cache(maxsize=256)
def held_kernel(width: float, step: float, delay: float) -> Array:
    """Weights that give the smoothed mean of commands that are held for a step and come late.

    Parameters
    ----------
    width : float
        Standard deviation of the Gaussian [s].
    step : float
        For which each command is held, from its row on [s].
    delay : float
        Until a command arrives [s].

    Returns
    -------
    (2 h + 1,) array
        Weights of the rows around the one at whose time the mean is taken, the oldest first.
    """
    half = int(np.ceil((REACH * width + abs(delay)) / step)) + 1
    t = step * np.arange(-half, half + 1) + delay
    ends = erf(np.stack([t, t + step]) / (np.sqrt(2.0) * width))
    weights = np.asarray(0.5 * (ends[1] - ends[0]))
    weights.flags.writeable = False  # they are kept for the next call
    return weights


@lru_cache(maxsize=256)
def lagging_kernel(width: float, step: float, delay: float, time: float) -> Array:
    """Weights that give the smoothed mean of what follows held commands by a first-order lag.

    Parameters
    ----------
    width, step, delay : float
        As of `held_kernel`.
    time : float
        The time constant, above 0 [s].

    Returns
    -------
    (2 h + 1,) array
        As of `held_kernel`.
    """
    half = int(np.ceil((REACH * width + abs(delay) + FORGOTTEN * time) / step)) + 1
    t = step * np.arange(-half, half + 2) + delay
    # The mean of 1 - exp(-(x - t) / T) over a Gaussian's x beyond t: what a step at t has done.
    past = t / time + 0.5 * (width / time) ** 2 + log_ndtr(-t / width - width / time)
    done = ndtr(-t / width) - np.exp(past)
    weights = np.asarray(done[:-1] - done[1:])
    weights.flags.writeable = False  # they are kept for the next call
    return weights


def apply_kernel(weights: Array, rows: Array) -> Array:
    """Apply weights to neighbouring rows; beyond the ends the last rows are taken to go on.

    Parameters
    ----------
    weights : (2 h + 1,) array
        The weights of the rows around each, the oldest first.
    rows : (n, k) array
        Rows of a uniform grid.

    Returns
    -------
    (n, k) array
    """
    return np.asarray(correlate1d(rows, weights, axis=0, mode="nearest"))
