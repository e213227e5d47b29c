"""Convex quadratic functions of a few numbers that have bounds."""

import numpy as np

from dropo.core.services.validation import Array

RIDGE = 1e-10
"""Added to the diagonal of the scaled matrix: numbers that act alike share what they explain."""

EXCHANGES = 300
"""At most, of one or more numbers; beyond it rounding decides where they are."""

PATIENCE = 3
"""Exchanges in a row that bring no number nearer to its place, before one is made at a time."""


def bounded_minimum(
    gram: Array, moments: Array, lowest: Array, highest: Array | None = None
) -> Array:
    """Minimize x' gram x - 2 moments' x with bounds, by block principal pivoting.

    Numbers beyond a bound are put at it, and those that a bound holds back no more are freed, all
    at once; where that goes in circles, one at a time, which ends.

    Parameters
    ----------
    gram : (k, k) array
        Positive semidefinite.
    moments, lowest : (k,) arrays
        The linear term, and the lower bounds; -inf where there is none.
    highest : (k,) array, optional
        The upper bounds; inf where there is none.

    Returns
    -------
    (k,) array
        What moves nothing is 0, or the bound nearest to it.

    References
    ----------
    Judice and Pires, A block principal pivoting algorithm for large-scale strictly monotone linear
    complementarity problems, Computers & Operations Research 21 (1994), 587.
    """
    if highest is None:
        highest = np.full(len(moments), np.inf)
    sizes = np.diag(gram)
    found = np.clip(np.zeros(len(moments)), lowest, highest)
    moving = np.flatnonzero(sizes > max(1e-30 * float(sizes.max(initial=0.0)), 1e-300))
    scale = np.sqrt(sizes[moving])
    matrix = gram[moving[:, None], moving] / np.outer(scale, scale)
    matrix.flat[:: len(moving) + 1] += RIDGE
    aim = moments[moving] / scale
    low = lowest[moving] * scale
    high = highest[moving] * scale
    rounding = 1e-12 * float(np.abs(aim).max(initial=0.0))

    side = np.zeros(len(moving))  # -1 at the lower bound, 1 at the upper, 0 between
    fewest = len(moving) + 1
    patience = PATIENCE
    free = side == 0
    value = np.linalg.solve(matrix, aim)
    for _ in range(EXCHANGES):
        slope = matrix @ value - aim
        below = value < low - rounding
        above = value > high + rounding
        wrong = np.where(free, below | above, side * slope > rounding)
        if not wrong.any():
            break
        count = int(wrong.sum())
        patience = PATIENCE if count < fewest else patience - 1
        fewest = min(count, fewest)
        if patience < 0:
            wrong[: np.flatnonzero(wrong)[-1]] = False
        there = above.astype(float) - below.astype(float)
        side = np.where(wrong, np.where(free, there, 0.0), side)
        free = side == 0
        value = np.where(side < 0, low, high)
        value[free] = 0.0
        value[free] = np.linalg.solve(matrix[free][:, free], (aim - matrix @ value)[free])
    else:
        value = _by_interior_points(matrix, aim, low, high)
    found[moving] = np.clip(value / scale, lowest[moving], highest[moving])
    return found


def _by_interior_points(matrix: Array, aim: Array, low: Array, high: Array) -> Array:
    """The same of a matrix (k, k) in which rounding leaves no order of exchanges."""
    from scipy.optimize import lsq_linear  # slow to import

    size, directions = np.linalg.eigh(matrix)
    root = np.sqrt(np.maximum(size, RIDGE))
    rows = root[:, None] * directions.T
    # A number without room still needs an interval.
    high = np.maximum(high, low + 1e-12 * np.maximum(1.0, np.abs(low)))
    return np.asarray(lsq_linear(rows, (aim @ directions) / root, (low, high)).x)
