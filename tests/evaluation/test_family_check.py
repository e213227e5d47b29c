"""The shape of a family against that of groups."""

import numpy as np
import pytest
from scipy import stats

from dropo.core.contracts.likelihood import Groups
from dropo.evaluation.family_check import SETTINGS, check_family
from dropo.simulators.toy import SlidingBlock

SPACE = SlidingBlock().space
MEAN = np.array([1.5, 0.8])
SD = np.array([0.2, 0.08])


def drawn(kind, rng, count):
    """Masses and dampings (G, 2) of a population."""
    z = rng.standard_normal((count, 2))
    if kind == "correlated":
        z[:, 1] = 0.95 * z[:, 0] + np.sqrt(1 - 0.95**2) * z[:, 1]
    if kind == "skewed":
        return np.stack([1.0 + 0.3 * np.exp(0.9 * z[:, 0]), MEAN[1] + SD[1] * z[:, 1]], axis=1)
    if kind == "log-normal":
        return np.exp(np.array([0.6, 0.1]) * z)
    if kind == "two clusters":
        z[:, 0] = np.where(rng.random(count) < 0.5, -2, 2) + 0.2 * z[:, 0]
    if kind == "uniform":
        z = rng.uniform(-1.7, 1.7, (count, 2))
    if kind == "outlier":
        z[3, 0] = 9.0
    return MEAN + SD * z


def said(kind, seed, count=50, **settings):
    """What is said of groups that are known to a tenth of the spread, with related errors."""
    rng = np.random.default_rng([seed, count])
    values = drawn(kind, rng, count)
    error = 0.1 * SD * np.array([[1.0, 0.0], [0.7, 0.7]])
    estimates = values + rng.standard_normal((count, 2)) @ error.T
    precision = np.linalg.inv(error @ error.T)
    mean = estimates.mean(axis=0)
    covariance = np.diag(estimates.var(axis=0) - np.diagonal(error @ error.T))
    shrunk = covariance @ np.linalg.inv(covariance + error @ error.T)
    groups = Groups(
        np.arange(count) + 100,
        np.ones(count, dtype=int),
        mean + (estimates - mean) @ shrunk.T,
        np.broadcast_to(precision, (count, 2, 2)),
        (estimates - mean) @ precision,
    )
    return check_family(SPACE, "truncated_gaussian", groups, mean, covariance, rng, **settings)


@pytest.mark.parametrize("count", [12, 50, 150])
def test_gaussian_groups_are_warned_of_at_the_level(count):
    """Over 150 sets no more often than 1 % and three standard errors."""
    share = np.mean([bool(said("normal", seed, count)) for seed in range(150)])
    level = SETTINGS.level
    assert share <= level + 3 * np.sqrt(level * (1 - level) / 150)


@pytest.mark.parametrize(
    ("kind", "text"),
    [
        ("correlated", "mass and damping are correlated between groups (+0.9"),
        ("skewed", "the groups' mass is skewed (+"),
        ("two clusters", "the groups' mass falls into two clusters, "),
        ("outlier", "the groups' mass"),
    ],
)
def test_what_a_gaussian_has_not_is_named(kind, text):
    """In 9 of 10 sets, by one sentence that begins with what is wrong."""
    sentences = [said(kind, seed) for seed in range(20)]
    assert np.mean([any(s.startswith(text) for s in own) for own in sentences]) >= 0.9
    assert np.mean([len(own) for own in sentences]) < 1.2


def test_what_to_do_is_said():
    """Each finding with the family that has it, or that there is none."""
    assert "try --family full" in said("correlated", 0)[0]
    assert "try --method dropo --family log_normal" in said("skewed", 0)[0]
    clusters = said("two clusters", 0)[0]
    assert "groups about 1.1" in clusters
    assert "about 1.9" in clusters
    assert "truncated_gaussian has one peak" in clusters
    assert clusters.endswith("try --method random-effects --family mixture")


def test_families_that_have_it_are_not_blamed():
    """Correlations where the family has such, skewness that logarithms take away, and a uniform
    population, which is no two clusters.
    """
    assert not said("correlated", 0, correlated=True)
    assert said("correlated", 0)
    assert np.mean([not said("log-normal", seed, logarithmic=True) for seed in range(20)]) >= 0.9
    assert np.mean([not said("log-normal", seed) for seed in range(20)]) <= 0.5
    assert np.mean([not said("uniform", seed) for seed in range(20)]) >= 0.9


def test_too_few_groups_say_nothing():
    """Nine groups are not tested, however they lie."""
    assert not said("two clusters", 0, count=9)


def test_the_correlation_is_that_of_the_groups():
    """Within 3 of the standard error printed, over 20 sets."""
    for seed in range(20):
        sentence = said("correlated", seed)[0]
        value, error = (float(x) for x in sentence.split("(")[1].split(")")[0].split(" +- "))
        sample = drawn("correlated", np.random.default_rng([seed, 50]), 50)
        assert abs(value - stats.pearsonr(*sample.T).statistic) < 3 * error + 0.005
