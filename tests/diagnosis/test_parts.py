"""Parts of a diagnosis come back from its file as they were written."""

import json
import math

from dropo.diagnosis.parts import Alternative, Cause, Leader, Suspect


def test_parts_come_back_as_they_were():
    """Global and local ones, with and without what tells them apart, laws with their formula."""
    parts = [
        Alternative("joint_friction", "elbow", "", "similarity 0.99"),
        Alternative("air_drag", None, "density", "similarity 0.9", to_tell="faster motions"),
        Alternative("law", "elbow", "", "2 nats worse", formula="-c1 * v**3"),
        Suspect("joint_friction", "elbow", 0.02, 0.1),
        Suspect("wind", None, 0.5, 0.001),
        Leader("wind", None, "x", 0.2, 0.01, 0.3),
    ]
    for part in parts:
        saved = json.loads(json.dumps(part.to_json()))
        assert type(part).from_json(saved) == part
    assert [part.label for part in parts[3:5]] == ["joint_friction:elbow", "wind"]
    assert "formula" not in parts[0].to_json()
    assert parts[2].place == "the law -c1 * v**3 at elbow"


def test_a_cause_without_which_the_simulation_diverges_can_be_saved():
    """Its error before is not known: null in JSON, and NaN again."""
    cause = Cause("joint_damping", "elbow", "", {}, 0.01, 1.0, 0.1, math.nan, 0.2)
    saved = json.loads(json.dumps(cause.to_json(1), allow_nan=False))
    assert saved["rmse_before"] is None
    assert math.isnan(Cause.from_json(saved).rmse_before)
    assert Cause.from_json(saved).rmse_after == 0.2
