"""Where nothing varies, the simulator itself has the last word on the means."""

import numpy as np
import pytest

from dropo.estimators import dropo
from dropo.estimators.dropo import DROPO
from dropo.likelihoods.support.gaussian_rows import GaussianRows
from dropo.problems.hopper.data import simulate
from dropo.problems.hopper.problem import NOISE, hopper_problem
from dropo.studies.intervals import data_sets
from dropo.studies.intervals.coverage import MANY

SETS = 3


def z_scores(seed, *, transitions=100, **settings):
    """Errors of the four masses in standard errors, and in kg, of data without noise."""
    data, _ = simulate(transitions, 1, rng=np.random.default_rng([3, seed]))
    problem = hopper_problem("hopper", data, 1e-8, threads=1)
    fit = DROPO(**settings).fit(problem, rng=seed)
    errors = fit.mean - np.array([problem.truth[name] for name in problem.space.names])
    return errors / fit.mean_se, errors


@pytest.fixture(scope="module")
def scores():
    """(SETS, 4) of data sets without noise."""
    return [z_scores(seed) for seed in range(SETS)]


def test_every_interval_holds_the_truth(scores):
    """Errors are of rounding, and within 3 standard errors: RMS 1.3 at most."""
    z = np.array([found[0] for found in scores])
    errors = np.array([found[1] for found in scores])
    assert np.abs(errors).max() < 1e-12
    assert np.abs(z).max() < 3
    assert np.sqrt(np.mean(z**2)) < 1.3


def test_without_the_last_step_they_do_not(monkeypatch):
    """The control: the emulator's own maximum is many standard errors off."""
    unchanged = lambda problem, run, family, objective, found: (objective, found)
    monkeypatch.setattr(dropo, "corrected_by_simulation", unchanged)
    z, errors = z_scores(0)
    assert np.abs(z).max() > 5
    assert np.abs(errors).max() > 1e-10


@pytest.mark.parametrize("likelihood", ["linear", "unscented"])
def test_other_local_likelihoods_too(likelihood):
    """Errors far below a search's that ends by its likelihood."""
    assert np.abs(z_scores(1, likelihood=likelihood)[1]).max() < 1e-10


def test_noise_is_settled_by_one_simulation():
    """The step is then a small part of the standard errors, which are the noise's."""
    data, _ = simulate(100, 1, rng=5, noise_variance=NOISE)
    problem = hopper_problem("hopper", data, NOISE, threads=1)
    fit = DROPO().fit(problem, rng=0)
    truth = np.array([problem.truth[name] for name in problem.space.names])
    assert np.all(np.abs(fit.mean - truth) < 4.5 * fit.mean_se)
    assert np.all(fit.mean_se > 1e-3)


NOISY = 12
"""Data sets whose starts carry noise, of twice the study's size."""


def damping_of_noisy_starts(monkeypatch):
    """Mean error of a block's damping in standard errors, over data sets."""
    monkeypatch.setattr(data_sets, "NOISE", 2 * data_sets.NOISE)
    z = []
    for seed in range(NOISY):
        problem, truth = data_sets.data_set("block", "start", *MANY, np.random.default_rng(seed))
        fit = DROPO(likelihood="emulated", family="point").fit(problem, rng=seed)
        z.append((fit.mean - truth)[1] / fit.mean_se[1])
    return np.mean(z)


def test_noise_of_starts_does_not_move_the_means(monkeypatch):
    """Slopes at noisy velocities have their errors in common with the residuals, which would make
    the damping larger by 1.5 standard errors. The mean of 12 is within 3 of its own.
    """
    assert abs(damping_of_noisy_starts(monkeypatch)) < 3 / np.sqrt(NOISY)


def test_without_what_it_takes_from_the_scores_it_does(monkeypatch):
    """The control."""
    none = lambda objective, phi, simulator, segments, step: None
    monkeypatch.setattr(GaussianRows, "scores_of_noisy_starts", none)
    assert damping_of_noisy_starts(monkeypatch) > 3 / np.sqrt(NOISY)
