"""The study of first models, on small machines."""

from functools import partial

import pytest

from dropo import Diagnose
from dropo.studies.engine.work import Work
from dropo.studies.first_models import study
from dropo.studies.first_models.machines import recorded

DESIGN = "pendulum on a motor"
SEED = 106
"""Of a servo machine of one joint."""


@pytest.mark.study
def test_first_models(monkeypatch):
    """By regression with numbers missing and with none, then by simulation: what is right, false
    and missed, beside the numbers of each machine.
    """
    monkeypatch.setattr(study, "DESIGNS", {DESIGN: study.DESIGNS[DESIGN]})
    monkeypatch.setattr(study, "FIRST_SEED", SEED)
    monkeypatch.setattr(study, "recorded", partial(recorded, seconds=8.0))
    few = lambda: Diagnose(windows=10, disturbances=False)
    monkeypatch.setattr(study, "Diagnose", few)
    found = study.first_models(Work(threads=1), 1)
    regression, simulation, strangers = found.tables
    assert [row[:2] for row in regression.rows] == [(DESIGN, kind) for kind in study.KINDS]
    assert [row[0] for row in simulation.rows] == [DESIGN]
    answer = found.data["regression"][0][-1]
    named = len(answer["z"]) + len(answer["missed"])
    assert named == len(study._drawn(DESIGN, study.KINDS[0], SEED)[1])
    assert [row[0] for row in strangers.rows] == list(study.KINDS)
    assert found.data["simulation"][0][-1]["left"] < 0.1
