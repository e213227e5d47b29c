"""Rows of the tables: z-scores, and averages over data sets."""

import numpy as np

from dropo.studies.tiboni_2021.rows import over_data_sets, z_of


def test_z_and_errors():
    """z is the error in standard errors, and the average over data sets is that of the errors."""
    row = {
        "mean": [1.0, 2, 3, 4],
        "mean_se": [0.5, 0.5, np.nan, 1],
        "drawn_mean": [0.0, 2, 3, 6],
        "sd": [0.0] * 4,
    }
    np.testing.assert_allclose(z_of(row, "mean"), [2, 0, np.nan, -2])
    other = {**row, "mean": [2.0, 2, 3, 4]}
    table = over_data_sets("t", {"m": [row, other]})
    assert table.rows[0] == ("m, mean m1", "+1.5e+00", "0.5", "1.6", "3.2", "2")
    assert table.rows[2][-2:] == ("-", "0")
