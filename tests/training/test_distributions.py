"""Draws of a fit hold what is not known of its means."""

from dataclasses import replace

import numpy as np
import pytest

from dropo.training.distributions import Curriculum, Point, full_width, predictive
from dropo.training.environments import randomize
from tests.models.cart_task import cart, fit_of

DRAWS = 4000


@pytest.fixture(scope="module")
def fit():
    """Of the cart: the mean of its mass is known to 0.3 kg, that of the damping has no error."""
    found = fit_of(cart().space, [2.0, 0.5], [0.1, 0.02], epsilon=0.04)
    return replace(found, mean_se=np.array([0.3, np.nan]))


def test_uncertainty_adds_to_the_spread(fit):
    """Variances add, within 4.5 standard errors of so many draws; without it, the fit's alone."""
    for distribution, sd in ((predictive(fit), np.hypot(0.1, 0.3)), (fit, 0.1)):
        drawn = distribution.sample(DRAWS, np.random.default_rng(0))
        assert abs(drawn[:, 0].std() - sd) < 4.5 * sd / np.sqrt(2 * DRAWS)
        assert abs(drawn[:, 1].std() - 0.02) < 4.5 * 0.02 / np.sqrt(2 * DRAWS)
        np.testing.assert_array_less(
            np.abs(drawn.mean(axis=0) - fit.mean), 4.5 * np.array([sd, 0.02]) / np.sqrt(DRAWS)
        )


def test_draws_are_possible(fit):
    """A mass of which little is known is never negative."""
    vague = replace(fit, mean_se=np.array([5.0, 0.0]))
    assert predictive(vague).sample(DRAWS, np.random.default_rng(0)).min() >= 0


def test_environments_have_it_by_default(fit):
    """Draws of a fit's environment spread more than the fit; `uncertainty=False` leaves it out."""
    spread = []
    for options in ({}, {"uncertainty": False}):
        env = fit.randomize(cart(), **options)
        masses = [next(iter(env.reset(seed=i)[1]["parameters"].values())) for i in range(200)]
        spread.append(np.std(masses))
    assert spread[0] > 2 * spread[1]


def test_what_is_no_fit_stays(fit):
    """A point, and a posterior of parameters, which is uncertainty itself; a curriculum knows the
    fit that it grows to.
    """
    point = Point(fit.space, fit.mean)
    assert predictive(point) is point
    assert full_width(Curriculum(predictive(fit), 10)) is fit
    env = randomize(cart(), Curriculum(predictive(fit), 10))
    assert set(env.reset(seed=0)[1]["parameters"]) == set(fit.space.names)
