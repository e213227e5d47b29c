"""A run with another payload is named; runs that agree, or all differ, are not."""

import numpy as np
import pytest

from dropo.core.services.errors import BadArgument
from dropo.data.outliers.outlier_runs import compare_runs
from tests.models.pushed_arm import STEP, with_payloads


def test_another_payload_is_named(simulator):
    """Of six runs the one with a heavier link is named, in its inertia and weight, and it alone;
    the control agrees.
    """
    heavy = compare_runs(
        simulator, with_payloads([0.6, 0.6, 0.6, 0.8, 0.6, 0.6]), simulator.nominal, STEP
    )
    assert [one.run for one in heavy.outliers] == [3]
    assert heavy.outliers[0].parameter == "mass"
    assert "run 3 disagrees" in str(heavy)
    assert compare_runs(simulator, with_payloads([0.6] * 6), simulator.nominal, STEP).outliers == ()


def test_runs_that_all_differ_have_no_odd_one(simulator):
    """Masses spread over a third of their mean are a spread, not an odd run."""
    assert (
        compare_runs(
            simulator, with_payloads([0.5, 0.55, 0.6, 0.65, 0.7, 0.62]), simulator.nominal, STEP
        ).outliers
        == ()
    )


def test_each_runs_errors_hold(simulator):
    """Values of 12 equal runs scatter as their standard errors say."""
    runs = compare_runs(simulator, with_payloads([0.6] * 12, seed=1), simulator.nominal, STEP)
    scores = (runs.values - simulator.nominal) / runs.errors
    assert np.abs(scores.mean(axis=0)).max() < 4.5 / np.sqrt(12)
    assert ((scores**2).mean(axis=0) < 1 + 4.5 * np.sqrt(2 / 12)).all()
    assert ((scores**2).mean(axis=0) > 0.2).all()


def test_few_runs_are_refused(simulator):
    """Of three, none can be called odd."""
    with pytest.raises(BadArgument, match="at least 4 runs"):
        compare_runs(simulator, with_payloads([0.6] * 3), simulator.nominal, STEP)
