"""The best place by a grid that closes in."""

import numpy as np

from dropo.core.numerics.closing_grid import best_place

PLACE = np.array([0.23, -0.31])
REACH = np.array([0.5, 0.4])


def numbers(places):
    """A unit, moved along one axis, and squared along the other."""
    x, y = places.T
    return np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=1)


def responses(rng, blind=False):
    """(6, 200) to the numbers; of a blind one nothing depends on the second axis."""
    found = rng.standard_normal((6, 200))
    if blind:
        found[[2, 4, 5]] = 0.0
    return found


def test_a_place_between_points_is_found():
    """Of responses without errors: within the last grid's step, the size with it."""
    by_number = responses(np.random.default_rng(0))
    wanted = 2.5 * numbers(PLACE[None])[0] @ by_number
    best = best_place(numbers, by_number @ by_number.T, by_number @ wanted, np.zeros(2), REACH)
    np.testing.assert_allclose(best.place, PLACE, atol=0.005)
    np.testing.assert_allclose(best.size, 2.5, rtol=0.02)
    np.testing.assert_allclose(best.gain, wanted @ wanted, rtol=1e-3)


def test_what_is_not_told_stays_near_the_centre():
    """An axis along which nothing changes."""
    by_number = responses(np.random.default_rng(1), blind=True)
    wanted = 2.5 * numbers(PLACE[None])[0] @ by_number
    centre = np.array([0.0, 0.1])
    best = best_place(numbers, by_number @ by_number.T, by_number @ wanted, centre, REACH)
    np.testing.assert_allclose(best.place, [PLACE[0], 0.1], atol=0.005)


def test_no_size_below_nothing():
    """Where every place asks for a negative size, there is none."""
    rng = np.random.default_rng(2)
    by_number = np.zeros((6, 200))
    by_number[0] = rng.standard_normal(200)
    gram = by_number @ by_number.T
    assert best_place(numbers, gram, -by_number @ by_number[0], np.zeros(2), REACH) is None
