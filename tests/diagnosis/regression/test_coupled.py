"""Regression over inverse dynamics where an equality constraint couples a joint to another."""

import mujoco
import pytest

from dropo.core.services.errors import Incompatible
from dropo.diagnosis.regression.equation import refuse_unsuitable
from dropo.diagnosis.regression.quick import QuickDiagnose
from dropo.simulators.mujoco.simulator import MujocoSimulator
from tests.models.coupled_wrist import LOAD, ROTOR, XML, coupled_wrist_problem

COUPLING = '<joint name="belt" joint1="level" joint2="pitch" polycoef="0 -2 0 0 0"/>'


def test_what_a_follower_lacks_is_found_at_its_leader():
    """A rotor at the follower, which turns twice as fast, and a load on its body: within 3 errors,
    nothing else, and no force is left. The follower's angle is not logged.
    """
    found = QuickDiagnose().run(coupled_wrist_problem(1))
    sizes = {(one.effect, one.target): one.estimate for one in found.causes}
    rotor = sizes.pop(("joint_armature", "pitch"))["armature"]
    assert abs(rotor.value - 4 * ROTOR) < 3 * rotor.se < 0.2 * 4 * ROTOR
    ((effect, target), load) = sizes.popitem()
    assert (effect, target) in (("body_mass", "tool"), ("payload", "tool"))
    assert abs(load["mass"].value - LOAD) < 3 * load["mass"].se < 0.3 * LOAD
    assert sizes == {}
    assert found.verdict == "explained"
    assert [joint.joint for joint in found.forces] == ["lift", "pitch"]
    assert any("'level' follows 'pitch'" in text for text in found.warnings)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (COUPLING, '<weld body1="tool" body2="column"/>', "1 active equality .* of which 0"),
        (COUPLING, '<joint joint1="level"/>', "of which 0"),
        (
            "</actuator>",
            '<motor joint="level"/></actuator>',
            "couple a joint without a drive to one other joint",
        ),
        (COUPLING, COUPLING + '<joint joint1="level" joint2="lift"/>', "'level' is coupled to"),
    ],
)
def test_other_constraints_are_refused(old, new, words):
    """In a sentence that says which; the control: the model as it is, and switched off ones."""
    refuse_unsuitable(robot(XML))
    refuse_unsuitable(robot(XML.replace(COUPLING, '<weld body1="tool" active="false"/>')))
    with pytest.raises(Incompatible, match=words):
        refuse_unsuitable(robot(XML.replace(old, new)))


def robot(text):
    """A robot of which every position is observed."""
    spec = mujoco.MjSpec.from_string(text)
    return MujocoSimulator(spec, [], observation=["qpos"], frame_skip=5, threads=1)
