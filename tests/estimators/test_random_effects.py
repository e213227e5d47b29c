"""Random effects: population, groups, and whether they differ."""

import numpy as np
import pytest
from scipy import optimize, stats

from dropo.core.contracts.problem import Problem
from dropo.core.contracts.support.fisher_scoring import maximize_locally
from dropo.core.records.fits.fit import Fit
from dropo.core.services.errors import Incompatible, UnknownName
from dropo.core.services.registry import find
from dropo.estimators.dropo import DROPO
from dropo.estimators.random_effects import RandomEffects
from dropo.evaluation.variance_components import (
    VarianceTestSettings,
    boundary_weights,
    variance_component_tests,
)
from dropo.problems.hopper.data import TRUTH, simulate
from dropo.problems.hopper.problem import hopper_problem
from dropo.simulators.toy import LinearSimulator, SlidingBlock
from dropo.simulators.toy import simulate as toy_trajectories

NOISE = 0.01
ROWS = 6
ONE = LinearSimulator(np.ones((1, 1, 1)))  # o + a xi
TWO = LinearSimulator(np.random.default_rng(1).normal(size=(2, 3, 2)))


def one_way(rng, groups, sd):
    """A balanced one-way layout: y_gt = xi_g + noise, and its y (G, n)."""
    data = toy_trajectories(
        ONE,
        1.0 + sd * rng.standard_normal((groups, 1)),
        np.ones((groups, ROWS, 1)),
        np.zeros(1),
        noise_variance=NOISE,
        rng=rng,
    )
    return Problem("one way", ONE, data, epsilon=NOISE), (
        data.next_observations - data.observations
    ).reshape(groups, ROWS)


def two_way(rng, sd, groups=12, rows=5):
    """Two parameters with these spreads, three signals."""
    draws = np.array([1.0, -2.0]) + np.array(sd) * rng.standard_normal((groups, 2))
    data = toy_trajectories(
        TWO, draws, rng.normal(size=(groups, rows, 2)), np.zeros(3), noise_variance=NOISE, rng=rng
    )
    return Problem("two", TWO, data, epsilon=NOISE)


@pytest.mark.parametrize("epsilon", [None, "learn"])
def test_a_balanced_one_way_layout_has_its_closed_form(epsilon):
    """Mean, variances, log-likelihood, each group's prediction with its error variance, and the
    statistic (1e-4).
    """
    problem, y = one_way(np.random.default_rng(2), 15, 0.1)
    fit = RandomEffects(family="full", epsilon=epsilon).fit(problem, rng=0)
    means = y.mean(axis=1)
    groups = len(y)
    within = NOISE if epsilon is None else np.sum((y - means[:, None]) ** 2) / (groups * (ROWS - 1))
    none = np.mean((y - y.mean()) ** 2) if epsilon == "learn" else NOISE
    total = np.var(means)  # of the groups' means: v + epsilon / n
    variance = total - within / ROWS
    assert fit.mean[0] == pytest.approx(y.mean(), rel=1e-6)
    assert fit.sd[0] ** 2 == pytest.approx(variance, rel=1e-4)
    assert fit.epsilon[0] == pytest.approx(within, rel=1e-4)
    assert fit.mean_se[0] == pytest.approx(np.sqrt(total / groups), rel=0.05)  # with G or G - 1
    stacked = variance + within * np.eye(ROWS)
    assert fit.log_likelihood == pytest.approx(
        stats.multivariate_normal.logpdf(y, np.full(ROWS, y.mean()), stacked).sum(), abs=1e-4
    )
    kept = within / ROWS / total
    np.testing.assert_allclose(
        fit.groups.mean[:, 0], y.mean() + (1 - kept) * (means - y.mean()), rtol=1e-5
    )
    np.testing.assert_allclose(
        fit.groups.covariance[:, 0, 0], variance * kept + kept**2 * total / groups, rtol=1e-4
    )
    assert fit.groups.shrinkage["x0"] == pytest.approx(kept, rel=1e-4)
    alone = stats.norm.logpdf(y, y.mean(), np.sqrt(none)).sum()
    gain = (
        fit.log_likelihood - alone + 0.5 * np.log(ROWS * total / none)
    )  # the means integrated out
    found = fit.groups.tests
    assert found.overall.statistic == pytest.approx(2 * gain, rel=1e-4)
    assert found.overall.p_value == pytest.approx(
        0.5 * stats.chi2.sf(2 * gain, 1), rel=0.06
    )  # the weight is a share of 4000 draws
    assert found.parameters["x0"].p_value == pytest.approx(
        0.5 * stats.chi2.sf(2 * gain, 1), rel=1e-2
    )


