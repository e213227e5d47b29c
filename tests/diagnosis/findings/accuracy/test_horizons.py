"""Errors after a horizon, and how often motion is lost."""

from types import SimpleNamespace

import numpy as np
import pytest

from dropo.core.records.trajectories import Signal
from dropo.diagnosis.findings.accuracy.horizons import LOST, OF_MOTION, _horizon, signal_noise
from dropo.evaluation.held_out import HorizonErrors

SIGNALS = (Signal("angle", "rad"), Signal("speed", "rad/s"))
SPREAD = np.array([1.0, 3.0])
SIMULATOR = SimpleNamespace(control_step=0.01)


def horizon(rows):
    """Of a model with these errors of two signals."""
    rows = np.asarray(rows, dtype=float)
    good = np.isfinite(rows).all(axis=1)
    failed = int((~good).sum())
    squares = np.mean(rows[good] ** 2, axis=0)
    errors = HorizonErrors(SIGNALS, 10, squares, SPREAD, len(rows), failed)
    return _horizon(SIMULATOR, errors, np.full(2, 1e-4), rows)


def test_an_error_counts_no_more_than_lost_motion():
    """One window in four is off by a thousand, or fails: both count the same, and are said to be
    lost; the plain root mean square is of that one alone, or knows nothing of it.
    """
    near = [[0.1, 0.3]] * 3
    far = horizon([*near, [1e3, 1e3]])
    failed = horizon([*near, [np.nan, np.nan]])
    expected = np.sqrt((3 * 0.1**2 + LOST**2) / 4)
    for found in (far, failed):
        assert found.capped["rad"] == pytest.approx(expected)
        assert found.capped[OF_MOTION] == pytest.approx(expected)
        np.testing.assert_allclose(found.capped_by_signal, expected * SPREAD)
        assert found.lost == 0.25
    assert far.units["rad"][0] > 400
    assert failed.units["rad"][0] == pytest.approx(0.1)


def test_small_errors_are_as_they_are():
    """None is lost, and nothing is capped."""
    found = horizon([[0.1, 0.3], [0.2, -0.1]])
    assert found.lost == 0
    assert found.capped["rad/s"] == pytest.approx(found.units["rad/s"][0])
    assert found.capped[OF_MOTION] == pytest.approx(found.rmse)


def test_what_was_estimated_has_the_noise_of_its_error():
    """As stated, or as far as the windows moved their starts, where that is more; where it is less
    than what windows make of it. Else, and of what was measured, theirs.
    """

    def side(moved):
        """Two windows, of which one is lost, whose starts were moved, and are 0.3 off there."""
        whiten = SimpleNamespace(
            sigma=np.array([0.1, 2.0]), latent=lambda residuals: np.full((2, 3), 0.3)
        )
        windows = SimpleNamespace(moved=moved)
        lost = np.array([False, True])
        return SimpleNamespace(whiten=whiten, windows=windows, residuals=None, lost=lost)

    def noise(estimated, moved=None):
        last = SimpleNamespace(train=side(moved), test=side(moved))
        problem = SimpleNamespace(simulator=SimpleNamespace(signals=SIGNALS), estimated=estimated)
        return signal_noise(problem, last).tolist()

    assert noise({}) == [0.1, 2.0]
    assert noise({"speed": 0.5}) == [0.1, 0.5]
    assert noise({"speed": 3.0}) == [0.1, 2.0]
    assert noise({"speed": 0.5}, np.array([[0.0, 0.4], [9.0, 9.0]])) == pytest.approx([0.1, 0.7])
