"""Noise of measured states, which is in the row that ends there and in the next one."""

import numpy as np
import pytest

from dropo.core.contracts.noise import Noise
from dropo.estimators.dropo import DROPO
from dropo.families.point import Point
from dropo.likelihoods.emulated import Emulated
from dropo.likelihoods.support.gaussian_rows import GaussianRows
from dropo.likelihoods.support.measured_states import StatesSettings, start_noise
from dropo.studies.intervals import data_sets
from dropo.studies.intervals.coverage import FEW

SETS = 12
"""Data sets of two long runs."""


@pytest.fixture(scope="module")
def rows():
    """The likelihood of a block's noisy runs, the truth, and their segments."""
    rng = np.random.default_rng(1)
    problem, truth = data_sets.data_set("block", "start", 2, 60, rng)
    noise = Noise(np.full(2, data_sets.NOISE**2), start=True)
    width = np.full(2, 0.1)
    family = Point(problem.space)
    segments = problem.segments
    objective = Emulated().linearize_at(
        problem.simulator, segments, family, noise, truth, width, rng
    )
    return objective, truth, segments


def test_noise_of_states_makes_the_residuals(rows):
    """n_end - J n_start of each row, with the end that the next row starts from."""
    objective, phi, segments = rows
    residuals = segments.targets - objective.mean(phi)
    variance = np.full(2, data_sets.NOISE**2)
    found = start_noise(residuals, objective.starts.slope, variance, segments)
    of_start = (objective.starts.slope[:] @ found.noise[:, :, None])[:, :, 0]
    ends = residuals + of_start
    goes_on = found.before >= 0
    assert goes_on.sum() == len(residuals) - 2
    np.testing.assert_allclose(found.noise[goes_on], ends[found.before[goes_on]], atol=1e-12)
    assert np.std(found.noise) == pytest.approx(data_sets.NOISE, rel=0.2)


def test_scores_of_states_have_the_same_sum(rows):
    """And are not those of the rows."""
    objective, phi, segments = rows
    _, scores, _ = objective.value_score_information(phi)
    sorted_scores = objective.scores_of_states(phi, scores, segments)
    np.testing.assert_allclose(sorted_scores.sum(axis=0), scores.sum(axis=0), rtol=1e-9)
    assert np.std(sorted_scores[:, 1]) < 0.9 * np.std(scores[:, 1])


def test_rows_that_share_an_end_keep_their_scores(rows):
    """Overlapping segments have no noise of states that makes all residuals; many rows cost."""
    segments = rows[2]
    twice = segments.take(np.r_[0, np.arange(len(segments))])
    slope = np.broadcast_to(np.eye(2), (len(twice), 2, 2))
    zero = np.zeros((len(twice), 2))
    assert start_noise(zero, slope, np.ones(2), twice) is None
    few = StatesSettings(most=10)
    assert start_noise(zero[1:], slope[1:], np.ones(2), segments, few) is None


def of_two_long_runs():
    """How errors of two means scatter, in standard errors: RMS (2,)."""
    z = []
    for seed in range(SETS):
        problem, truth = data_sets.data_set("block", "start", *FEW, np.random.default_rng(seed))
        fit = DROPO(likelihood="emulated", family="point", epsilon="learn").fit(problem, rng=seed)
        z.append((fit.mean - truth) / fit.mean_se)
    return np.sqrt(np.mean(np.square(z), axis=0))


def test_errors_of_two_long_runs_are_as_large_as_printed():
    """RMS 1, within 3 standard errors of a standard deviation from 12 sets."""
    assert np.all(np.abs(of_two_long_runs() - 1) < 3 / np.sqrt(2 * SETS))


def test_by_rows_they_are_printed_far_too_large(monkeypatch):
    """The control: scores of rows that follow each other all but cancel."""
    by_rows = lambda objective, phi, scores, segments: scores
    monkeypatch.setattr(GaussianRows, "scores_of_states", by_rows)
    assert of_two_long_runs()[1] < 0.4
