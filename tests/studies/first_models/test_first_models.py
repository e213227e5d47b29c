"""The study of first models, on small machines."""

from functools import partial
from types import SimpleNamespace

import pytest

from dropo import Diagnose
from dropo.diagnosis.parts import Estimate
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


class Diagnosed:
    """Work that is done already: every second machine has a number 4 errors off, and one missed."""

    def map(self, function, items):
        right = {"right": True, "false": [], "missed": [], "together": [], "z": [1.0, -1.0]}
        wrong = {"right": False, "false": [], "missed": ["x"], "together": ["y"], "z": [4.0]}
        more = {"left": 0.1, "seconds": 2.0}
        return [{**(wrong if i % 2 else right), **more} for i in range(len(items))]


def test_what_is_counted():
    """Of two machines of each kind: one right, one missed, two of three numbers within 3 errors."""
    regression, simulation, strangers = study.first_models(Diagnosed(), 2).tables
    cells = ("1/2", "0", "1", "67% of 3", "2.45", "10.0%", "2.0")
    assert [row[:2] for row in regression.rows] == [
        (design, kind) for design in study.DESIGNS for kind in study.KINDS
    ]
    assert {row[2:] for row in regression.rows} == {cells}
    assert [row[0] for row in simulation.rows] == list(study.DESIGNS)
    assert strangers.rows[0] == ("missing", "2", *cells[:3], "1", *cells[3:])


def test_the_gain_of_all_drives_is_that_of_each():
    """Named for each drive where one number is the truth; a number that is told only together is
    not missed, and a false one is.
    """
    gain = lambda drive, value: SimpleNamespace(
        effect="actuator_gain", target=drive, estimate={"gain": Estimate(value, 0.1, "1")}
    )
    truth = {
        ("actuator_gain", None, "gain"): 0.5,
        ("joint_armature", "joint0", "armature"): 0.1,
        ("joint_armature", "joint1", "armature"): 0.1,
    }
    told = ("only together: joint_armature:joint0 0.1",)
    found = study._compared([gain("drive0", 0.4), gain("drive1", 0.6)], truth, 0.0, "partly", told)
    assert found["z"] == pytest.approx([-1.0, 1.0])
    assert found["false"] == []
    assert len(found["together"]) == len(found["missed"]) == 1
    one = study._compared([gain(None, 0.4), gain("drive0", 0.4)], truth, 0.0, "partly")
    assert not one["right"]
