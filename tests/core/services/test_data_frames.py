"""Tables for pandas hold a result's own numbers."""

import importlib.util

import numpy as np
import pytest

from dropo import LeastSquares
from dropo.core.services.data_frames import frame
from dropo.core.services.errors import DropoError
from dropo.problems.simulated.slide import slide


def test_a_fits_table():
    """A row for each parameter, floats as they are."""
    pytest.importorskip("pandas")
    fit = LeastSquares().fit(slide(), rng=0)
    table = fit.to_pandas()
    assert list(table.index) == ["mass", "damping"]
    np.testing.assert_array_equal(table["mean"], fit.mean)
    np.testing.assert_array_equal(table[["mean_low", "mean_high"]], fit.interval())
    assert table.loc["damping", "unit"] == "N s/m"
    assert frame([], "effect").empty


def test_a_fits_summary():
    """The columns that are read, with the truth where it is known."""
    pytest.importorskip("pandas")
    fit = LeastSquares().fit(slide(), rng=0)
    table = fit.summary()
    assert list(table.columns) == ["unit", "mean", "se", "low", "high", "sd", "truth"]
    assert table.loc["mass", "mean"] == fit["mass"].mean
    assert table.loc["mass", "truth"] == fit.truth["mass"]


def test_without_pandas(monkeypatch):
    """A sentence with the way out."""
    found = importlib.util.find_spec
    monkeypatch.setattr(
        "dropo.core.services.optional_dependencies.find_spec",
        lambda name: None if name == "pandas" else found(name),
    )
    with pytest.raises(DropoError, match=r"pip install 'dropo\[tables\]'"):
        frame([], "effect")
