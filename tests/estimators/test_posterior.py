"""The posterior against the conjugate one, which a linear simulator has in closed form."""

import json

import numpy as np
import pytest

from dropo.core.contracts.noise import Noise
from dropo.core.contracts.problem import Problem
from dropo.core.records.draws import Draws
from dropo.core.records.fits.fit import Fit, Status
from dropo.core.services.errors import BadArgument, Incompatible, UnknownName
from dropo.core.services.files.evaluation_log import EvaluationLog
from dropo.core.services.registry import find
from dropo.estimators.dropo import DROPO
from dropo.estimators.posterior import PointLikelihood, Posterior, evaluate_draws
from dropo.optimizers.samplers.emcee import Emcee
from dropo.optimizers.samplers.pyro_nuts import PyroNuts
from dropo.optimizers.samplers.pyro_svi import PyroSvi
from dropo.simulators.toy import LinearSimulator, simulate
from tests.reference.pushes import pushes

TRUTH = np.array([1.5, -0.7])
NOISE = 0.04
MATRICES = np.array([[[1.0, 0.5], [0.0, 1.0]]])  # M(a) = a [[1, 0.5], [0, 1]]


def problem(rows=30, **settings):
    rng = np.random.default_rng(5)
    simulator = LinearSimulator(MATRICES)
    actions = rng.uniform(0.5, 1.5, (rows, 1, 1))
    data = simulate(
        simulator, np.tile(TRUTH, (rows, 1)), actions, np.zeros(2), noise_variance=NOISE, rng=rng
    )
    return Problem("line", simulator, data, **settings)


def conjugate(problem, prior_mean=0.0, prior_precision=0.0):
    """Mean and covariance of the posterior: (H' H / epsilon + P)^-1 and least squares; P the
    precision of the first parameter's prior.
    """
    design = np.concatenate(
        [a * MATRICES[0] for a in problem.trajectories.actions[:, 0]]
    )  # (R p, d)
    change = (problem.trajectories.next_observations - problem.trajectories.observations).ravel()
    known = np.diag([prior_precision, 0.0])
    covariance = np.linalg.inv(design.T @ design / NOISE + known)
    return covariance @ (design.T @ change / NOISE + known @ [prior_mean, 0.0]), covariance


def z_of_means(fit, mean, covariance):
    size = np.array(
        [fit.posterior.diagnostics.effective_sample_size[name] for name in ("x0", "x1")]
    )
    return np.abs(fit.mean - mean) / np.sqrt(np.diagonal(covariance) / size)


def test_posterior_of_the_parameters_is_the_conjugate_one():
    """Mean within 4.5 standard errors, standard deviations and correlation within 5 %; a mean half
    a sd away must fail.
    """
    one = problem(epsilon=NOISE)
    mean, covariance = conjugate(one)
    fit = Posterior(sampler=Emcee(steps=1500, burn_in=500)).fit(one, rng=1)
    sd = np.sqrt(np.diagonal(covariance))
    assert (z_of_means(fit, mean, covariance) < 4.5).all()
    assert (z_of_means(fit, mean + 0.5 * sd, covariance) > 4.5).all()
    assert fit.sd == pytest.approx(sd, rel=0.05)
    assert fit.mean_se == pytest.approx(sd, rel=0.05)
    assert fit.correlation[0, 1] == pytest.approx(covariance[0, 1] / sd.prod(), abs=0.05)
    assert fit.status is Status.CONVERGED
    assert fit.warnings == ()


def test_a_learned_epsilon_is_the_noise():
    """Without a given epsilon it is found with the rest: 30 rows tell a signal's variance to sqrt(2
    / 30) = 26 %.
    """
    fit = Posterior(sampler=Emcee(steps=300, burn_in=200)).fit(problem(), rng=1)
    assert fit.epsilon == pytest.approx([NOISE, NOISE], rel=4.5 * np.sqrt(2 / 30))
    assert fit.posterior.chain.shape == (300, 32, 3)


def test_log_density_by_hand():
    """One row, two signals: the sum of two normal log densities."""
    one = problem(rows=1)
    target = PointLikelihood(one, np.array([0.1, 0.4]))
    error = target.targets[0] - one.trajectories.actions[0, 0] * MATRICES[0] @ [1.0, 0.0]
    by_hand = -0.5 * sum(
        e**2 / v + np.log(2 * np.pi * v) for e, v in zip(error, [0.1, 0.4], strict=True)
    )
    assert target.many(np.array([[1.0, 0.0]]))[0] == pytest.approx(by_hand, rel=1e-12)


