"""The posterior against the conjugate one, which a linear simulator has in closed form."""

import json

import numpy as np
import pytest

from dropo.core.catalogue import find
from dropo.core.errors import BadArgument, UnknownName
from dropo.core.fit import Fit, Status
from dropo.core.journal import Journal
from dropo.core.problem import Problem
from dropo.core.sampler import Draws
from dropo.estimators.dropo import DROPO
from dropo.estimators.posterior import PointLikelihood, Posterior, judge
from dropo.optimizers.emcee import Emcee
from dropo.problems.slide import slide
from dropo.simulators.toy import LinearSimulator, simulate

TRUTH, NOISE = np.array([1.5, -0.7]), 0.04
MATRICES = np.array([[[1.0, 0.5], [0.0, 1.0]]])  # M(a) = a [[1, 0.5], [0, 1]]


def problem(rows=30, **settings):
    rng = np.random.default_rng(5)
    simulator = LinearSimulator(MATRICES)
    actions = rng.uniform(0.5, 1.5, (rows, 1, 1))
    data = simulate(simulator, np.tile(TRUTH, (rows, 1)), actions, np.zeros(2), noise_variance=NOISE, rng=rng)
    return Problem("line", simulator, data, **settings)


def conjugate(problem):
    """Mean and covariance of the posterior under a flat prior: (H' H / epsilon)^-1 and least squares."""
    design = np.concatenate([a * MATRICES[0] for a in problem.trajectories.actions[:, 0]])  # (R p, d)
    change = (problem.trajectories.next_observations - problem.trajectories.observations).ravel()
    covariance = np.linalg.inv(design.T @ design) * NOISE
    return covariance @ design.T @ change / NOISE, covariance


def z_of_means(fit, mean, covariance):
    size = np.array([fit.details["posterior"]["effective_sample_size"][name] for name in ("x0", "x1")])
    return np.abs(fit.mean - mean) / np.sqrt(np.diagonal(covariance) / size)


def test_posterior_of_the_parameters_is_the_conjugate_one():
    """Mean within 4.5 standard errors, standard deviations and correlation within 5 %; a mean half a sd away must fail."""
    one = problem(epsilon=NOISE)
    mean, covariance = conjugate(one)
    fit = Posterior().fit(one, rng=1)
    sd = np.sqrt(np.diagonal(covariance))
    assert (z_of_means(fit, mean, covariance) < 4.5).all()
    assert (z_of_means(fit, mean + 0.5 * sd, covariance) > 4.5).all()
    assert fit.sd == pytest.approx(sd, rel=0.05)
    assert fit.mean_se == pytest.approx(sd, rel=0.05)
    assert fit.correlation[0, 1] == pytest.approx(covariance[0, 1] / sd.prod(), abs=0.05)
    assert fit.status is Status.CONVERGED
    assert fit.warnings == ()


def test_a_learned_epsilon_is_the_noise():
    """Without a given epsilon it is found with the rest: 30 rows tell a signal's variance to sqrt(2 / 30) = 26 %."""
    fit = Posterior(sampler=Emcee(steps=1000, burn_in=500)).fit(problem(), rng=1)
    assert fit.epsilon == pytest.approx([NOISE, NOISE], rel=4.5 * np.sqrt(2 / 30))
    assert fit.arrays["chain"].shape == (1000, 32, 3)


def test_log_density_by_hand():
    """One row, two signals: the sum of two normal log densities."""
    one = problem(rows=1)
    target = PointLikelihood(one, np.array([0.1, 0.4]))
    error = target.targets[0] - one.trajectories.actions[0, 0] * MATRICES[0] @ [1.0, 0.0]
    by_hand = -0.5 * sum(e**2 / v + np.log(2 * np.pi * v) for e, v in zip(error, [0.1, 0.4], strict=True))
    assert target.many(np.array([[1.0, 0.0]]))[0] == pytest.approx(by_hand, rel=1e-12)


def test_posterior_of_the_distribution_covers_it():
    """Parameters drawn from N(TRUTH, 0.3^2) in every row: the means lie within 4.5 posterior sds, and the scales about 0.3."""
    rng, simulator, rows = np.random.default_rng(8), LinearSimulator(MATRICES, low=-4.0, high=4.0), 40
    values = TRUTH + 0.3 * rng.standard_normal((rows, 2))
    data = simulate(simulator, values, np.ones((rows, 1, 1)), np.zeros(2), noise_variance=1e-3, rng=rng)
    one = Problem("spread", simulator, data, epsilon=1e-3)
    likelihood = find("likelihoods", "monte-carlo")(draws=40)
    fit = Posterior(over="distribution", likelihood=likelihood, sampler=Emcee(steps=60, burn_in=140, walkers=16)).fit(one, rng=2)
    assert (np.abs(fit.mean - TRUTH) < 4.5 * fit.mean_se).all()
    assert (fit.mean_se < 0.15).all()
    assert fit.scale == pytest.approx([0.3, 0.3], rel=0.5)
    assert (fit.scale_se > 0).all()
    assert fit.family == "truncated_gaussian"


