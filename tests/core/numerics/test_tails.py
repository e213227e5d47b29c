"""Tails and quantiles are those of scipy.stats."""

import numpy as np
import pytest
from scipy import stats

from dropo.core.numerics import tails

SHARES = np.array([1e-300, 1e-12, 0.025, 0.5, 0.975, 1 - 1e-12])
NUMBERS = np.array([-40, -1.3, 0, 0.2, 8, np.inf, np.nan])
NORMAL = [
    (tails.normal_tail, stats.norm.sf, NUMBERS),
    (tails.normal_of_tail, stats.norm.isf, SHARES),
]
WITH_DEGREES = [
    (tails.student_tail, stats.t.sf, NUMBERS),
    (tails.student_below, stats.t.cdf, NUMBERS),
    (tails.student_quantile, stats.t.ppf, SHARES),
    (tails.student_log_density, stats.t.logpdf, NUMBERS),
    (tails.chi2_tail, stats.chi2.sf, np.abs(NUMBERS)),
    (tails.chi2_of_tail, stats.chi2.isf, SHARES),
    (tails.chi2_quantile, stats.chi2.ppf, SHARES),
]


@pytest.mark.parametrize(("ours", "theirs", "at"), NORMAL)
def test_normal(ours, theirs, at):
    """To the last bit."""
    np.testing.assert_array_equal(ours(at), theirs(at))


@pytest.mark.parametrize("degrees", [0.5, 1, 7.3, 40])
@pytest.mark.parametrize(("ours", "theirs", "at"), WITH_DEGREES)
def test_with_degrees(ours, theirs, at, degrees):
    """To the last bit, and other degrees of freedom give other numbers."""
    np.testing.assert_array_equal(ours(at, degrees), theirs(at, degrees))
    assert not np.array_equal(ours(at, degrees), ours(at, degrees + 1), equal_nan=True)