def test_unbalanced_groups_with_correlations_agree_with_a_direct_search():
    """For a linear simulator: the maximum of the exact density by scipy, 1e-4 nat and 1e-3 of the
    moments.
    """
    rng = np.random.default_rng(3)
    data = two_way(rng, [0.5, 0.2]).trajectories.rows(np.flatnonzero(rng.random(60) < 0.7))
    problem = Problem("two", TWO, data, epsilon=NOISE)
    fit = RandomEffects(family="full").fit(problem, rng=0)
    predicted, jacobian = TWO.linearize([0.0, 0.0], problem.segments)
    of_row = problem.segments.group
    residuals = problem.segments.targets - predicted
    stacked = [
        (residuals[of_row == g].ravel(), jacobian[of_row == g].reshape(-1, 2))
        for g in np.unique(of_row)
    ]

    def loss(theta):
        factor = np.array([[theta[2], 0.0], [theta[3], theta[4]]])
        densities = [
            stats.multivariate_normal.logpdf(
                y, j @ theta[:2], j @ factor @ factor.T @ j.T + NOISE * np.eye(len(y))
            )
            for y, j in stacked
        ]
        return -sum(densities)

    best = optimize.minimize(loss, [1, -2, 0.5, 0, 0.2], method="BFGS", options={"gtol": 1e-4})
    factor = np.array([[best.x[2], 0.0], [best.x[3], best.x[4]]])
    assert fit.log_likelihood == pytest.approx(-best.fun, abs=1e-4)
    np.testing.assert_allclose(fit.mean, best.x[:2], rtol=1e-3)
    np.testing.assert_allclose(
        fit.correlation * np.outer(fit.sd, fit.sd), factor @ factor.T, rtol=2e-3, atol=1e-4
    )


def test_more_groups_shrink_the_ignorance_and_not_the_spread():
    """From 20 to 320 groups the error of the mean falls to a quarter (30 %); the spread stays
    within 4 of its standard errors.
    """
    few, many = (
        RandomEffects(family="full").fit(one_way(np.random.default_rng(4), n, 0.5)[0], rng=0)
        for n in (20, 320)
    )
    assert few.mean_se[0] / many.mean_se[0] == pytest.approx(4, rel=0.3)
    assert abs(few.sd[0] / many.sd[0] - 1) < 4 / np.sqrt(2 * 20)
    for fit in (few, many):
        assert abs(fit.mean[0] - 1) < 4 * fit.mean_se[0]
        assert fit.groups.predictive_sd["x0"] == pytest.approx(np.hypot(fit.sd[0], fit.mean_se[0]))


def p_values(rng, sd):
    """The p-values of one data set of 30 groups: overall, x0, x1; without the rounds that find the
    region.
    """
    problem = two_way(rng, sd, groups=30, rows=4)
    distribution = find("families", "truncated_gaussian")(TWO.space)
    likelihood = find("likelihoods", "random-effects")(order=1)
    objective = likelihood.linearize_at(
        TWO,
        problem.segments,
        distribution,
        NOISE,
        np.array([1.0, -2.0]),
        np.full(2, 0.15),
        np.random.default_rng(0),
    )
    start = objective.unknowns.from_unit(np.full(len(objective.unknowns), 0.5))
    phi = maximize_locally(
        objective, np.where([n.startswith("scale") for n in objective.unknowns.names], 0.02, start)
    ).phi
    tests = variance_component_tests(
        objective, TWO.space.names, phi, rng.spawn(1)[0], VarianceTestSettings(draws=300)
    )
    return [tests.overall.p_value, *(test.p_value for test in tests.parameters.values())]


def test_a_spread_is_found_where_it_is():
    """In x0 alone, in each of five data sets."""
    rng = np.random.default_rng(6)
    found = np.array([p_values(rng, [0.1, 0.0]) for _ in range(5)])
    assert (found[:, :2] < 0.01).all()
    assert (found[:, 2] > 0.01).all()


@pytest.mark.study
def test_groups_that_do_not_differ_are_found_to_do_so_in_one_of_twenty():
    """Over 80 data sets without spread at most 5 % + 3 standard errors, in every test; with a
    spread it is found in x0 alone.
    """
    rng = np.random.default_rng(5)
    none = np.array([p_values(rng, [0.0, 0.0]) for _ in range(80)])
    error = np.sqrt(0.05 * 0.95 / len(none))
    assert (np.mean(none < 0.05, axis=0) < 0.05 + 3 * error).all()
    assert np.mean(none[:, 0] < 0.05) > 0.005  # it can reject
    some = np.array([p_values(rng, [0.1, 0.0]) for _ in range(20)])
    assert (np.mean(some[:, :2] < 0.05, axis=0) > 0.9).all()
    assert np.mean(some[:, 2] < 0.05) < 0.05 + 3 * np.sqrt(0.05 * 0.95 / 20)


