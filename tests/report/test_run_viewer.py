"""The numbers of the picture that zooms are those of the run."""

import base64
import html
import json
import re
from dataclasses import replace

import numpy as np
import pytest

from dropo.core.records.predictions import Predictions
from dropo.report import run_viewer
from dropo.report.run_viewer import LOST, viewer


def read(text):
    """What the picture says of itself, and its series as numbers (signals, series, T)."""
    about = json.loads(html.unescape(re.search(r'data-about="([^"]*)"', text)[1]))
    data = base64.b64decode(re.search(r'data-numbers="([^"]*)"', text)[1])
    levels = np.frombuffer(data, "<i2").reshape(len(about["signals"]), -1, about["steps"])
    signs = np.array([signal["series"] for signal in about["signals"]])
    values = signs[..., :1] + signs[..., 1:] * levels
    return about, np.where(levels == LOST, np.nan, values)


@pytest.fixture(scope="module")
def found(diagnosis_folder):
    """Predictions of a diagnosis."""
    return Predictions.load(diagnosis_folder)


def test_numbers_come_back(found):
    """Measured, and both errors with levels of their own, to 2e-5 of each one's range."""
    about, values = read(viewer(found))
    for signal, (measured, before, after) in zip(about["signals"], values, strict=True):
        i = found.names.index(signal["name"])
        run = found.run
        for shown, wanted in (
            (measured, run.measured[:, i]),
            (before, run.measured[:, i] - run.before[:, i]),
            (after, run.measured[:, i] - run.after[:, i]),
        ):
            np.testing.assert_allclose(shown, wanted, atol=2e-5 * np.ptp(wanted))
    assert about["length"] == found.run.length


def test_failed_simulations_and_spans_held_out(found):
    """NaN stays NaN, also where all fail; spans are those of the rows held out."""
    after = found.run.after.copy()
    after[3:5] = np.nan
    held_out = np.zeros(len(after), dtype=bool)
    held_out[2:6] = True
    run = replace(found.run, after=after, before=np.full_like(after, np.nan), held_out=held_out)
    about, values = read(viewer(replace(found, run=run)))
    assert np.isnan(values[:, 1]).all()
    assert np.isnan(values[:, 2]).nonzero()[1].tolist() == [3, 4] * len(values)
    assert about["heldOut"] == [[2, 6]]
    assert "Shaded is what no fit has seen." in viewer(replace(found, run=run))


def test_long_runs_have_fewer_signals(found, monkeypatch):
    """So that a page stays small; a folder without a run has no such picture."""
    monkeypatch.setattr(run_viewer, "NUMBERS", 3 * len(found.run.measured) + 1)
    assert len(read(viewer(found))[0]["signals"]) == 1
    assert viewer(replace(found, run=None)) == ""
