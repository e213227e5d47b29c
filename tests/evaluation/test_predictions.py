"""Predictions of a fit: lines, bands and probabilities that are what they say."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from dropo import LeastSquares
from dropo.core.records.fits.fit_choices import HorizonChoice, HorizonTrial
from dropo.core.records.predictions import LEVEL
from dropo.evaluation.predictions import SETTINGS, predict
from dropo.problems.simulated.slide import slide
from dropo.simulators.toy import SlidingBlock
from tests.models.predicted_slide import TRUTH, problem


@pytest.fixture(scope="module")
def fitted():
    """The problem, its fit and what that predicts."""
    one = problem()
    fit = LeastSquares().fit(one, rng=0)
    return one, fit, predict(one, fit)


def test_lines_are_the_simulators(fitted):
    """After: the fitted mean's own trajectory from the measured start; before: that of the middle
    of the box.
    """
    one, fit, found = fitted
    assert found.before.name == "middle of the search intervals"
    middle = (one.space.low + one.space.high) / 2
    first = int(np.flatnonzero(one.trajectories.trajectory == 0)[0]) + int(found.begins[0])
    rows = one.trajectories.rows(np.arange(first, first + SETTINGS.horizons[-1]))
    for value, side in ((fit.mean, found.after), (middle, found.before)):
        expected = one.simulator.predict(value[None], rows.segments(reset="start"))[0]
        np.testing.assert_allclose(side.line[0], expected)
    np.testing.assert_array_equal(found.measured[0], rows.next_observations)
    np.testing.assert_array_equal(found.rows[0], rows.next_observations)


def test_errors_fall_to_the_noise(fitted):
    """At every horizon the fit's error is the noise's within a fifth, and the middle's far above
    it.
    """
    found = fitted[2]
    np.testing.assert_allclose(found.after.by_horizon, found.noise, rtol=0.2)
    assert (found.before.by_horizon[2:] > 3 * found.noise[2:]).all()
    np.testing.assert_allclose(found.after.by_signal, 1e-3, rtol=0.2)


def test_bands_and_probabilities_are_calibrated(fitted):
    """About 90 % of the dots lie in the band, and probabilities are uniform; a fit that claims a
    quarter of the noise fails both.
    """
    one, fit, found = fitted
    sure = predict(one, replace(fit, epsilon=fit.epsilon / 16))
    inside = []
    for result in (found, sure):
        low, high = result.after.band
        inside.append(np.mean((result.measured >= low) & (result.measured <= high)))
    count = found.measured.size
    assert (
        abs(inside[0] - LEVEL) < 4.5 * np.sqrt(LEVEL * (1 - LEVEL) / count) + 0.02
    )  # quantiles of 192 draws
    assert inside[1] < 0.6
    assert stats.kstest(found.after.pit, "uniform").pvalue > 1e-3
    assert stats.kstest(sure.after.pit, "uniform").pvalue < 1e-6


def test_what_was_known_before():
    """A simulator's own numbers where the data are measured, the middle of the box where they were
    simulated.
    """
    own = SlidingBlock()
    own.nominal = TRUTH + 0.5
    measured = replace(problem(), simulator=own)
    fit = LeastSquares().fit(measured, rng=0)
    assert predict(measured, fit).before.name == "the model's own numbers"
    simulated = replace(measured, truth={"mass": 1.5, "damping": 0.8})
    assert predict(simulated, fit).before.name == "middle of the search intervals"


def test_data_held_out_are_taken():
    """Where a problem has such: windows and probabilities are of these, and it is said."""
    fresh = problem(12).trajectories
    one = problem(held_out=fresh)
    found = predict(one, LeastSquares().fit(one, rng=0))
    assert found.held_out
    assert found.measured[0, 0] in fresh.next_observations
    assert not predict(slide(), LeastSquares().fit(slide(), rng=0)).held_out


def test_single_transitions_and_whole_trajectories():
    """Windows are as long as the data allow, and begin where the state is measured."""
    one = problem()
    data = one.trajectories
    cut = replace(one, trajectories=replace(data, terminals=np.ones(len(data), dtype=bool)))
    assert predict(cut, LeastSquares().fit(cut, rng=0)).measured.shape[1] == 1
    whole = replace(one, reset="start")
    assert (predict(whole, LeastSquares().fit(whole, rng=0)).begins == 0).all()


def test_a_length_that_was_chosen_is_taken(fitted):
    """The rows that a fit compares are as far ahead as its own."""
    one, fit, found = fitted
    trials = tuple(HorizonTrial(n, 0.0, 0.0, n == 5, (), ()) for n in (2, 5))
    chosen = replace(fit, horizon_choice=HorizonChoice(trials))
    assert (found.rows_after, predict(one, chosen).rows_after) == (1, 5)


def test_failed_simulations_leave_gaps():
    """A simulator that diverges under some draws: lines and bands of the others, errors of the
    others.
    """

    class Fragile(SlidingBlock):
        def _replay(self, value, starts, actions):
            return (
                super()._replay(value, starts, actions)
                if value[0] < 2.5
                else np.full((*actions.shape[:2], 2), np.nan)
            )

    one = replace(problem(), simulator=Fragile())
    found = predict(one, LeastSquares().fit(problem(), rng=0))
    assert np.isfinite(found.before.band).all()
    assert np.isfinite(found.after.line).all()
    assert one.simulator.failures > 0
