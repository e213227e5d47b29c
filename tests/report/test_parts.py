"""Sentences about predictions say what their numbers say."""

from dataclasses import replace

import numpy as np
import pytest

from dropo.core.records.predictions import Predictions
from dropo.report import parts


@pytest.mark.parametrize(
    ("spread", "count", "said"),
    [
        (1.0, 2000, "about as sure as they should be"),
        (2.0, 2000, "too sure"),
        (0.3, 2000, "more cautious than needed"),
        (1.3, 12, "about as sure as they should be"),
        (1.0, 0, "No simulation came to its end."),
    ],
)
def test_calibration_in_words(fit_folder, spread, count, said):
    """By normal measurements so many times as wide as predicted; a dozen of them prove nothing."""
    from scipy.stats import norm

    found = Predictions.load(fit_folder)
    pit = norm.cdf(spread * np.random.default_rng(0).standard_normal(count))
    found = replace(found, after=replace(found.after, pit=pit))
    assert said in parts.calibrated(found)
    assert parts.too_sure(found) == (said == "too sure")


def test_share_inside_a_band(fit_folder):
    """All, none, and those between."""
    found = Predictions.load(fit_folder)
    wide = replace(
        found.after,
        band=np.stack(
            [np.full_like(found.measured, -np.inf), np.full_like(found.measured, np.inf)]
        ),
    )
    none = replace(found.after, band=np.stack([np.full_like(found.measured, np.inf)] * 2))
    assert (parts.inside(found, wide, 0), parts.inside(found, none, 0)) == (1.0, 0.0)
