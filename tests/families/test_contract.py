"""The built-in families: the shipped checks, closed forms, and refusals."""

import numpy as np
import pytest
from scipy import stats

from dropo.core.contracts.family import means_and_scales
from dropo.core.records.parameters import Parameter, ParameterSpace
from dropo.core.services.errors import BadArgument
from dropo.core.services.registry import find
from dropo.families.full_gaussian import FullGaussian
from dropo.families.log_normal import LogNormal
from dropo.families.truncated_gaussian import TruncatedGaussian
from dropo.families.uniform import Uniform
from dropo.testing import check_family

SPACE = ParameterSpace(
    (
        Parameter("mass", 1.0, 3.0, "kg"),
        Parameter("friction", 0.2, 0.8),
        Parameter("length", 0.5, 5.0, "m"),
    )
)


@pytest.mark.parametrize("name", ["truncated_gaussian", "full", "uniform", "log_normal", "mixture"])
def test_every_family_keeps_to_the_contract(name):
    """The built-in families with a spread pass the checks that plug-in authors call."""
    check_family(find("families", name))


@pytest.mark.parametrize(
    ("family", "distribution"),
    [
        (TruncatedGaussian, lambda m, s: stats.truncnorm(-2, 2, loc=m, scale=s)),
        (Uniform, lambda m, s: stats.uniform(m - s, 2 * s)),
        (LogNormal, lambda m, s: stats.lognorm(s, scale=m * np.exp(-(s**2) / 2))),
    ],
)
def test_moments_and_quantiles_are_those_of_the_distribution(family, distribution):
    """Mean, sd and the map of base points agree with scipy's distribution."""
    parameters = tuple(Parameter(p.name, p.low, p.high, lower=-np.inf) for p in SPACE)
    member = family(ParameterSpace(parameters))
    phi = member.phi([1.5, 0.5, 2.0], [0.3, 0.1, 0.7])
    base = np.random.default_rng(0).random((1 + member.redraws, 100, 3))
    same = distribution(np.array([1.5, 0.5, 2.0]), np.array([0.3, 0.1, 0.7]))
    np.testing.assert_allclose(member.mean(phi), same.mean(), rtol=1e-12)
    np.testing.assert_allclose(member.sd(phi), same.std(), rtol=1e-9)
    np.testing.assert_allclose(member.draw(phi, base), same.ppf(base[0]), rtol=1e-9)


def test_truncated_gaussian_has_sd_below_its_scale():
    """sd = 0.8796 sigma, to the four digits of the published remark; no draw is beyond 2 sigma."""
    family = TruncatedGaussian(SPACE)
    phi = family.phi([2.0, 0.5, 3.0], [0.2, 0.05, 0.4])
    np.testing.assert_allclose(family.sd(phi) / family.scale(phi), 0.8796, atol=5e-5)
    draws = family.sample(phi, 5000, np.random.default_rng(0))
    distances = np.abs(draws - family.mean(phi)) / family.scale(phi)
    assert distances.max() <= 2.0
    assert distances.max() > 1.99


def test_thesis_box():
    """Means linear in the search interval, scales logarithmic from 1e-5 to half of it; narrow
    intervals shrink the lower end.
    """
    box = TruncatedGaussian(SPACE).unknowns
    assert box["mean.mass"] == Parameter("mean.mass", 1.0, 3.0, "kg")
    assert box["scale.mass"] == Parameter("scale.mass", 1e-5, 1.0, "kg", scale="log")
    assert box["scale.friction"].low == pytest.approx(0.6e-5)


def test_a_parameter_on_a_log_scale_has_its_mean_there():
    """A mean is searched the way its parameter is."""
    box = means_and_scales(
        ParameterSpace((Parameter("time_constant", 1e-3, 1.0, "s", scale="log"),))
    )
    assert box.from_unit([0.5, 0.5])[0] == pytest.approx(np.sqrt(1e-3))


def test_infeasible_draws_are_made_again_twenty_times_then_held():
    """A draw stays on the bound only if all 21 attempts are infeasible; where one attempt is
    feasible, the first such counts.
    """
    family = TruncatedGaussian(ParameterSpace((Parameter("mass", 1.0, 3.0, lower=1.0),)))
    phi = family.phi([1.0], [0.5])
    base = np.full((21, 3, 1), 0.1)  # below the mean, so below the bound
    base[0, 0] = 0.7
    base[20, 1] = 0.8
    low, middle, last = family.draw(phi, base)[:, 0]
    assert low == family._draw(phi, np.array([[0.7]]))[0, 0]
    assert middle == family._draw(phi, np.array([[0.8]]))[0, 0]
    assert last == 1.0