def test_weights_of_the_boundary():
    """Binomial where the information is diagonal; for two variances by the angle between them (4
    standard errors).
    """
    rng = np.random.default_rng(6)
    error = 4 * np.sqrt(0.25 / VarianceTestSettings().draws)
    np.testing.assert_allclose(
        boundary_weights(np.diag([1.0, 4.0, 9.0]), rng), [1 / 8, 3 / 8, 3 / 8, 1 / 8], atol=error
    )
    both = np.arccos(0.8) / (2 * np.pi)
    weights = boundary_weights(np.array([[1.0, 1.6], [1.6, 4.0]]), rng)
    np.testing.assert_allclose(weights, [0.5 - both, 0.5, both], atol=error)
    assert abs(weights[2] - 0.25) > error
    np.testing.assert_array_equal(boundary_weights(np.zeros((2, 2)), rng), [1, 0, 0])


@pytest.mark.parametrize("family", ["truncated_gaussian", "full"])
def test_what_differs_is_said(family, tmp_path):
    """Spread of x0 alone: the table names both uncertainties, the sentence both parameters, and the
    fit comes back from its files.
    """
    fit = RandomEffects(family=family).fit(two_way(np.random.default_rng(7), [0.5, 0.0]), rng=0)
    assert fit.method == "random-effects"
    assert "Recordings differ in x0 (p " in str(fit)
    assert "no difference is found in x1 (p " in str(fit)
    for text in (
        "12 groups of 5 rows",
        "spread to train under",
        "ignorance of the mean",
        "ignorance of a group",
    ):
        assert text in str(fit)
    assert fit.groups.shrinkage["x0"] < 0.1 < 0.5 < fit.groups.shrinkage["x1"]
    fit.save(tmp_path)
    again = Fit.load(tmp_path)
    assert again.to_json() == fit.to_json()
    for name, shape in (("number", (12,)), ("mean", (12, 2)), ("covariance", (12, 2, 2))):
        assert getattr(again.groups, name).shape == shape
        np.testing.assert_array_equal(getattr(again.groups, name), getattr(fit.groups, name))


def test_no_difference_is_said():
    """Without spread: one sentence, all shrunk onto the mean, whose standard error each has."""
    fit = RandomEffects().fit(two_way(np.random.default_rng(1), [0.0, 0.0]), rng=0)
    assert fit.groups.tests.overall.p_value > 0.05
    assert "No difference between recordings is found (p = " in fit.message
    assert np.sqrt(np.einsum("gdd->gd", fit.groups.covariance)).min() > 0.5 * fit.mean_se.min()


def test_noise_of_the_start_states_reaches_the_fit():
    """Of a simulator that adds to the start it doubles the variance: the same fit as with epsilon
    twice as large.
    """
    problem = two_way(np.random.default_rng(7), [0.5, 0.2])
    started, doubled = (
        RandomEffects(**kind).fit(problem, rng=0)
        for kind in ({"start_noise": True}, {"epsilon": 2 * NOISE})
    )
    np.testing.assert_allclose(started.sd, doubled.sd, rtol=1e-5)
    assert started.log_likelihood == pytest.approx(doubled.log_likelihood, abs=1e-4)


def test_too_few_groups():
    """One is refused, for correlations as many as parameters too; else a warning says what so few
    cannot tell.
    """
    rng = np.random.default_rng(8)
    one, two, three = (two_way(rng, [0.5, 0.2], groups=n) for n in (1, 2, 3))
    with pytest.raises(
        Incompatible,
        match=r"one group cannot tell a spread. Use method 'dropo', or name the groups",
    ):
        RandomEffects().fit(one)
    with pytest.raises(
        Incompatible,
        match=r"2 groups cannot tell a covariance of 2 parameters: with fewer than 3 .*"
        " 'truncated_gaussian'",
    ):
        RandomEffects(family="full").fit(two)
    warnings = " ".join(RandomEffects().fit(two).warnings)
    assert (
        "every spread rests on 2 groups: its relative standard error is at least 71 %" in warnings
    )
    assert "2 groups cannot show whether the 2 parameters vary together" in warnings
    assert "cannot show" not in " ".join(RandomEffects(family="full").fit(three).warnings)


@pytest.mark.parametrize(
    ("telling", "text"),
    [(8, "4 of 12 groups tell nothing about x1"), (1, "1 of 12 groups tell anything about x1")],
)
def test_groups_that_say_nothing_of_a_parameter(telling, text):
    """They are named, and their parameter is the population's mean with its spread."""
    simulator = LinearSimulator(
        np.eye(2)[:, :, None] * np.eye(2)[:, None, :]
    )  # action i shows parameter i
    rng = np.random.default_rng(9)
    draws = np.array([1.0, -2.0]) + 0.3 * rng.standard_normal((12, 2))
    actions = rng.normal(size=(12, 5, 2))
    actions[telling:, :, 1] = 0
    data = toy_trajectories(simulator, draws, actions, np.zeros(2), noise_variance=NOISE, rng=rng)
    fit = RandomEffects().fit(Problem("silent", simulator, data, epsilon=NOISE), rng=0)
    assert any(text in warning for warning in fit.warnings)
    np.testing.assert_allclose(fit.groups.mean[telling:, 1], fit.mean[1], rtol=1e-6)
    assert not np.isclose(fit.groups.mean[:telling, 0], fit.mean[0]).any()
    assert (fit.groups.covariance[telling:, 1, 1] >= fit.sd[1] ** 2 * (1 - 1e-9)).all()


