"""EPOpt's particles against the conjugate posterior, in closed form for a linear simulator."""

import numpy as np
import pytest

from dropo.cli.main import main
from dropo.core.contracts.problem import Problem
from dropo.core.records.fits.fit import Fit, Status
from dropo.core.services.errors import BadArgument, Incompatible
from dropo.estimators.epopt import EPOpt
from dropo.simulators.toy import LinearSimulator, simulate

TRUTH = np.array([1.5, -0.7])
NOISE = 0.04
MATRICES = np.array([[[1.0, 0.5], [0.0, 1.0]]])


def problem(**settings):
    rng = np.random.default_rng(5)
    simulator = LinearSimulator(MATRICES)
    data = simulate(
        simulator,
        np.tile(TRUTH, (30, 1)),
        rng.uniform(0.5, 1.5, (30, 1, 1)),
        np.zeros(2),
        noise_variance=NOISE,
        rng=rng,
    )
    return Problem("line", simulator, data, **settings)


def conjugate(problem, prior_mean=0.0, prior_precision=0.0):
    """Mean and covariance of the posterior; P the precision of the first parameter's prior."""
    design = np.concatenate([a * MATRICES[0] for a in problem.trajectories.actions[:, 0]])
    change = (problem.trajectories.next_observations - problem.trajectories.observations).ravel()
    known = np.diag([prior_precision, 0.0])
    covariance = np.linalg.inv(design.T @ design / NOISE + known)
    return covariance @ (design.T @ change / NOISE + known @ [prior_mean, 0.0]), covariance


def away(fit, mean, covariance):
    """How far off the weighted mean is, in standard errors of the effective particles."""
    found = fit.search_record.weights @ fit.search_record.particles
    return np.abs(found - mean) / np.sqrt(
        np.diagonal(covariance) / fit.search_record.effective_sample_size
    )


def test_the_posterior_is_the_conjugate_one():
    """Mean within 4.5 standard errors and standard deviations within 4.5 of theirs, sd / sqrt(2
    ESS); half a sd away must fail.
    """
    one = problem(epsilon=NOISE)
    mean, covariance = conjugate(one)
    fit = EPOpt(particles=2000).fit(one, rng=1)
    sd = np.sqrt(np.diagonal(covariance))
    assert (away(fit, mean, covariance) < 4.5).all()
    assert (away(fit, mean + 0.5 * sd, covariance) > 4.5).all()
    size = fit.search_record.effective_sample_size
    assert fit.sd == pytest.approx(sd, rel=4.5 / np.sqrt(2 * size))
    assert fit.correlation[0, 1] == pytest.approx(
        covariance[0, 1] / sd.prod(), abs=4.5 / np.sqrt(size)
    )
    assert fit.status is Status.CONVERGED
    assert size > 1000
    np.testing.assert_array_equal(fit.mean_se, fit.sd)


def test_priors_count():
    """A prior as narrow as the likelihood moves the mean to the conjugate one; that without the
    prior is 4.5 errors away.
    """
    plain = problem(epsilon=NOISE)
    one = problem(epsilon=NOISE, priors={"x0": "normal(1.3, 0.04)"})
    mean, covariance = conjugate(one, 1.3, 1 / 0.04**2)
    fit = EPOpt(particles=1000).fit(one, rng=1)
    assert (away(fit, mean, covariance) < 4.5).all()
    assert away(fit, conjugate(plain)[0], covariance)[0] > 4.5


def test_without_tempering_one_particle_is_left():
    """As published, where the data say much more than the prior: the fit warns; with tempering it
    does not.
    """
    bare, tempered = (
        EPOpt(tempered=tempered).fit(problem(epsilon=NOISE)) for tempered in (False, True)
    )
    assert bare.search_record.effective_sample_size < 3
    assert any("particles are effective" in text for text in bare.warnings)
    assert tempered.search_record.effective_sample_size > 80
    assert not tempered.warnings


def test_rounds_that_run_out_are_told():
    fit = EPOpt(rounds=2).fit(problem(epsilon=NOISE))
    assert fit.status is Status.OUT_OF_BUDGET
    assert fit.message.endswith("alone: take more rounds.")
    assert (fit.sd > 10 * np.sqrt(np.diagonal(conjugate(problem())[1]))).all()


def test_the_noise_is_what_least_squares_leaves():
    """Left out, it is 0.04 within 4.5 of its standard errors of 60 residuals, or as given."""
    fit = EPOpt().fit(problem())
    assert fit.epsilon == pytest.approx([NOISE] * 2, rel=4.5 * np.sqrt(2 / 30))
    assert EPOpt(epsilon=(0.1, 0.2)).fit(problem()).epsilon.tolist() == [0.1, 0.2]


def test_same_seed_same_fit_and_saved_whole(tmp_path):
    """A saved fit has the draws; the same seed gives the same ones."""
    one, same, other = (
        EPOpt(particles=50).fit(problem(epsilon=NOISE), rng=seed) for seed in (1, 1, 2)
    )
    assert one.mean.tolist() == same.mean.tolist() != other.mean.tolist()
    one.save(tmp_path)
    np.testing.assert_array_equal(Fit.load(tmp_path).search_record.draws, one.search_record.draws)


def test_on_the_command_line(tmp_path, capsys):
    """`dropo fit` runs it and resumes it from its folder."""
    arguments = [
        "fit",
        "slide",
        "--method",
        "epopt",
        "--transitions",
        "60",
        "--epsilon",
        "1e-5",
        "--out",
        str(tmp_path / "run"),
        "--json",
    ]
    assert main(arguments) == 0
    first = capsys.readouterr().out
    assert main(arguments) == 0
    shown = [line for line in capsys.readouterr().out.splitlines() if "wall_time" not in line]
    assert shown == [line for line in first.splitlines() if "wall_time" not in line]


def test_refusals():
    with pytest.raises(
        BadArgument, match="'particles' of EPOpt must be at least 20, ten a parameter"
    ):
        EPOpt(particles=19).fit(problem(epsilon=NOISE))
    with pytest.raises(BadArgument, match="'effective_fraction' of EPOpt must be a fraction"):
        EPOpt(effective_fraction=1.0)
    with pytest.raises(
        Incompatible, match="'epopt' knows Gaussian noise on the compared rows alone"
    ):
        EPOpt().fit(problem(epsilon=NOISE, start_noise=True))