def test_posterior_of_the_distribution_covers_it():
    """Parameters drawn from N(TRUTH, 0.3^2) in every row: the means lie within 4.5 posterior sds,
    and the scales about 0.3.
    """
    rng = np.random.default_rng(8)
    simulator = LinearSimulator(MATRICES, low=-4.0, high=4.0)
    rows = 30
    values = TRUTH + 0.3 * rng.standard_normal((rows, 2))
    data = simulate(
        simulator, values, np.ones((rows, 1, 1)), np.zeros(2), noise_variance=1e-3, rng=rng
    )
    one = Problem("spread", simulator, data, epsilon=1e-3)
    likelihood = find("likelihoods", "monte-carlo")(draws=24)
    fit = Posterior(
        over="distribution", likelihood=likelihood, sampler=Emcee(steps=60, burn_in=90, walkers=16)
    ).fit(one, rng=2)
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
    notes, numbers = evaluate_draws(
        Draws(rng.standard_normal((1000, 8, 1)), np.zeros((1000, 8)), ("x",))
    )
    assert notes == []
    assert numbers.split_r_hat["x"] == pytest.approx(1, abs=0.01)


def test_same_seed_same_draws_and_a_killed_run_resumes(tmp_path):
    settings = Posterior(sampler=Emcee(steps=60, burn_in=20))
    whole = settings.fit(problem(epsilon=NOISE), rng=3)
    assert np.array_equal(
        whole.posterior.chain, settings.fit(problem(epsilon=NOISE), rng=3).posterior.chain
    )

    class Killed(RuntimeError):
        pass

    def kill(share, text):
        if "points" in text and share > 0.5:
            raise Killed

    with pytest.raises(Killed):
        settings.fit(
            problem(epsilon=NOISE),
            rng=3,
            evaluation_log=EvaluationLog(tmp_path / "journal"),
            progress=kill,
        )
    evaluation_log = EvaluationLog(tmp_path / "journal")
    assert evaluation_log.replayed > 40
    resumed = settings.fit(problem(epsilon=NOISE), rng=3, evaluation_log=evaluation_log)
    assert np.array_equal(resumed.posterior.chain, whole.posterior.chain)
    assert resumed.simulator_steps == whole.simulator_steps


def test_interrupted_draws_are_kept(tmp_path, capsys):
    """Status, message and fewer draws, and no traceback; the same run then goes on to the whole
    chain. Too few steps are no result.
    """
    settings = Posterior(sampler=Emcee(steps=30, burn_in=10))
    whole = settings.fit(problem(epsilon=NOISE), rng=3)

    def interrupt(at):
        def progress(share, text):
            if "points" in text and share > at:
                raise KeyboardInterrupt

        log = EvaluationLog(tmp_path / f"journal-{at}")
        return settings.fit(problem(epsilon=NOISE), rng=3, evaluation_log=log, progress=progress)

    part = interrupt(0.6)
    assert (part.status, whole.status) == (Status.INTERRUPTED, Status.OUT_OF_BUDGET)
    assert "interrupted, these are the draws so far" in part.message
    steps = len(part.posterior.chain)
    assert 4 <= steps < 30
    assert np.array_equal(part.posterior.chain, whole.posterior.chain[:steps])
    again = settings.fit(
        problem(epsilon=NOISE), rng=3, evaluation_log=EvaluationLog(tmp_path / "journal-0.6")
    )
    assert np.array_equal(again.posterior.chain, whole.posterior.chain)
    with pytest.raises(KeyboardInterrupt):
        interrupt(0.1)
    assert capsys.readouterr() == ("", "")


def test_fit_is_saved_whole_and_drawn_from(tmp_path):
    fit = Posterior(sampler=Emcee(steps=60, burn_in=20)).fit(problem(epsilon=NOISE), rng=3)
    fit.save(tmp_path)
    back = Fit.load(tmp_path)
    assert np.array_equal(back.posterior.chain, fit.posterior.chain)
    assert json.loads((tmp_path / "fit.json").read_text())["posterior"]["split_r_hat"].keys() == {
        "x0",
        "x1",
    }
    sample = fit.sample(20000, 1)
    assert np.abs(sample.mean(axis=0) - fit.mean).max() < 4.5 * fit.sd.max() / np.sqrt(20000)


def test_a_posterior_narrower_than_a_search_keeps_its_width():
    """With noise of variance 1e-16 the posterior is narrower than the least scale of a search,
    1e-5; it is not widened.
    """
    rng = np.random.default_rng(5)
    simulator = LinearSimulator(MATRICES)
    data = simulate(
        simulator, TRUTH[None], np.ones((1, 30, 1)), np.zeros(2), noise_variance=1e-16, rng=rng
    )
    fit = Posterior(sampler=Emcee(steps=200, burn_in=200)).fit(
        Problem("sharp", simulator, data, epsilon=1e-16), rng=1
    )
    assert (fit.sd < 1e-8).all()
    assert (np.abs(fit.mean - TRUTH) < 5 * fit.sd).all()


