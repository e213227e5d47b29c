"""A body's larger mass and the rotor of its joint are what something does that the body carries."""

import numpy as np
import pytest

from dropo.core.contracts.problem import Problem
from dropo.diagnosis import solving
from dropo.diagnosis.diagnose import Diagnose
from tests.models.holding_servo import FRICTION, recorded, servo

LOAD = 0.1  # [kg], 0.2 m from the joint; the link's centre is at half of that
BEGUN = {"body_mass": 2 * LOAD, "joint_armature": LOAD * 0.2**2 / 2}


def begun_with_both(selection, first, instances, known):
    """A search that begins with the mass, at the centre, and the rotor that do as the load does."""
    added = [one for one in instances if one.effect in BEGUN]
    theta = first.theta.copy()
    for one in added:
        theta[selection.library.indices_of[one.label]] = BEGUN[one.effect]
    return selection.polish(selection.try_set(first, theta, (), added, scanned=()))


@pytest.mark.slow
def test_one_payload_takes_the_place_of_mass_and_rotor(monkeypatch):
    """With the load's mass and place. Control: without the exchange both are named."""
    data = recorded(True, np.random.default_rng(3), finer=1, load=LOAD)
    problem = Problem("servo", servo(FRICTION, True), data)
    monkeypatch.setattr(solving, "begin_with", begun_with_both)
    diagnosis = Diagnose(effects=("body_mass", "joint_armature", "payload"))
    (cause,) = diagnosis.run(problem).causes
    assert cause.effect == "payload"
    for name, value in (("mass", LOAD), ("x", 0.2)):
        assert abs(cause.estimate[name].value - value) < 4 * cause.estimate[name].se < 0.1 * value
    monkeypatch.setattr(solving, "with_payload", lambda selection, state, instances: state)
    both = [one.effect for one in diagnosis.run(problem).causes]
    assert sorted(both) == ["body_mass", "joint_armature"]
