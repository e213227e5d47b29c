"""Several tests at once: values by hand, and the level by simulation."""

import numpy as np
from scipy.stats import norm

from dropo.core.numerics.multiple_tests import holm


def test_holm() -> None:
    """By hand: 3 x 0.01, 2 x 0.02, 1 x 0.03, none below the one before."""
    adjusted = holm([0.03, np.nan, 0.01, 0.02])
    np.testing.assert_allclose(adjusted, [0.04, np.nan, 0.03, 0.04])
    assert holm([0.9, 0.8]).tolist() == [1.0, 1.0]
    np.testing.assert_allclose(holm([0.04, 0.01, 0.03]), [0.06, 0.03, 0.06])


def test_the_level_holds_over_a_family_of_tests() -> None:
    """400 families of 5 tests without a difference: at most 5 % have a rejection, within three
    standard errors; the control, without Holm's correction, has far more.
    """
    rng = np.random.default_rng(3)
    adjusted = []
    single = []
    for _ in range(400):
        p_values = 2 * norm.sf(np.abs(rng.standard_normal(5)))
        adjusted.append(holm(p_values).min() < 0.05)
        single.append(min(p_values) < 0.05)
    bound = 0.05 + 3 * np.sqrt(0.05 * 0.95 / 400)
    assert np.mean(adjusted) < bound
    assert np.mean(single) > bound