def test_unusable_settings_are_refused():
    with pytest.raises(UnknownName, match="No posterior over called 'params'"):
        Posterior(over="params")
    with pytest.raises(
        BadArgument, match="epsilon of a posterior must be positive for every signal"
    ):
        Posterior(epsilon=0.0).fit(problem())


NUTS = PyroNuts(draws=200, warmup=60, chains=1)


@pytest.mark.parametrize(
    "sampler", [NUTS, PyroSvi(draws=500, steps=300, particles=2)], ids=["nuts", "svi"]
)
def test_gradient_samplers_give_the_conjugate_posterior(sampler):
    """Mean within 4.5 standard errors, sds within 4.5 of theirs, sd / sqrt(2 ESS); a mean half a sd
    away must fail.
    """
    pytest.importorskip("pyro")
    one = problem(epsilon=NOISE)
    mean, covariance = conjugate(one)
    fit = Posterior(sampler=sampler).fit(one, rng=1)
    sd = np.sqrt(np.diagonal(covariance))
    assert (z_of_means(fit, mean, covariance) < 4.5).all()
    assert (z_of_means(fit, mean + 0.5 * sd, covariance) > 4.5).all()
    assert fit.sd == pytest.approx(sd, rel=4.5 / np.sqrt(2 * 400))
    assert fit.simulator_steps < 8000  # a wide box is looked through first
    assert not any("local model" in text for text in fit.warnings)


@pytest.mark.parametrize(
    ("sampler", "away"),
    [(Emcee(steps=250, burn_in=100), 2.0), (PyroNuts(draws=60, warmup=30, chains=1), 15.0)],
    ids=["emcee", "nuts"],
)
def test_a_prior_pulls_by_the_right_amount(sampler, away):
    """A normal prior, as wide as the posterior without it and some sds away; NUTS' lies beyond its
    first local model.

    The mean is the conjugate one within 4.5 standard errors, and not the one without a prior.
    """
    if sampler.needs_gradients:
        pytest.importorskip("pyro")
    one = problem(epsilon=NOISE)
    alone, wide = conjugate(one)
    sd = float(np.sqrt(wide[0, 0]))
    prior = float(alone[0] + away * sd)
    mean, covariance = conjugate(one, prior, 1 / sd**2)
    fit = Posterior(sampler=sampler, priors={"x0": f"normal({prior!r}, {sd!r})"}).fit(one, rng=1)
    assert (z_of_means(fit, mean, covariance) < 4.5).all()
    assert z_of_means(fit, alone, covariance)[0] > 4.5
    assert fit.sd == pytest.approx(np.sqrt(np.diagonal(covariance)), rel=0.3)
    assert not any("local model" in text for text in fit.warnings)


def test_a_method_without_priors_refuses_them():
    """In silence the prior would have no effect at all."""
    one = problem(epsilon=NOISE, priors={"x0": "normal(1.5, 1e-4)"})
    for method in ("droid", "uniform-randomization"):
        with pytest.raises(Incompatible, match=rf"'{method}' uses no prior, .* one of x0"):
            find("methods", method)().fit(one)


def test_a_problem_brings_its_priors():
    """Over parameters as they are, over a distribution on the mean; the estimator's own first."""
    one = problem(epsilon=NOISE, priors={"x0": "normal(1.5, 1e-4)"})
    fit = Posterior(sampler=Emcee(steps=100, burn_in=100)).fit(one, rng=1)
    assert fit.mean[0] == pytest.approx(1.5, abs=1e-3)
    assert fit.sd[0] < 2e-4
    own = Posterior(sampler=Emcee(steps=100, burn_in=100), priors={"x0": "normal(1.6, 1e-4)"}).fit(
        one, rng=1
    )
    assert own.mean[0] == pytest.approx(1.6, abs=1e-3)
    with pytest.raises(UnknownName, match="No parameter called 'x2'"):
        problem(priors={"x2": "uniform"})
    with pytest.raises(
        UnknownName, match=r"No unknown with a prior called 'x0'. There is mean\.x0"
    ):
        Posterior(over="distribution", priors={"x0": "uniform"}).fit(problem(epsilon=NOISE))


