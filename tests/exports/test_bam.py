"""The target `bam` against the parameters of BAM's friction models."""

import json

import pytest

from dropo.exports.export import export
from tests.exports.conftest import arm_problem, known_fit

COMMON = {"armature", "q_offset", "command_delay", "friction_base", "friction_viscous", "kt", "R"}
STRIBECK = {"friction_stribeck", "dtheta_stribeck", "alpha"}
MODELS = {"m1": COMMON, "m2": COMMON | STRIBECK}
"""What `load_model_from_dict` of Rhoban/bam sets for a model (bam/model.py and the actuators at
17d9add), beside the keys `model` and `actuator` that it needs.
"""


def errors_of(content):
    """What BAM would miss, ignore or refuse in a parameter file."""
    known = MODELS.get(content.get("model"), set())
    numbers = {key: value for key, value in content.items() if key not in ("model", "actuator")}
    found = [key for key in ("model", "actuator") if not isinstance(content.get(key), str)]
    found += [key for key, value in numbers.items() if key not in known]
    return found + [key for key, value in numbers.items() if not isinstance(value, float)]


def test_files_are_those_of_bam(tmp_path):
    """A file for each servo, m2 where friction falls with speed; what is left out is said."""
    fixed = [
        ("joint_stribeck:shoulder", [0.2, -1.0]),
        ("actuator_delay", [0.006]),
        ("actuator_lag:push", [0.01]),
    ]
    problem = arm_problem(fixed=fixed)
    found = export(known_fit(problem), "bam", tmp_path, problem=problem)
    assert [path.name for path in found.files] == ["shoulder.json", "elbow.json"]
    shoulder, elbow = (json.loads(path.read_text()) for path in found.files)
    assert errors_of(shoulder) == errors_of(elbow) == []
    assert (shoulder["model"], elbow["model"]) == ("m2", "m1")
    assert shoulder["friction_viscous"] == pytest.approx(0.4)
    assert shoulder["friction_base"] == pytest.approx(0.15)
    assert shoulder["armature"] == pytest.approx(0.024)
    assert shoulder["friction_stribeck"] == 0.2
    assert shoulder["dtheta_stribeck"] == pytest.approx(0.5 / 2.718281828)
    assert shoulder["command_delay"] == elbow["command_delay"] == 0.006
    assert found.left_out[0].startswith("actuator_lag:push (time constant 0.01 s) is left out")
    assert any(sentence.startswith("Spreads are left out") for sentence in found.left_out)
    assert any("The actuator of shoulder, elbow is left" in one for one in found.left_out)
    assert errors_of({**elbow, "friction": 0.1}) == ["friction"]
    assert errors_of({**elbow, "friction_base": None}) == ["friction_base"]
    assert errors_of({key: elbow[key] for key in elbow if key != "actuator"}) == ["actuator"]
