"""The study of the quadrotor: what was done to it, and what counts as right."""

import pytest

from dropo.problems.measured.external_data import find_data
from dropo.studies.crazypad import study
from dropo.studies.engine.work import Work

outside = pytest.mark.skipif(
    find_data("crazypad/runs.npz") is None, reason="the measured data are not here"
)


def flight(name, fault, rotors, named, off=0.0, *, development=False):
    """A flight as the study has it."""
    return {
        "flight": name,
        "development": development,
        "fault": fault,
        "rotors": rotors,
        "off_mm": off,
        "large": off >= study.LARGE_CUT or "weight" in fault,
        "p_value": 1e-3,
        "differs": bool(named),
        "named": named,
        "labels": named,
        "sizes": ["1"] * len(named),
    }


def test_what_counts_as_right(monkeypatch):
    """The rotors of the fault and no other; a normal flight is right without a name."""
    flights = [
        flight("a", "propeller cut", ["M3"], ["M3"], 3.0),
        flight("b", "weight", ["M4"], ["M4", "M3"]),
        flight("c", "propeller cut", ["M3"], [], 6.0),
        flight("d", "normal", [], []),
        flight("e", "normal", [], ["M1"]),
        flight("f", "tape on the propeller", ["M3"], [], development=True),
    ]
    monkeypatch.setattr(study, "compared", lambda item: {"flights": flights})
    held_back, development, counts = study.crazypad_study(Work(threads=1)).tables
    assert [row[0] for row in held_back.rows] == ["a", "b", "c", "d", "e"]
    assert [row[0] for row in development.rows] == ["f"]
    large, small, tape, normal = (row[2:] for row in counts.rows[:4])
    assert large == ("3", "2", "1", "1")
    assert small == tape == ("0", "0", "0", "0")
    assert normal == ("2", "1", "1", "1")


@outside
def test_what_was_done_to_the_drone():
    """As the archive says; eleven flights served development."""
    found = study.faults()
    assert len(found) == 32
    assert sum(one["development"] for one in found.values()) == 11
    cut = found["E8.cut_propeller_M3_2.5mm_2mm_42.5mm.motor01"]
    assert (cut["rotors"], cut["off_mm"], cut["large"]) == (["M3"], 4.5, True)
    assert not found["E8.cut_propeller_M3_2mm.motor00"]["large"]
    assert found["E8.weight_on_string_W3_near_M3.motor00"]["large"]
