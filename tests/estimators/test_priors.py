"""Priors of the means in the methods that search for one best point: against closed forms."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from dropo.core.contracts.estimator import Run
from dropo.core.contracts.problem import Problem
from dropo.core.contracts.support.mean_prior import MeanPrior
from dropo.core.records.fits.fit import Fit
from dropo.core.records.parameters import Parameter, ParameterSpace
from dropo.core.services.errors import BadArgument, Incompatible, UnknownName
from dropo.estimators.dropo import DROPO
from dropo.estimators.least_squares import LeastSquares, estimate
from dropo.estimators.random_effects import RandomEffects
from dropo.estimators.support.standard_errors import standard_errors
from dropo.simulators.toy import LinearSimulator, simulate
from tests.models.runs_of_block import along_runs, block

TRUTH = np.array([1.5, -0.7])
NOISE = 0.04
MATRICES = np.array([[[1.0, 0.5], [0.0, 1.0]]])
PRIOR = (1.7, 0.03)
"""Mean and standard deviation of the first parameter's prior, about as wide as its estimate."""
TEXT = f"normal{PRIOR}"


def problem(seed=5, rows=40, truth=TRUTH, **settings):
    """Rows y = a M xi + noise; two parameters, two signals."""
    rng = np.random.default_rng([23_000, seed])
    actions = rng.uniform(0.5, 1.5, (rows, 1, 1))
    values = np.tile(truth, (rows, 1))
    data = simulate(
        LinearSimulator(MATRICES), values, actions, np.zeros(2), noise_variance=NOISE, rng=rng
    )
    return Problem("line", LinearSimulator(MATRICES), data, **settings)


def design_of(one):
    """(R p, d) and the changes (R p,)."""
    data = one.trajectories
    design = np.concatenate([a * MATRICES[0] for a in data.actions[:, 0]])
    return design, (data.next_observations - data.observations).ravel()


