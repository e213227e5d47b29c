"""What a fit's page shows beside its parameters, by how the fit was made."""

import re
from dataclasses import replace

import numpy as np
import pytest

from dropo.core.records.fits.fit import Fit
from dropo.core.records.parameters import Parameter, ParameterSpace
from dropo.estimators.dropo import DROPO
from dropo.estimators.least_squares import LeastSquares
from dropo.estimators.posterior import Posterior
from dropo.estimators.support.segment_length import ChooseHorizon
from dropo.optimizers.samplers.emcee import Emcee
from dropo.plots.distribution import correlated_pairs
from dropo.problems.simulated.slide import slide
from dropo.report.build import write_report
from dropo.report.pages.fit_page import _joint, _pairs
from tests.models.cart_task import fit_of


def page_of(fit, folder):
    """The text of the page of a fit that is saved."""
    fit.save(folder)
    return write_report(folder, folder / "page.html").read_text()


@pytest.fixture(scope="module")
def problem():
    """A part of the sliding block's data."""
    return slide().using(transitions=200)


def test_a_posterior_shows_its_walkers(problem, tmp_path):
    """The trace, and the diagnostics of each unknown."""
    sampler = Emcee(steps=80, burn_in=20)
    text = page_of(Posterior(over="parameters", sampler=sampler).fit(problem, rng=0), tmp_path)
    assert "The walkers" in text
    assert "effective sample size" in text
    assert text.count("<td") > 2 * 4


def test_a_tuned_epsilon_shows_its_sweep(problem, tmp_path):
    """Error and variance over epsilon."""
    fit = DROPO(epsilon="tune", sweep=(1e-6, 1e-5, 1e-4), mse_threshold=1e-3).fit(problem, rng=0)
    assert "Tuning of epsilon" in page_of(fit, tmp_path)


def test_a_chosen_horizon_shows_what_was_tried(problem, tmp_path):
    """A row for each number of steps."""
    fit = ChooseHorizon(DROPO(), lengths=(1, 2, 5)).fit(problem, rng=0)
    text = page_of(fit, tmp_path)
    assert "nats below the best on data held out" in text
    assert text.count(">chosen<") == 1


def test_correlations_and_a_missing_check_are_shown(fit_folder, tmp_path):
    """The strongest pair by name; that nobody looked whether the model is right."""
    fit = Fit.load(fit_folder)
    correlation = np.eye(4)
    correlation[0, 2] = correlation[2, 0] = -0.75
    text = page_of(replace(fit, correlation=correlation, model_check=None), tmp_path)
    assert "-0.75, of torso_mass and leg_mass" in text
    assert "Correlation matrix" in text
    assert "was not tested" in text
    assert "95 % if the model is right" in text


def test_the_share_of_priors_is_shown(problem, tmp_path):
    """In a column of its own, where the fit was searched with priors."""
    known = replace(problem, priors={"mass": "normal(1.5, 0.02)"})
    fit = LeastSquares().fit(known)
    text = page_of(fit, tmp_path)
    assert "share of the priors" in text
    assert f"{100 * fit.priors.share['mass']:.3g} %" in text
    assert "share of the priors" not in page_of(replace(fit, priors=None), tmp_path)


def test_many_parameters_show_the_strongest_pairs():
    """A small picture for each pair that is correlated, no corner plot; none without such."""
    space = ParameterSpace([Parameter(f"p{i}", 0.0, 2.0) for i in range(6)])
    fit = fit_of(space, np.full(6, 1.0), np.full(6, 0.05), correlation=0.8)
    shown = _pairs(fit)
    assert re.findall("<h3>([^<]*)</h3>", shown)[1:] == [f"{correlated_pairs(fit)[0][2]:+.2f}"]
    assert "Contours of p0 and p1, correlation 0." in shown
    assert "The strongest correlations, 1 of 15." in shown
    alone = fit_of(space, np.full(6, 1.0), np.full(6, 0.05))
    assert "No two parameters have a correlation" in _pairs(alone)
    assert len(_joint(fit)) == 1
    assert _pairs(fit_of(ParameterSpace(list(space)[:2]), np.ones(2), np.full(2, 0.05))) == ""
