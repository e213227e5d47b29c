"""The distribution that files draw from is the one that policies are trained under."""

from dataclasses import replace

import numpy as np
import pytest

from dropo.core.services.registry import find, names
from dropo.exports.support.distribution import distribution_of
from dropo.exports.support.subject import subject_of_fit
from dropo.training.distributions import Predictive
from tests.exports.conftest import PARAMETERS, arm_problem, beyond, known_fit

DRAWS = 40_000
BOUND = 4.5
"""Standard errors; one of some 60 differences is beyond them with a probability of 4e-4."""
THREE = PARAMETERS[:3]
MEANS = np.array([1.3, 0.4, 0.15])
ERRORS = np.array([0.05, 0.01, 0.01])
COVARIANCE = np.array([[0.04, 0.012, 0.0], [0.012, 0.01, -0.003], [0.0, -0.003, 0.0025]])
SCALES = {"log_normal": np.array([0.1, 0.2, 0.15])}
POSITIVE = (*PARAMETERS[:2], replace(PARAMETERS[2], low=0.01))


def fit_of(family):
    """The arm and a fit of three of its parameters, correlated where the family can."""
    problem = arm_problem(POSITIVE)
    space = problem.space
    phi = None
    if family == "full":
        phi = find("families", family)(space).phi_of(MEANS, COVARIANCE)
    scales = SCALES.get(family, np.array([0.1, 0.05, 0.02]))
    return problem, known_fit(problem, MEANS, scales, ERRORS, family, phi)


def differences(one, other):
    """Standard errors between the means, standard deviations and mean products of two samples."""
    of = lambda x: (
        np.concatenate([x, x**2, x[:, [0, 0, 1]] * x[:, [1, 2, 2]]], axis=1) if x.ndim == 2 else x
    )
    a, b = of(one - MEANS), of(other - MEANS)
    error = np.sqrt(a.var(axis=0) / len(a) + b.var(axis=0) / len(b))
    return float(np.max(np.abs(a.mean(axis=0) - b.mean(axis=0)) / error))


@pytest.mark.parametrize("family", names("families"))
def test_draws_are_those_of_training(family):
    """First and second moments, for every family; the control lacks what is not known of means."""
    _, fit = fit_of(family)
    distribution, approximated = distribution_of(fit)
    assert bool(approximated) == (family == "mixture")
    theirs = Predictive(fit).sample(DRAWS, np.random.default_rng(0))
    ours = distribution.sample(DRAWS, np.random.default_rng(1))
    assert differences(ours, theirs) < BOUND
    without = replace(distribution, error=np.zeros(3)).sample(DRAWS, np.random.default_rng(1))
    assert differences(without, theirs) > BOUND


@pytest.mark.parametrize("family", names("families"))
def test_moments_that_other_files_hold(family):
    """`Subject.mean` and `sd` are those of the draws; a standard deviation of 5 % more is not."""
    problem, fit = fit_of(family)
    subject = subject_of_fit(fit, problem)
    draws = subject.distribution.sample(DRAWS, np.random.default_rng(2))
    mean = np.array([subject.mean(name) for name in fit.space.names])
    sd = np.array([subject.sd(name) for name in fit.space.names])
    assert beyond(draws, mean, sd) < BOUND
    assert beyond(draws, mean, 1.05 * sd) > BOUND


def test_draws_stay_possible():
    """A parameter near its bound is repeated, whole where it depends on others."""
    _, fit = fit_of("full")
    near = replace(distribution_of(fit)[0], lower=np.array([1.2, 0.05, 0.12]))
    draws = near.sample(2000, np.random.default_rng(3))
    assert np.all(draws >= near.lower)
    assert np.mean(draws == near.lower) < 0.2
    assert near.together
    assert not distribution_of(fit_of("uniform")[1])[0].together


def test_an_unknown_family_is_drawn_by_its_moments(monkeypatch):
    """A family without a standard distribution becomes normal, which is said."""
    _, fit = fit_of("full")
    monkeypatch.setattr(find("families", "full"), "standard", None)
    distribution, approximated = distribution_of(fit)
    assert approximated == ("The family 'full' is drawn as a normal one of the same moments.",)
    draws = replace(distribution, error=np.zeros(3)).sample(DRAWS, np.random.default_rng(4))
    assert np.abs(np.corrcoef(draws.T) - fit.correlation).max() < 0.03
    np.testing.assert_allclose(draws.std(axis=0), fit.sd, rtol=0.03)
