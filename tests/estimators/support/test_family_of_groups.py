"""Fits whose groups speak against the family."""

import numpy as np
import pytest

from dropo.core.contracts.problem import Problem
from dropo.estimators.dropo import DROPO
from dropo.estimators.random_effects import RandomEffects
from dropo.simulators.toy import SlidingBlock, simulate

METHODS = [DROPO, RandomEffects]


def pushes(kind, seed):
    """Fifty pushes of blocks that are alike, from two batches, or heavier where damped more."""
    rng = np.random.default_rng([seed, 12])
    z = rng.standard_normal((50, 2))
    if kind == "two batches":
        z[:, 0] = np.where(rng.random(50) < 0.5, -2.0, 2.0) + 0.2 * z[:, 0]
    if kind == "correlated":
        z[:, 1] = 0.95 * z[:, 0] + np.sqrt(1 - 0.95**2) * z[:, 1]
    draws = np.array([1.5, 0.8]) + np.array([0.2, 0.08]) * z * (kind != "alike")
    actions = np.repeat(rng.normal(0, 3, (50, 2, 1)), 5, axis=1)
    data = simulate(SlidingBlock(), draws, actions, np.zeros(2), noise_variance=1e-6, rng=rng)
    return Problem(kind, SlidingBlock(), data, epsilon=1e-6)


@pytest.mark.parametrize("method", METHODS)
def test_what_the_family_lacks_is_a_warning(method):
    """Two batches and a correlation are named; a Gaussian and one block are not."""
    batches = method().fit(pushes("two batches", 0), rng=0).warnings
    assert any("mass falls into two clusters" in text for text in batches)
    correlated = method().fit(pushes("correlated", 0), rng=0).warnings
    assert any("are correlated between groups (+0.9" in text for text in correlated)
    assert not any("groups" in text for text in method().fit(pushes("normal", 0), rng=0).warnings)
    assert not any("groups" in text for text in method().fit(pushes("alike", 0), rng=0).warnings)


@pytest.mark.parametrize("seed", [1, 2])
def test_a_spread_that_rows_do_not_show_is_no_excuse(seed):
    """By rows without correlations, damping seems not to vary at all: its groups say otherwise."""
    fit = DROPO().fit(pushes("correlated", seed), rng=0)
    assert fit.sd[1] < 1e-3
    assert any("are correlated between groups (+0.9" in text for text in fit.warnings)


def test_a_family_with_correlations_is_not_blamed_for_them():
    """The same data, fitted with them: the correlation with its interval, and no warning; an
    interval of independent parameters is nowhere.
    """
    fit = RandomEffects(family="full").fit(pushes("correlated", 0), rng=0)
    assert not any("correlated" in text for text in fit.warnings)
    low, high = fit.correlation_interval()[0, 1]
    assert 0.85 < low < 0.95 < high < 1
    assert 0 < fit.correlation_se[0, 1] < 0.05
    assert 0.9 < fit.correlation[0, 1] < 0.98