def test_a_distribution_by_nuts_with_learned_noise():
    """Means, scales, a correlation and each signal's noise: all within 4.5 sds of what the data
    were drawn with.
    """
    pytest.importorskip("pyro")
    rng = np.random.default_rng(8)
    simulator = LinearSimulator(np.eye(2)[None], low=-4.0, high=4.0)
    rows = 25
    chol = np.linalg.cholesky(0.09 * np.array([[1.0, 0.6], [0.6, 1.0]]))
    values = TRUTH + rng.standard_normal((rows, 2)) @ chol.T
    actions = rng.uniform(-2, 2, (rows, 3, 1))
    one = Problem(
        "spread",
        simulator,
        simulate(simulator, values, actions, np.zeros(2), noise_variance=0.01, rng=rng),
    )
    fit = Posterior(
        over="distribution",
        family="full",
        epsilon="learn",
        sampler=PyroNuts(draws=40, warmup=30, chains=1),
    ).fit(one, rng=2)
    draws = fit.posterior.chain.reshape(-1, 7)
    names = fit.posterior.unknowns
    assert list(names[-2:]) == ["epsilon[0]", "epsilon[1]"]
    true = [*TRUTH, 0.3, 0.3, 0.6]
    assert (np.abs(draws[:, :5].mean(axis=0) - true) < 4.5 * draws[:, :5].std(axis=0)).all()
    assert (
        np.abs(draws[:, :4].mean(axis=0)) > 4.5 * draws[:, :4].std(axis=0)
    ).all()  # the control: they are not 0
    assert fit.epsilon == pytest.approx([0.01, 0.01], rel=0.5)
    assert fit.posterior.row_log_likelihood.shape == (40, 1, 75)


def test_draws_that_reach_the_edge_of_a_local_model_are_told():
    """Noise that hides the parameters: the posterior is as wide as the box, no local model is."""
    pytest.importorskip("pyro")
    fit = Posterior(
        likelihood="emulated", sampler=Emcee(steps=60, burn_in=30, walkers=8), epsilon=1e4
    ).fit(problem(), rng=1)
    assert any(
        "reach the edge of where the local model is trusted" in text for text in fit.warnings
    )


def test_inference_data_of_a_fit(tmp_path):
    """Groups, sizes and values, after saving and loading too; of a fit without draws, draws from
    its distribution that are called that.
    """
    arviz = pytest.importorskip("arviz")
    fit = Posterior(likelihood="emulated", sampler=Emcee(steps=30, burn_in=10, walkers=8)).fit(
        problem(epsilon=NOISE), rng=3
    )
    fit.save(tmp_path)
    for one in (fit, Fit.load(tmp_path)):
        data = one.to_inference_data()
        assert set(data.groups()) == {
            "posterior",
            "sample_stats",
            "log_likelihood",
            "observed_data",
        }
        assert dict(data.posterior.sizes) == {"chain": 8, "draw": 30}
        assert {"method": "posterior", "seed": 3}.items() <= data.attrs.items()
        np.testing.assert_array_equal(data.posterior["x1"].values, fit.posterior.chain[..., 1].T)
        np.testing.assert_allclose(
            data.log_likelihood["measured"].sum("measured_dim_0"),
            fit.posterior.log_density.T,
            rtol=1e-9,
        )
        np.testing.assert_allclose(
            arviz.summary(data, round_to="none")["mean"], fit.mean, rtol=1e-9
        )
    plain = DROPO(epsilon=NOISE).fit(problem(), rng=0)
    data = plain.to_inference_data(500, rng=1)
    assert data.attrs["draws_of"] == "the fitted distribution"
    np.testing.assert_array_equal(
        np.stack([data.posterior[name].values[0] for name in plain.space.names], axis=1),
        plain.sample(500, 1),
    )


def test_pairs_that_do_not_work_are_refused():
    with pytest.raises(
        Incompatible,
        match=r"PyroNuts needs the gradient .* Use likelihood 'emulated' or 'linear', or sampler"
        " 'emcee'",
    ):
        Posterior(over="distribution", likelihood="monte-carlo", sampler=NUTS).fit(
            problem(epsilon=NOISE)
        )
    with pytest.raises(
        Incompatible, match=r"Leave it out, or use 'emulated' or 'linear'\. Got 'monte-carlo'"
    ):
        Posterior(likelihood="monte-carlo").fit(problem(epsilon=NOISE))
    with pytest.raises(Incompatible, match="knows no noise on the start states and no Student t"):
        Posterior(epsilon=Noise(NOISE, start=True)).fit(problem())


def test_posterior_on_a_local_likelihood_is_around_its_maximum():
    """Random effects on twelve pushes: the posterior's mean and its errors are those of DROPO's
    fit, the errors within a third.
    """
    problem = pushes(0, count=12, epsilon=1e-6)
    fit = Posterior(
        over="distribution",
        likelihood="random-effects",
        sampler=Emcee(walkers=8, steps=40, burn_in=15),
    ).fit(problem)
    best = DROPO(likelihood="random-effects").fit(problem)
    assert (np.abs(fit.mean - best.mean) < 0.5 * best.mean_se).all()
    np.testing.assert_allclose(fit.mean_se, best.mean_se, rtol=1 / 3)
