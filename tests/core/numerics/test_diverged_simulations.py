"""Simulations that explode without failing are told from wrong ones; signals that do not vary from
those that do.
"""

import numpy as np

from dropo.core.numerics.diverged_simulations import ExplosionSettings, flat, ranges, settled

SETTINGS = ExplosionSettings()
LARGEST = SETTINGS.largest_error

TARGETS = np.stack(
    [np.linspace(-1.0, 1.0, 21), np.full(21, 0.3), 1e-17 * np.arange(21), 1e-9 * np.arange(21)],
    axis=1,
)
"""A signal of range 1, a constant, an angle of 0 but for rounding, and a small signal."""


def predictions(*scales):
    """(K, R, p): the targets, each time with an error of one scale in the middle row of the first
    signal.
    """
    out = np.repeat(TARGETS[None], len(scales), axis=0)
    out[:, 10, 0] += scales
    return out


def test_rounding_is_no_variation():
    """1e-17 is an angle's rounding; 1e-9 is a signal."""
    np.testing.assert_array_equal(flat(TARGETS), [False, True, True, False])
    np.testing.assert_allclose(ranges(TARGETS), [1.0, np.inf, np.inf, 1e-8])


def test_an_explosion_is_left_out():
    """Beyond a hundred ranges in one row alone, or failed there; a wrong prediction is no
    explosion.
    """
    found = settled(
        predictions(0.0, 0.9 * LARGEST, 1.1 * LARGEST, 1e20, np.nan), TARGETS, ranges(TARGETS)
    )
    np.testing.assert_array_equal(found, [True, True, False, False, False])


def test_a_model_that_is_wrong_everywhere_has_not_exploded():
    """Where all are far away, as of a joint that stands still in the data, the typical error
    counts; a millionfold is hopeless.
    """
    given = np.repeat(TARGETS[None], 5, axis=0)
    reach = ranges(TARGETS)
    given[:, :, 0] += 1e3
    assert settled(given, TARGETS, reach).all()
    given[0, 3, 0] += 2 * LARGEST * 1e3
    np.testing.assert_array_equal(settled(given, TARGETS, reach), [False, True, True, True, True])
    given[:, :, 0] += 2 * SETTINGS.largest_typical_error
    assert not settled(given, TARGETS, reach).any()


def test_signals_that_do_not_vary_are_not_judged():
    given = predictions(0.0)
    given[:, :, 2] = 1.0
    assert settled(given, TARGETS, ranges(TARGETS)).all()


def test_nothing_is_left_where_all_fail():
    assert not settled(predictions(np.nan, np.nan), TARGETS, ranges(TARGETS)).any()