def test_full_gaussian_draws_whole_rows_again():
    """One infeasible entry makes the whole vector again, so that its correlation survives."""
    family = FullGaussian(
        ParameterSpace((Parameter("a", 1.0, 3.0, lower=1.0), Parameter("b", 1.0, 3.0)))
    )
    phi = family.phi_of([1.2, 2.0], [[0.25, 0.1], [0.1, 0.2]])
    base = np.full((21, 2, 2), 0.6)
    base[0, 0, 0] = 0.01
    redrawn, kept = family.draw(phi, base)
    np.testing.assert_array_equal(redrawn, family._draw(phi, base[1])[0])
    np.testing.assert_array_equal(kept, family._draw(phi, base[0])[1])


def test_full_gaussian_from_moments_and_back():
    """phi_of inverts (mean, sd, correlation), for random covariances of four parameters."""
    family = FullGaussian(ParameterSpace(tuple(Parameter(n, -10.0, 10.0) for n in "abcd")))
    rng = np.random.default_rng(1)
    for _ in range(20):
        root = rng.normal(size=(4, 6))
        covariance = root @ root.T / 6
        mean = rng.uniform(-5, 5, 4)
        phi = family.phi_of(mean, covariance)
        np.testing.assert_allclose(family.mean(phi), mean)
        sd = family.sd(phi)
        found = sd[:, None] * family.correlation(phi) * sd
        np.testing.assert_allclose(found, covariance, rtol=1e-9, atol=1e-12)


def test_canonical_partial_correlations():
    """In three dimensions, partial.b.c is the textbook partial correlation of b and c given a."""
    family = FullGaussian(ParameterSpace(tuple(Parameter(n, -1.0, 1.0) for n in "abc")))
    phi = family.unknowns.vector(
        {
            **dict.fromkeys(family.unknowns.names[:3], 0.0),
            **dict.fromkeys(family.unknowns.names[3:6], 0.1),
            "partial.a.b": 0.6,
            "partial.a.c": -0.3,
            "partial.b.c": 0.5,
        }
    )
    r = family.correlation(phi)
    np.testing.assert_allclose([r[0, 1], r[0, 2]], [0.6, -0.3])
    covariance = r[1, 2] - r[0, 1] * r[0, 2]
    variances = (1 - r[0, 1] ** 2) * (1 - r[0, 2] ** 2)
    assert covariance / np.sqrt(variances) == pytest.approx(0.5)


def test_every_point_of_the_box_is_a_correlation_matrix():
    """Random partial correlations, the extreme ones included, give positive definite matrices with
    ones on the diagonal.
    """
    family = FullGaussian(ParameterSpace(tuple(Parameter(f"p{i}", 0.0, 1.0) for i in range(6))))
    rng = np.random.default_rng(2)
    for unit in (*rng.random((50, len(family.unknowns))), np.ones(len(family.unknowns))):
        r = family.correlation(family.unknowns.from_unit(unit))
        np.testing.assert_allclose(np.diagonal(r), 1.0)
        assert np.linalg.eigvalsh(r).min() > 0


def test_full_gaussian_without_correlation_is_the_diagonal_one():
    """With partial correlations of 0, each entry is mean + scale times its own normal quantile."""
    family = FullGaussian(SPACE)
    phi = family.phi([2.0, 0.5, 3.0], [0.1, 0.02, 0.2])
    base = family.base(16, np.random.default_rng(0))
    np.testing.assert_allclose(
        family.draw(phi, base), stats.norm.ppf(base[0], [2.0, 0.5, 3.0], [0.1, 0.02, 0.2])
    )


def test_refusals():
    """Parameters that can be 0 have no log-normal; a covariance must be positive definite; K must
    be 2 or more.
    """
    with pytest.raises(
        BadArgument,
        match=r"'low' of Parameter 'damping' must be positive for LogNormal. "
        r"Got 0.0 .* another family",
    ):
        LogNormal(ParameterSpace((Parameter("damping", 0.0, 1.0),)))
    with pytest.raises(BadArgument, match=r"covariance.*positive definite"):
        FullGaussian(SPACE).phi_of([2.0, 0.5, 1.0], np.ones((3, 3)))
    with pytest.raises(BadArgument, match=r"'K' of Uniform must be at least 2 draws. Got 1"):
        Uniform(SPACE).base(1, np.random.default_rng(0))
    with pytest.raises(BadArgument, match=r"'phi' of Uniform must be of shape \(6,\)"):
        Uniform(SPACE).draw(np.ones(5), np.full((21, 4, 3), 0.5))
