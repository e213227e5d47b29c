"""Priors of single parameters: their densities, slopes and refusals."""

import numpy as np
import pytest
from scipy import stats

from dropo.core.contracts.prior import LogPrior, describe, read_prior
from dropo.core.records.parameters import Parameter, ParameterSpace
from dropo.core.services.errors import BadArgument, UnknownName

SPACE = ParameterSpace((Parameter("a", 1.0, 6.0), Parameter("b", 0.1, 10.0, scale="log")))
POINTS = np.array([[1.5, 0.2], [3.0, 1.0], [5.5, 9.0]])


@pytest.mark.parametrize(
    ("text", "distribution"),
    [
        ("normal(3.5, 0.2)", stats.norm(3.5, 0.2)),
        ("lognormal(1.0, 0.3)", stats.lognorm(0.3, scale=np.e)),
        (" halfnormal( 2 ) ", stats.halfnorm(scale=2)),
        ("uniform(0, 8)", stats.uniform(0, 8)),
        ("uniform", stats.uniform(1, 5)),
        (stats.gamma(4, scale=0.5), stats.gamma(4, scale=0.5)),
    ],
)
def test_texts_are_the_distributions_they_name(text, distribution):
    np.testing.assert_allclose(
        read_prior(text, SPACE["a"]).logpdf(POINTS[:, 0]),
        distribution.logpdf(POINTS[:, 0]),
        rtol=1e-12,
    )


def test_a_density_in_own_units_carries_the_value_on_a_log_scale():
    """The shares of the box' unit coordinate are those of the prior: numbers of (0, 1) weighted by
    the density over the box.
    """
    prior = LogPrior({"b": "normal(2, 0.5)"}, SPACE)
    u = (np.arange(20000) + 0.5) / 20000
    points = SPACE.from_unit(np.column_stack([np.full(20000, 0.5), u]))
    weight = np.exp(prior(points))
    share = weight[points[:, 1] < 1.5].sum() / weight.sum()
    distribution = stats.norm(2, 0.5)
    assert share == pytest.approx(
        (distribution.cdf(1.5) - distribution.cdf(0.1))
        / (distribution.cdf(10) - distribution.cdf(0.1)),
        abs=1e-4,
    )
    wrong = distribution.pdf(points[:, 1])  # without the value
    assert wrong[points[:, 1] < 1.5].sum() / wrong.sum() > share + 0.05


def test_without_a_prior_the_box_is_flat():
    assert LogPrior({}, SPACE)(POINTS).tolist() == [0.0, 0.0, 0.0]
    assert LogPrior({}, SPACE).gradient(POINTS).tolist() == np.zeros((3, 2)).tolist()


def test_gradients_are_those_of_the_densities():
    """A normal's -(x - m) / s^2; for a lognormal on a log scale -(log x - m) / (s^2 x); to 1e-6."""
    prior = LogPrior({"a": "normal(3.5, 0.2)", "b": "lognormal(0.3, 0.5)"}, SPACE)
    exact = np.column_stack(
        [-(POINTS[:, 0] - 3.5) / 0.04, -(np.log(POINTS[:, 1]) - 0.3) / 0.25 / POINTS[:, 1]]
    )
    np.testing.assert_allclose(prior.gradient(POINTS), exact, rtol=1e-6)


def test_gradients_at_the_ends_of_a_support_are_finite():
    """A gamma begins at 0, a uniform ends at 5: from one side there, 0 outside."""
    space = ParameterSpace((Parameter("a", 0.0, 6.0, lower=0.0), Parameter("b", 0.0, 6.0)))
    slopes = LogPrior({"a": stats.expon(scale=2.0), "b": "uniform(1, 5)"}, space).gradient(
        np.array([[0.0, 5.0], [1.0, 6.0]])
    )
    np.testing.assert_allclose(slopes, [[-0.5, 0.0], [-0.5, 0.0]], atol=1e-6)


@pytest.mark.parametrize(
    ("prior", "match"),
    [
        ("normal(1)", r"'law' of prior of 'a' must be normal\(mean, sd\), in numbers"),
        ("normal(1, -2)", "widths above 0"),
        ("normal 1 2", "a name with numbers in brackets"),
        ("normal(one, 2)", r"normal\(mean, sd\), in numbers"),
        (3.5, "a text such as"),
        (stats.poisson(3), "frozen continuous distribution"),
        (stats.norm, "frozen continuous distribution"),
        ("normal(30, 0.2)", r"one with mass in the search interval \[1, 6\]"),
        (stats.uniform(7, 1), "mass in the search interval"),
    ],
)
def test_unusable_priors_are_refused(prior, match):
    with pytest.raises(BadArgument, match=match):
        read_prior(prior, SPACE["a"])


def test_unknown_names_are_corrected():
    with pytest.raises(UnknownName, match=r"No prior called 'norml'\. Did you mean 'normal'"):
        read_prior("norml(1, 2)", SPACE["a"])
    space = ParameterSpace(
        (Parameter("mean.torso_mass", 0.0, 1.0), Parameter("scale.torso_mass", 0.0, 1.0))
    )
    with pytest.raises(
        UnknownName,
        match=r"No unknown with a prior called 'torso_mass'. Did you mean 'mean\.torso_mass'",
    ):
        LogPrior({"torso_mass": "uniform"}, space)


def test_the_same_prior_reads_the_same():
    assert describe("normal(1, 2)") == "normal(1, 2)"
    assert (
        describe(stats.norm(1.0, scale=2.0))
        == describe(stats.norm(1.0, scale=2.0))
        == "norm(1.0, scale=2.0)"
    )
