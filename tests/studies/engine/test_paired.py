"""Paired tests and profiles against values by hand, and their level by simulation."""

import numpy as np
import pytest

from dropo.studies.engine.paired import (
    critical_difference,
    data_profile,
    expected_running_time,
    mean_ranks,
    paired_p_value,
    performance_profile,
    smallest_p_value,
)


def test_signed_ranks() -> None:
    """Five pairs that all go one way reach the smallest p-value; none is 1, nothing is NaN."""
    first = np.arange(5.0)
    assert paired_p_value(first, 2 * first + 1) == pytest.approx(2 / 2**5)
    assert smallest_p_value(5) == 2 / 2**5
    assert paired_p_value(first, first) == 1.0
    assert paired_p_value([1.0, np.nan], [1.0, 2.0]) == 1.0
    assert np.isnan(paired_p_value([np.nan], [1.0]))


def test_critical_difference() -> None:
    """Demsar 2006, table 5: q is 2.569 for four classifiers; section 3.2.2: 1.25 on 14 sets."""
    assert critical_difference(4, 14) == pytest.approx(2.569 * np.sqrt(4 * 5 / (6 * 14)), abs=1e-3)
    assert mean_ranks([[1.0, 2.0, 2.0], [3.0, 1.0, np.inf]]).tolist() == [1.5, 1.75, 2.75]


def test_profiles() -> None:
    """Two sets, two variants: the first solves one at cost 10, the second both, at 20 and 5."""
    costs = [[10.0, 20.0], [np.inf, 5.0]]
    factors, shares = performance_profile(costs)
    assert factors.tolist() == [1.0, 2.0]
    assert shares.tolist() == [[0.5, 0.5], [0.5, 1.0]]
    gradients, shares = data_profile(costs, [5.0, 5.0])
    assert gradients.tolist() == [0.0, 1.0, 2.0, 4.0]
    assert shares.tolist() == [[0.0, 0.0], [0.0, 0.5], [0.5, 0.5], [0.5, 1.0]]
    unsolved = performance_profile([[np.inf, np.inf]])
    assert unsolved[1].tolist() == [[0.0, 0.0]]


def test_expected_running_time() -> None:
    """All cost over successes: (10 + 30) / 1 and infinite."""
    times = expected_running_time([[10.0, 1.0], [30.0, 1.0]], [[True, False], [False, False]])
    assert times.tolist() == [40.0, np.inf]
