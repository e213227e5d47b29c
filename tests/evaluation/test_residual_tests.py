"""The regression that tests whether residuals can be predicted: with structure and without."""

import numpy as np
import pytest
from scipy import stats

from dropo.evaluation.residual_tests import (
    ResidualTestSettings,
    normal_score,
    predictability,
    random_features,
)

ROWS = 600
BLOCK = 20


def rows_of(seed, effect):
    """State, residuals that follow its square, blocks, and the two halves as one fold."""
    rng = np.random.default_rng(seed)
    state = rng.standard_normal((ROWS, 2))
    residuals = rng.standard_normal((ROWS, 2))
    residuals[:, 1] += effect * (state[:, 0] ** 2 - 1)
    design = np.concatenate([np.ones((ROWS, 1)), random_features(state, rng)], axis=1)
    unseen = np.arange(ROWS) >= ROWS // 2
    return design, residuals, [(~unseen, unseen)], np.arange(ROWS) // BLOCK


def test_structure_is_seen_in_the_signal_that_has_it():
    """And with cross-fitted folds as with two halves."""
    design, residuals, halves, block = rows_of(0, 1.2)
    fold = block % 5
    for folds in (halves, [(fold != k, fold == k) for k in range(5)]):
        found = predictability(design, residuals, folds, block)
        assert found.by_signal[1] > 4 > abs(found.by_signal[0])
        assert found.z > 4
        assert found.fall > 0


def test_without_structure_it_is_silent():
    """Of 200 signals without structure about as few are beyond 2.33 as chance has it, or fewer."""
    scores = np.concatenate([predictability(*rows_of(seed, 0.0)).by_signal for seed in range(100)])
    assert np.mean(scores > stats.norm.isf(0.01)) <= 0.03


def test_few_blocks_and_empty_folds_say_nothing():
    """Two blocks have no variance to speak of; a fold that all rows are in predicts nothing."""
    design, residuals, halves, block = rows_of(0, 0.7)
    assert predictability(design, residuals, halves, block // 15).z == 0.0
    everything = np.ones(ROWS, dtype=bool)
    found = predictability(design, residuals, [(~everything, everything)], block)
    assert (found.z, found.fall) == (0.0, 0.0)


def test_scores_are_those_of_the_t_distribution():
    """As unlikely as Student's t of the same sums, on both sides."""
    sums = np.random.default_rng(0).normal((1.0, -1.0, 0.0), size=(9, 3))
    expected = stats.ttest_1samp(sums, 0.0, alternative="greater").pvalue
    assert stats.norm.sf(normal_score(sums)) == pytest.approx(expected, rel=1e-9)
    assert (normal_score(np.zeros((4, 2))) == 0).all()


def test_penalties_are_the_settings():
    """Both ends and their number; no columns, no features."""
    grid = ResidualTestSettings(smallest_penalty=1e-3, largest_penalty=1e3, penalties=7).grid
    np.testing.assert_allclose(grid, [1e-3, 1e-2, 1e-1, 1, 10, 100, 1e3])
    assert random_features(np.zeros((4, 0)), np.random.default_rng(0)).shape == (4, 0)
