"""Spread that a few very large errors do not move."""

import numpy as np
import pytest

from dropo.core.numerics.robust_statistics import NORMAL, deviation


@pytest.mark.parametrize("rows", [1, 2, 7, 8])
@pytest.mark.parametrize("missing", [0, 1, 3])
def test_it_is_the_median_of_what_is_there(rows, missing):
    """As NumPy has it of each column alone, whatever is missing; NaN where everything is."""
    errors = np.random.default_rng(rows).standard_normal((rows, 3))
    errors[:missing, 1] = np.nan
    expected = [
        NORMAL * np.median(np.abs(own)) if len(own) else np.nan
        for own in (column[~np.isnan(column)] for column in errors.T)
    ]
    np.testing.assert_allclose(deviation(errors), expected, rtol=1e-15)


def test_without_rows_nothing_is_known():
    """NaN, and no warning."""
    assert np.isnan(deviation(np.zeros((0, 2)))).tolist() == [True, True]