def test_other_laws_are_refused():
    """Random effects are Gaussian."""
    with pytest.raises(UnknownName, match=r"No family of random effects called 'log_normal'"):
        RandomEffects(family="log_normal")


def pushes(seed, masses=None, groups=50, simulator=None):
    """Blocks pushed for 20 steps, a draw each, and the draws (G, 2): their masses are 1.05 kg and
    a log-normal, so that a few are twice as heavy as the rest.
    """
    rng = np.random.default_rng([seed, 11])
    z = rng.standard_normal((groups, 2))
    skewed = 1.2 + 0.3 * (np.exp(0.9 * z[:, 0]) - 0.5)
    draws = np.stack([skewed if masses is None else masses, 0.8 + 0.05 * z[:, 1]], axis=1)
    actions = np.repeat(rng.normal(0, 3, (groups, 4, 1)), 5, axis=1)
    data = toy_trajectories(
        SlidingBlock(), draws, actions, np.zeros(2), noise_variance=1e-6, rng=rng
    )
    return Problem("pushes", simulator or SlidingBlock(), data, epsilon=1e-6), draws


def test_groups_far_out_have_their_own_parameters():
    """Masses of a skewed population, some 5 spreads off: every group within 5 of its standard
    deviations (RMS below 1.25), and the population's moments those of the draws.
    """
    problem, draws = pushes(0)
    fit = RandomEffects(family="full").fit(problem, rng=0)
    sd = np.sqrt(np.einsum("gdd->gd", fit.groups.covariance))
    z = (fit.groups.mean - draws) / sd
    assert np.abs(draws[:, 0] - fit.mean[0]).max() > 3 * fit.sd[0]  # it has such groups
    assert np.abs(z).max() < 5
    assert np.sqrt(np.mean(z**2)) < 1.25
    assert fit.mean[0] == pytest.approx(draws[:, 0].mean(), abs=0.01)
    assert fit.sd[0] == pytest.approx(draws[:, 0].std(), rel=0.03)
    assert not any("do not confirm" in warning for warning in fit.warnings)


class FailsAbove(SlidingBlock):
    """A block whose simulation diverges above 2.9 kg."""

    def _replay(self, value, starts, actions):
        out = super()._replay(value, starts, actions)
        return out if value[0] < 2.9 else np.full_like(out, np.nan)


def test_a_group_that_no_simulation_confirms_is_named():
    """The simulation diverges at the mass of one group alone."""
    masses = 1.5 + 0.2 * np.random.default_rng(0).standard_normal(20)
    masses[7] = 3.4
    problem, _ = pushes(1, masses, groups=20, simulator=FailsAbove())
    warnings = " ".join(RandomEffects().fit(problem, rng=0).warnings)
    assert "the parameters of 1 of 20 groups (7) do not confirm them" in warnings


MASSES = {"6.2": np.array([0.5, 0, 0, 0]), "6.3": np.array([0, 0.25, 0.25, 0.25])}


@pytest.mark.study
@pytest.mark.parametrize("table", ["6.2", "6.3"])
def test_masses_that_vary_are_recovered_to_a_gram(table):
    """Tables 6.2 and 6.3, clean: mean and spread within 1 g of the hundred drawn masses', and which
    vary; rows taken as independent draws are 5 g off or more.
    """
    draw = lambda rng, blocks: (
        np.array(list(TRUTH.values())) + MASSES[table] * rng.standard_normal((blocks, 4))
    )
    data, drawn = simulate(500, 2, rng=7, masses=draw, block=10)
    problem = hopper_problem(f"table {table}", data, 1e-8)
    fit = RandomEffects().fit(problem, rng=0)
    varies = MASSES[table] > 0
    np.testing.assert_allclose(fit.mean[varies], drawn.mean(axis=0)[varies], atol=1e-3)
    np.testing.assert_allclose(fit.sd[varies], drawn.std(axis=0)[varies], atol=1e-3)
    assert (fit.sd[~varies] < 1e-3).all()
    p = np.array([test.p_value for test in fit.groups.tests.parameters.values()])
    assert (p[varies] < 1e-6).all()
    assert (p[~varies] > 0.05).all()
    assert np.abs(DROPO().fit(problem, rng=0).mean - drawn.mean(axis=0)).max() > 5e-3
