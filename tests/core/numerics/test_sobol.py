"""Scrambled Sobol points are scipy's."""

import numpy as np
import pytest
from scipy.stats import qmc

from dropo.core.numerics.sobol import DIRECTIONS, sobol_points


@pytest.mark.parametrize(("d", "exponent"), [(1, 0), (1, 7), (2, 3), (5, 10), (32, 6), (40, 4)])
def test_the_same_bits_as_scipys(d, exponent):
    """In few and in more coordinates than there are direction numbers, and the same afterwards."""
    ours, theirs = (np.random.default_rng(d) for _ in range(2))
    expected = qmc.Sobol(d, rng=theirs).random_base2(exponent)
    assert sobol_points(d, exponent, ours).tolist() == expected.tolist()
    assert ours.spawn(1)[0].random() == theirs.spawn(1)[0].random()


def test_every_box_of_the_net_holds_one_point():
    """Halves, quarters, ... of two coordinates (a (0, m, 2) net); independent points do not."""
    points = sobol_points(2, 6, np.random.default_rng(3))
    drawn = np.random.default_rng(3).random((64, 2))
    for places, expected in ((points, True), (drawn, False)):
        each = [
            len({(int(x * 2**k), int(y * 2 ** (6 - k))) for x, y in places}) == 64 for k in range(7)
        ]
        assert all(each) == expected
    assert len({polynomial for polynomial, _ in DIRECTIONS}) == len(DIRECTIONS)
