"""A run with another payload is named; runs that agree, or all differ, are not."""

from types import SimpleNamespace

import numpy as np
import pytest

from dropo.core.services.errors import BadArgument
from dropo.data.outliers import outlier_runs
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


def test_no_variance_is_negative(simulator, monkeypatch):
    """Where information is so singular that its inverse is not even symmetric, errors are numbers;
    the control is the product with that inverse twice, whose variances are negative.
    """
    turned = np.array([[0.0, 1.0], [-1.0, 0.0]])
    scores = np.random.default_rng(0).normal(size=(40, 2))
    fit = SimpleNamespace(
        value=simulator.nominal, scores=scores, inverse=turned, information=np.eye(2)
    )
    monkeypatch.setattr(outlier_runs, "robust_fit", lambda *given, **settings: fit)
    found = outlier_runs.fit_run(simulator, with_payloads([0.6]), simulator.nominal, 10)
    assert (np.diagonal(turned @ scores.T @ scores @ turned) < 0).all()
    assert (np.diagonal(found.covariance) > 0).all()


def test_few_runs_are_refused(simulator):
    """Of three, none can be called odd."""
    with pytest.raises(BadArgument, match="at least 4 runs"):
        compare_runs(simulator, with_payloads([0.6] * 3), simulator.nominal, STEP)
