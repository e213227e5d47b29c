"""The study of measured machines, on one of them with few windows and one effect."""

import pytest

from dropo import Diagnose
from dropo.problems.measured.external_data import find_data
from dropo.studies.engine.pages import picture
from dropo.studies.engine.work import Work
from dropo.studies.measured import study

pytestmark = pytest.mark.skipif(
    find_data("swinging-pendulum/runs.npz") is None, reason="the measured data are not here"
)


def test_measured(monkeypatch):
    """Errors of every model at its horizon, the cause with its size, and a picture."""
    few = lambda: Diagnose(["joint_damping"], windows=6, disturbances=False)
    monkeypatch.setattr(study, "Diagnose", few)
    found = study.measured(Work(threads=1), problems=["swinging-pendulum"])
    errors, causes, _, _, remaining, _ = found.tables
    ((name, seconds, first, fitted, extended, noise, verdict),) = errors.rows
    assert (name, seconds) == ("swinging-pendulum", "8 s")
    sizes = [float(text.split()[0]) for text in (first, fitted, extended, noise)]
    assert sizes[0] > sizes[2] > sizes[3] > 0
    assert (verdict, remaining.rows[0][0]) == ("partly", "swinging-pendulum")
    assert [row[1].split(",")[0] for row in causes.rows] == ["joint damping at j1"]
    assert "<svg" in picture(found.draw)