def test_too_few_steps_are_told():
    fit = Posterior(sampler=Emcee(steps=30, burn_in=0)).fit(problem(epsilon=NOISE), rng=1)
    assert fit.status is Status.OUT_OF_BUDGET
    told = " ".join(fit.warnings)
    assert "30 steps are fewer than 50 autocorrelation times" in told
    assert "split R-hat is above 1.01 (x0" in told
    assert "effective sample size is below 400" in told


def test_independent_draws_raise_no_objection():
    rng = np.random.default_rng(1)
    notes, numbers = judge(Draws(rng.standard_normal((1000, 8, 1)), np.zeros((1000, 8)), ("x",)))
    assert notes == []
    assert numbers["split_r_hat"]["x"] == pytest.approx(1, abs=0.01)


def test_same_seed_same_draws_and_a_killed_run_resumes(tmp_path):
    settings = Posterior(sampler=Emcee(steps=60, burn_in=20))
    whole = settings.fit(problem(epsilon=NOISE), rng=3)
    assert np.array_equal(whole.arrays["chain"], settings.fit(problem(epsilon=NOISE), rng=3).arrays["chain"])

    class Killed(RuntimeError):
        pass

    def kill(share, text):
        if "points" in text and share > 0.5:
            raise Killed

    with pytest.raises(Killed):
        settings.fit(problem(epsilon=NOISE), rng=3, journal=Journal(tmp_path / "journal"), progress=kill)
    journal = Journal(tmp_path / "journal")
    assert journal.replayed > 40
    resumed = settings.fit(problem(epsilon=NOISE), rng=3, journal=journal)
    assert np.array_equal(resumed.arrays["chain"], whole.arrays["chain"])
    assert resumed.simulator_steps == whole.simulator_steps


def test_fit_is_saved_whole_and_drawn_from(tmp_path):
    fit = Posterior(sampler=Emcee(steps=60, burn_in=20)).fit(problem(epsilon=NOISE), rng=3)
    fit.save(tmp_path)
    back = Fit.load(tmp_path)
    assert np.array_equal(back.arrays["chain"], fit.arrays["chain"])
    assert json.loads((tmp_path / "fit.json").read_text())["posterior"]["split_r_hat"].keys() == {"x0", "x1"}
    sample = fit.sample(20000, 1)
    assert np.abs(sample.mean(axis=0) - fit.mean).max() < 4.5 * fit.sd.max() / np.sqrt(20000)


def test_a_posterior_narrower_than_a_search_keeps_its_width():
    """With noise of variance 1e-16 the posterior is narrower than the least scale of a search, 1e-5; it is not widened."""
    rng, simulator = np.random.default_rng(5), LinearSimulator(MATRICES)
    data = simulate(simulator, TRUTH[None], np.ones((1, 30, 1)), np.zeros(2), noise_variance=1e-16, rng=rng)
    fit = Posterior(sampler=Emcee(steps=500, burn_in=300)).fit(Problem("sharp", simulator, data, epsilon=1e-16), rng=1)
    assert (fit.sd < 1e-8).all()
    assert (np.abs(fit.mean - TRUTH) < 5 * fit.sd).all()


def test_unusable_settings_are_refused():
    with pytest.raises(UnknownName, match="No posterior over called 'params'"):
        Posterior(over="params")
    with pytest.raises(BadArgument, match="'epsilon' of Posterior must be positive"):
        Posterior(epsilon=0.0).fit(problem())


def test_posterior_on_a_local_likelihood_is_around_its_maximum():
    """Random effects on `slide`: the posterior's mean and its errors are those of DROPO's fit, the errors within a third."""
    problem = slide()
    fit = Posterior(over="distribution", likelihood="random-effects", sampler=Emcee(walkers=16, steps=400, burn_in=100)).fit(problem)
    best = DROPO(likelihood="random-effects").fit(problem)
    assert (np.abs(fit.mean - best.mean) < 0.5 * best.mean_se).all()
    np.testing.assert_allclose(fit.mean_se, best.mean_se, rtol=1 / 3)
