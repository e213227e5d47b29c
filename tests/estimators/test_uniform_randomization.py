"""Uniform randomization: ten bounds in the box, no fit."""

import numpy as np
import pytest

from dropo.core.records.fits.fit import Status
from dropo.core.services.errors import BadArgument
from dropo.estimators.uniform_randomization import UniformRandomization, random_bounds
from dropo.problems.simulated.slide import slide


def test_ten_bounds_inside_the_box():
    """The lower one first, all in the search interval, no two alike."""
    fit = UniformRandomization().fit(slide())
    bounds = fit.search_record.bounds
    assert bounds.shape == (10, 2, 2)
    assert (bounds[:, 0] < bounds[:, 1]).all()
    assert (bounds >= fit.space.low).all()
    assert (bounds <= fit.space.high).all()
    assert len(np.unique(bounds)) == bounds.size
    assert fit.status is Status.DONE
    assert fit.message == "Bounds drawn at random; nothing was fitted."


def test_bounds_are_ordered_pairs_of_uniform_points():
    """Over 10,000 pairs the lower is at 1/3 and the upper at 2/3 of the interval, within 4.5
    standard errors; not at 0.31 and 0.69.
    """
    problem = slide()
    unit = (random_bounds(problem, 10_000, np.random.default_rng(0)) - problem.space.low) / (
        problem.space.high - problem.space.low
    )
    error = np.sqrt(1 / 18 / 10_000)
    away = lambda low: np.abs(unit.mean(axis=0) - np.array([[low], [1 - low]])) / error
    assert (away(1 / 3) < 4.5).all()
    assert (away(0.31) > 4.5).all()


@pytest.mark.parametrize("which", [0, 9])
def test_the_fit_is_one_of_them(which):
    """Uniform on the chosen bounds: draws stay inside and reach their ends."""
    fit = UniformRandomization(which=which).fit(slide(), rng=3)
    low, high = fit.search_record.bounds[which]
    draws = fit.sample(4000, 0)
    assert fit.family == "uniform"
    np.testing.assert_allclose(fit.mean, (low + high) / 2, rtol=1e-12)
    np.testing.assert_allclose(fit.sd, (high - low) / np.sqrt(12), rtol=1e-12)
    assert (draws >= low).all()
    assert (draws <= high).all()
    np.testing.assert_allclose(draws.min(axis=0), low, atol=0.01 * (high - low).max())
    np.testing.assert_allclose(draws.max(axis=0), high, atol=0.01 * (high - low).max())


def test_same_seed_same_bounds():
    """Whichever of them is chosen; another seed draws others."""
    one, same, other = (
        UniformRandomization(which=w).fit(slide(), rng=seed) for w, seed in ((0, 1), (4, 1), (0, 2))
    )
    np.testing.assert_array_equal(one.search_record.bounds, same.search_record.bounds)
    assert (one.search_record.bounds != other.search_record.bounds).all()


def test_refusals():
    with pytest.raises(BadArgument) as refusal:
        UniformRandomization(count=0)
    assert (
        str(refusal.value)
        == "The 'count' of UniformRandomization must be at least 1. Got 0 instead."
    )
    with pytest.raises(BadArgument) as refusal:
        UniformRandomization(which=10)
    assert (
        str(refusal.value) == "The 'which' of UniformRandomization must be 0 to 9. Got 10 instead."
    )
