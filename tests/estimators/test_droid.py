"""DROID: the search's own covariance, around the least squared distance."""

from dataclasses import replace

import numpy as np
import pytest

from dropo.core.records.fits.fit import Status
from dropo.core.services.errors import BadArgument, Incompatible
from dropo.estimators.droid import DROID
from dropo.estimators.least_squares import LeastSquares
from dropo.problems.simulated.slide import slide
from tests.models.interrupted_block import InterruptedBlock


def test_mean_is_that_of_least_squares():
    """With equal weights, to 1e-4; the mean weighted by noise, which is another estimate, is
    farther away.
    """
    fit = DROID(budget=400).fit(slide())
    np.testing.assert_allclose(fit.mean, LeastSquares(weights="equal").fit(slide()).mean, rtol=1e-4)
    assert np.abs(fit.mean - LeastSquares().fit(slide()).mean).max() > 1e-4
    assert fit.family == "full"
    assert fit.search_record.squared_distance == pytest.approx(fit.mse * 2000, rel=1e-9)


def test_its_covariance_is_how_far_the_search_had_converged():
    """Each sd shrinks with the budget by more than three times, from a spread that the data do not
    have to none.
    """
    sd = np.array([DROID(budget=budget).fit(slide()).sd for budget in (60, 120, 240, 480)])
    assert (sd[1:] < sd[:-1] / 3).all(), sd
    assert sd[0].min() > 0.02
    assert sd[-1].max() < 1e-4


def test_same_seed_same_fit():
    one, same, other = (DROID(budget=100).fit(slide(), rng=seed) for seed in (1, 1, 2))
    assert one.mean.tolist() == same.mean.tolist() != other.mean.tolist()
    assert one.correlation.tolist() == same.correlation.tolist()


def test_a_budget_that_runs_out_is_told():
    fit = DROID(budget=100).fit(slide())
    assert fit.status is Status.OUT_OF_BUDGET
    assert (
        fit.message
        == "The budget of 100 evaluations ran out first: raise it, or go on from this fit."
    )


def test_an_interruption_before_the_first_value_leaves_no_fit():
    """Later it leaves the best so far, of finite numbers."""
    simulator = InterruptedBlock(at=1)
    problem = replace(slide(), simulator=simulator)
    with pytest.raises(KeyboardInterrupt):
        DROID(budget=100).fit(problem)
    simulator.at = simulator.calls + 4
    fit = DROID(budget=100).fit(problem)
    assert fit.status is Status.INTERRUPTED
    assert np.isfinite(fit.search_record.squared_distance)


def test_refusals():
    with pytest.raises(BadArgument) as refusal:
        DROID(budget=0)
    assert str(refusal.value) == "The 'budget' of DROID must be at least 1. Got 0 instead."
    with pytest.raises(Incompatible) as refusal:
        DROID(optimizer="nlopt-sbplx").fit(slide())
    expected = (
        "DROID reads its distribution from the optimizer's covariance, and 'nlopt-sbplx' has "
        "none. Use 'cma-es'."
    )
    assert str(refusal.value) == expected
