"""The data sets of the hopper's tables."""

import numpy as np

from dropo.studies.tiboni_2021.hopper_sets import MEAN, SPREAD, data_set


def test_data_sets():
    """Masses that vary by table, other ones with another seed; none in table 6.1."""
    _, fixed = data_set("6.1", "clean", 0, 40)
    np.testing.assert_array_equal(fixed, MEAN[None].repeat(len(fixed), axis=0))
    _, drawn = data_set("6.3", "clean", 0, 1000)
    assert drawn.shape == (100, 4)
    np.testing.assert_allclose(
        drawn.std(axis=0), SPREAD["6.3"], rtol=0.3
    )  # four standard errors of a spread of 100
    assert (drawn != data_set("6.3", "clean", 1, 1000)[1]).any()
