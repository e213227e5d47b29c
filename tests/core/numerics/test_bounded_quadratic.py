"""The minimum of a convex quadratic function within bounds."""

import numpy as np
from scipy.optimize import lsq_linear

from dropo.core.numerics.bounded_quadratic import bounded_minimum


def test_bounds_hold_and_what_moves_nothing_stays():
    """The free numbers are the least-squares solution beside those at a bound."""
    rng = np.random.default_rng(1)
    columns = rng.normal(size=(50, 4))
    columns[:, 3] = 0.0
    target = columns[:, :3] @ np.array([1.0, -2.0, 3.0]) + 0.1 * rng.normal(size=50)
    lowest = np.array([-np.inf, -1.0, -np.inf, -1.0])
    highest = np.array([np.inf, np.inf, 2.0, 1.0])
    found = bounded_minimum(columns.T @ columns, columns.T @ target, lowest, highest)
    np.testing.assert_array_equal(found[1:], [-1.0, 2.0, 0.0])
    alone = columns[:, 0]
    left = target - columns[:, 1:3] @ found[1:3]
    np.testing.assert_allclose(found[0], alone @ left / (alone @ alone), rtol=1e-8)
    free = bounded_minimum(columns.T @ columns, columns.T @ target, np.full(4, -np.inf))
    expected = np.linalg.lstsq(columns[:, :3], target, rcond=None)[0]
    np.testing.assert_allclose(free[:3], expected, rtol=1e-8)


def test_the_minimum_is_that_of_a_bounded_solver():
    """Of 300 random problems, some of them near singular, with bounds on either side, both or none:
    not above the minimum of a bounded least-squares solver by more than 1e-6; the best without
    bounds, put at them, is above it in more than 50.
    """
    rng = np.random.default_rng(0)
    clipped_too_high = 0
    for _ in range(300):
        k = int(rng.integers(1, 12))
        columns = rng.normal(size=(30, k))
        if k > 2 and rng.random() < 0.3:
            columns[:, 1] = columns[:, 0] + 1e-3 * columns[:, 1]
        columns *= 10.0 ** rng.uniform(-3, 3, k)
        target = rng.normal(size=30)
        size = 1 / np.linalg.norm(columns, axis=0)
        low = np.where(rng.random(k) < 0.6, -rng.uniform(0, 1, k) * size, -np.inf)
        high = np.where(rng.random(k) < 0.6, rng.uniform(0, 1, k) * size, np.inf)
        found = bounded_minimum(columns.T @ columns, columns.T @ target, low, high)
        assert np.all((found >= low) & (found <= high))
        best = lsq_linear(columns * size, target, (low / size, high / size))
        least = 2 * best.cost
        reached = np.sum((target - columns @ found) ** 2)
        assert reached <= least * (1 + 1e-6)
        free = np.linalg.lstsq(columns, target, rcond=None)[0]
        clipped = np.sum((target - columns @ np.clip(free, low, high)) ** 2)
        clipped_too_high += clipped > least * (1 + 1e-6)
    assert clipped_too_high > 50


def test_a_matrix_that_rounding_has_bent_is_no_endless_search():
    """With a direction of negative curvature, as of no sum of squares, it ends in the bounds."""
    rng = np.random.default_rng(4)
    for _ in range(50):
        k = int(rng.integers(3, 10))
        columns = rng.normal(size=(20, k))
        gram = columns.T @ columns
        size, directions = np.linalg.eigh(gram)
        gram = (directions * np.r_[-0.05 * size[-1], size[1:]]) @ directions.T
        moments = columns.T @ rng.normal(size=20)
        low, high = np.full(k, -0.1), np.full(k, 0.2)
        found = bounded_minimum(gram, moments, low, high)
        assert np.all((found >= low) & (found <= high))