def conjugate(one, noise, precision):
    """Mean and covariance under noise variances (p,) and the prior of this precision (d,)."""
    design, change = design_of(one)
    weight = np.tile(1 / np.asarray(noise), len(change) // 2)
    of_data = design.T @ (weight[:, None] * design)
    covariance = np.linalg.inv(of_data + np.diag(precision))
    centre = np.array([PRIOR[0], 0.0])
    mean = covariance @ (design.T @ (weight * change) + precision * centre)
    return mean, covariance, np.linalg.inv(of_data)


KNOWN = np.array([PRIOR[1] ** -2.0, 0.0])
METHODS = {
    "least squares": LeastSquares(),
    "emulated": DROPO(family="point"),
    "linear": DROPO(likelihood="linear", family="point"),
    "unscented": DROPO(likelihood="unscented", family="point"),
    "inner search": DROPO(likelihood="linear", family="point", optimizer="nlopt-sbplx"),
    "sampled": DROPO(likelihood="monte-carlo", family="point", draws=2, optimizer="nlopt-sbplx"),
}


@pytest.mark.parametrize("method", METHODS)
def test_the_estimate_is_the_conjugate_one(method):
    """The mean to a hundredth of its standard deviation, this one as the closed form has it within
    its own error (80 numbers: 4.5 / sqrt(2 * 80)), and the shares of the prior, which the other
    parameter has through the correlation. Without the prior the same numbers are rejected.
    """
    one = problem(epsilon=NOISE)
    with_prior = replace(one, priors={"x0": TEXT})
    fit = METHODS[method].fit(with_prior, rng=0)
    alone = METHODS[method].fit(one, rng=0)
    noise = [NOISE, NOISE]
    if method == "least squares":  # weighs by what it leaves without the prior
        design, change = design_of(one)
        left = change - design @ np.linalg.lstsq(design, change, rcond=None)[0]
        noise = np.mean(left.reshape(-1, 2) ** 2, axis=0)
    mean, covariance, of_data = conjugate(one, noise, KNOWN)
    sd = np.sqrt(np.diagonal(covariance))
    np.testing.assert_allclose(fit.mean, mean, atol=0.01 * sd.min())
    np.testing.assert_allclose(fit.mean_se, sd, rtol=0.35)
    share = 1 - np.diagonal(covariance) / np.diagonal(of_data)
    np.testing.assert_allclose(list(fit.priors.share.values()), share, rtol=0.02)
    assert np.abs((alone.mean - mean) / sd)[0] > 1
    assert alone.mean_se[0] > 1.3 * sd[0]
    assert alone.priors is None
    assert fit.log_likelihood < alone.log_likelihood  # of the data alone


def test_learned_noise_is_found_with_the_prior():
    """The mean that is conjugate under the noise found beside it, to a tenth of its standard error;
    the prior, which is off, leaves more noise.
    """
    one = problem()
    alone = DROPO(family="point").fit(one, rng=0)
    fit = DROPO(family="point").fit(replace(one, priors={"x0": TEXT}), rng=0)
    mean, covariance, _ = conjugate(one, fit.epsilon, KNOWN)
    assert np.abs((fit.mean - mean) / np.sqrt(np.diagonal(covariance))).max() < 0.1
    assert (fit.epsilon >= alone.epsilon).all()
    assert alone.mean[0] < fit.mean[0] < PRIOR[0]


def test_random_effects_weigh_the_population_mean():
    """y_gt = xi_g + noise, balanced: the groups' means have variance v + epsilon / n about the
    population's, whose conjugate mean it is.
    """
    rng = np.random.default_rng(24_000)
    simulator = LinearSimulator(np.ones((1, 1, 1)))
    draws = 1.0 + 0.3 * rng.standard_normal((12, 1))
    actions = np.ones((12, 6, 1))
    data = simulate(simulator, draws, actions, np.zeros(1), noise_variance=0.01, rng=rng)
    one = Problem("one way", simulator, data, epsilon=0.01, priors={"x0": "normal(1.3, 0.1)"})
    fit = RandomEffects().fit(one, rng=0)
    means = (data.next_observations - data.observations).reshape(12, 6).mean(axis=1)
    information = 12 / (fit.sd[0] ** 2 + 0.01 / 6)
    expected = (information * means.mean() + 100 * 1.3) / (information + 100)
    assert fit.mean[0] == pytest.approx(expected, rel=1e-4)
    assert fit.priors.share["x0"] == pytest.approx(100 / (information + 100), rel=1e-3)
    assert RandomEffects().fit(replace(one, priors={}), rng=0).mean[0] == pytest.approx(
        means.mean(), rel=1e-4
    )


def test_whole_runs_have_the_prior_too():
    """Along whole runs: the conjugate mean of what these runs tell without it, to a twentieth of
    its standard deviation; chosen by itself likewise.
    """
    one = block(runs=4, steps=40)
    found = along_runs(one)
    mean, info = found.found.point[:2], found.objective.value_score_information(found.found.point)
    sd = np.sqrt(np.diagonal(np.linalg.inv(info[2][:2, :2])))
    known = np.array([sd[0] ** -2, 0.0])
    prior = {"mass": f"normal({mean[0] + 2 * sd[0]}, {sd[0]})"}
    centre = np.array([mean[0] + 2 * sd[0], 0.0])
    both = info[2][:2, :2] + np.diag(known)
    expected = np.linalg.solve(both, info[2][:2, :2] @ mean + known * centre)
    fit = DROPO().fit(replace(one, priors=prior), rng=0)
    assert fit.likelihood == "trajectory"
    assert np.abs((fit.mean - expected) / sd).max() < 0.05
    assert abs(fit.mean[0] - mean[0]) > 0.5 * sd[0]
    assert fit.priors.share["mass"] == pytest.approx(0.5, abs=0.05)


OF_SQUARES = LeastSquares().fit(problem())


@pytest.mark.parametrize(
    ("text", "law"),
    [
        ("lognormal(0.5, 0.03)", stats.lognorm(0.03, scale=np.exp(0.5))),
        ("halfnormal(0.5)", stats.halfnorm(scale=0.5)),
        (stats.t(3, 1.7, 0.05), stats.t(3, 1.7, 0.05)),
        ("uniform(1.55, 4)", stats.uniform(1.55, 2.45)),
    ],
)
@pytest.mark.parametrize("method", ["least squares", "linear"])
def test_every_prior_finds_the_maximum_of_the_posterior(method, text, law):
    """The maximum of log-likelihood + log prior over a fine grid of the first parameter, all else
    at its best: to 1e-3 of the estimate's standard error.
    """
    one = problem(epsilon=NOISE, priors={"x0": text})
    fit = METHODS[method].fit(one, rng=0)
    noise = fit.epsilon if method == "linear" else OF_SQUARES.epsilon
    mean, covariance, _ = conjugate(one, noise, np.zeros(2))
    sd = np.sqrt(covariance[0, 0])
    grid = mean[0] + np.linspace(-6, 6, 240_001) * sd
    log_posterior = -0.5 * ((grid - mean[0]) / sd) ** 2 + law.logpdf(grid)
    best = grid[np.argmax(log_posterior)]
    assert abs(fit.mean[0] - best) < 1e-3 * sd


def test_a_parameter_without_data_is_its_prior():
    """Where the data tell nothing, mean and error are the prior's, and the whole share; without a
    prior there is no error at all.
    """
    rng = np.random.default_rng(1)
    simulator = LinearSimulator(np.array([[[1.0, 0.0]]]))
    actions = rng.uniform(0.5, 1.5, (30, 1, 1))
    data = simulate(
        simulator, np.tile(TRUTH, (30, 1)), actions, np.zeros(1), noise_variance=NOISE, rng=rng
    )
    one = Problem("half", simulator, data, epsilon=NOISE)
    for method in (LeastSquares(), METHODS["linear"]):
        fit = method.fit(replace(one, priors={"x1": "normal(-0.4, 0.3)"}), rng=0)
        assert fit.mean[1] == pytest.approx(-0.4, abs=1e-4)
        assert fit.mean_se[1] == pytest.approx(0.3, rel=1e-3)
        assert fit.priors.share == {"x0": pytest.approx(0.0, abs=1e-9), "x1": pytest.approx(1.0)}
        assert "100 % of what is known of x1" in str(fit)
        assert np.isnan(method.fit(one, rng=0).mean_se[1])


def test_intervals_cover_truths_drawn_from_the_prior():
    """70 truths from the prior: errors in standard errors have a mean square of 1 within 3 of its
    own standard errors (0.51). Of truths two of the prior's deviations off, the control, they have
    not.
    """
    rng = np.random.default_rng(25_000)
    squares = {}
    for kind, off in (("prior", 0.0), ("off", 2.0)):
        z = []
        for seed in range(70):
            first = PRIOR[0] + PRIOR[1] * (rng.standard_normal() + off)
            one = problem(seed, 40, np.array([first, -0.7]), priors={"x0": TEXT})
            prior = MeanPrior(one.priors, one.space)
            found = estimate(one, Run(one, rng), prior=prior)
            nothing = np.zeros(2)
            errors = standard_errors(
                one, found.value, nothing, np.eye(2), found.weighted_by, prior=prior
            )
            z.append((found.value[0] - first) / errors.mean[0])
        squares[kind] = np.mean(np.square(z))
    assert abs(squares["prior"] - 1) < 0.51, squares
    assert squares["off"] > 1.9


def test_a_prior_that_the_data_contradict_is_named():
    """Tight and wrong: the estimate is the prior's, and a warning says how far the data are; a
    prior that holds the truth is left in peace.
    """
    one = problem(epsilon=NOISE)
    for method in (LeastSquares(), DROPO(likelihood="linear")):
        wrong = method.fit(replace(one, priors={"x0": "normal(1.0, 0.001)"}), rng=0)
        assert wrong.mean[0] == pytest.approx(1.0, abs=0.01)
        assert any(
            "the data contradict the prior normal(1.0, 0.001) of x0" in w for w in wrong.warnings
        )
        right = method.fit(replace(one, priors={"x0": "normal(1.5, 0.001)"}), rng=0)
        assert not any("contradict" in w for w in right.warnings)


def test_what_priors_gave_is_kept(tmp_path):
    """In fit.json and back."""
    fit = LeastSquares().fit(problem(priors={"x0": TEXT, "x1": "uniform"}))
    fit.save(tmp_path)
    again = Fit.load(tmp_path).priors
    assert again.laws == {"x0": TEXT, "x1": "uniform"}
    assert again.share == fit.priors.share
    assert np.isnan(again.apart["x1"])
    assert 0 < again.share["x0"] < 1


def test_slopes_and_curvatures_are_those_of_the_densities():
    """A normal's and a lognormal's, to 1e-5; none of a uniform or where a density is convex; the
    normal of the same slope points back to the prior's own mean.
    """
    space = ParameterSpace(tuple(Parameter(name, 0.1, 9.0) for name in "abc"))
    laws = {"a": "normal(3, 0.2)", "b": "lognormal(0.5, 0.3)", "c": "uniform"}
    prior = MeanPrior(laws, space)
    at = np.array([3.3, 1.2, 2.0])
    z = (np.log(1.2) - 0.5) / 0.3
    np.testing.assert_allclose(
        prior.score(at), [-0.3 / 0.04, -(1 + z / 0.3) / 1.2, 0.0], rtol=1e-5, atol=1e-9
    )
    curved = (1 / 0.09 - 1 - z / 0.3) / 1.44
    np.testing.assert_allclose(prior.information(at), [25.0, curved, 0.0], rtol=1e-4, atol=1e-9)
    np.testing.assert_allclose(prior.as_normal(at)[0][0], 3.0, rtol=1e-5)
    far = MeanPrior({"a": stats.t(3, 1.0, 0.1)}, space)
    assert far.information(np.array([8.0, 1.0, 1.0]))[0] == 0.0


@pytest.mark.parametrize("method", ["least squares", "linear", "sampled"])
def test_means_end_where_a_prior_does(method):
    """A uniform prior bounds the mean, which ends on its bound without an error and is warned of;
    spreads have the bounds that they have without it.
    """
    one = problem(epsilon=NOISE, priors={"x0": "uniform(1.6, 1.7)"})
    fit = METHODS[method].fit(one, rng=0)
    assert fit.mean[0] == pytest.approx(1.6, abs=1e-6)
    assert np.isnan(fit.mean_se[0])
    assert np.isfinite(fit.mean_se[1])
    assert any("mean.x0 ends on its lower bound 1.6" in warning for warning in fit.warnings)
    assert fit.space.low[0] == -10
    varied = problem(truth=np.array([1.5, -0.7]), epsilon=1e-8, priors={"x0": "uniform(1.4, 1.6)"})
    assert DROPO(likelihood="linear").fit(varied, rng=0).sd[0] > 0.15


def test_what_cannot_be_a_prior_is_refused():
    """A parameter that is not there, a law outside the bounds, weights that are no noise."""
    with pytest.raises(UnknownName, match="No parameter called 'x2'"):
        problem(priors={"x2": TEXT})
    with pytest.raises(BadArgument, match=r"mass in the search interval \[-10, 10\]"):
        problem(priors={"x0": "normal(50, 0.1)"})
    with pytest.raises(Incompatible, match="Use weights 'noise'"):
        LeastSquares(weights="equal").fit(problem(priors={"x0": TEXT}))
