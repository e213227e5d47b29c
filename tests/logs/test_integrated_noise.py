"""The banded smoother is the Kalman smoother, and its likelihood is the Kalman filter's."""

import importlib.util
from dataclasses import astuple, replace
from pathlib import Path

import numpy as np
import pytest

from dropo.logs.signals.integrated_noise import IntegratedNoise, filter_motions

PATH = Path(__file__).parents[1] / "reference" / "kalman_smoother.py"
SPEC = importlib.util.spec_from_file_location("kalman_smoother", PATH)
reference = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(reference)

NONE = np.empty(0, dtype=np.int64)
Q = 3.0
R = 0.04


def motion(order, seed=0):
    rng = np.random.default_rng(seed)
    time = np.cumsum(rng.uniform(0.05, 0.3, 60))
    return IntegratedNoise(time, np.sin(time) + 0.2 * rng.normal(size=60), order, NONE, unit=0.1)


def ratio(one, q=Q):
    """q / r in the inner unit of time."""
    return q / R * one.unit ** (2 * one.order - 1)


@pytest.mark.parametrize("order", [2, 3])
def test_smoothed_and_filtered_states_are_the_kalman_smoothers(order):
    """Positions and all derivatives agree at uneven times, as far as the reference's wide start
    allows.
    """
    one = motion(order)
    smoothed, past, _ = reference.smooth(one.time, one.measured, order, Q, R)
    np.testing.assert_allclose(
        one.smoothed(ratio(one), one.measured[:, None])[:, :, 0], smoothed, rtol=1e-4, atol=1e-5
    )
    np.testing.assert_allclose(
        filter_motions([one], np.array([ratio(one)]))[0][5:], past[5:], rtol=1e-4, atol=1e-4
    )


def test_the_likelihood_is_the_kalman_filters():
    """Differences of the log likelihood between two densities agree: a start that may be anything
    adds the same to both.
    """
    one = motion(3)

    def by_bands(q):
        terms = one.likelihood_terms(ratio(one, q))
        return -0.5 * (terms.squares / R + terms.degrees * np.log(R) + terms.log_determinant)

    wanted = [reference.smooth(one.time, one.measured, 3, q, R)[2] for q in (Q, 20 * Q)]
    assert by_bands(20 * Q) - by_bands(Q) == pytest.approx(wanted[1] - wanted[0], abs=1e-4)
    assert abs(wanted[1] - wanted[0]) > 1


def test_a_motion_that_begins_anew_is_two_motions():
    """States, squares and determinant of a split motion are those of its pieces."""
    one = motion(3)
    split = replace(one, jumps=np.array([25]))
    pieces = [
        replace(one, time=one.time[rows], measured=one.measured[rows])
        for rows in (slice(0, 25), slice(25, 60))
    ]
    np.testing.assert_allclose(
        split.smoothed(1e-3, one.measured[:, None]),
        np.concatenate([p.smoothed(1e-3, p.measured[:, None]) for p in pieces]),
        rtol=1e-8,
    )
    terms = split.likelihood_terms(1e-3)
    together = pieces[0].likelihood_terms(1e-3) + pieces[1].likelihood_terms(1e-3)
    np.testing.assert_allclose(astuple(terms), astuple(together), rtol=1e-8)
    assert terms.squares < one.likelihood_terms(1e-3).squares
