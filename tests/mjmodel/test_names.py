"""One rule names joints and actuators, for data, effects, observations and parameters alike."""

import mujoco
import numpy as np
import pytest

from dropo.core.services.registry import find
from dropo.mjmodel.fields import FieldParameter
from dropo.mjmodel.joints import degrees_of_freedom, joints, model_joints
from dropo.mjmodel.names import actuator_names, element_names, joint_names
from dropo.simulators.mujoco.simulator import MujocoSimulator


def model_of(bodies, actuators=""):
    """A compiled model of these bodies, each with mass."""
    xml = f"<mujoco><worldbody>{bodies}</worldbody><actuator>{actuators}</actuator></mujoco>"
    return mujoco.MjModel.from_xml_string(xml)


def body(joints, name=""):
    """A body with these joints."""
    named = f'name="{name}"' if name else ""
    return f'<body {named}>{joints}<geom size="0.1" mass="1"/></body>'


SLIDE = '<joint type="slide" axis="2 0 0"/>'
LIFT = '<joint type="slide" axis="0 0 1"/>'
TURN = '<joint axis="0 -1 0"/>'
SKEW = '<joint axis="1 1 0"/>'


@pytest.mark.parametrize(
    ("bodies", "wanted"),
    [
        (body(SLIDE + LIFT + TURN, "torso"), ["torso/slide_x", "torso/slide_z", "torso/hinge_y"]),
        (body(SLIDE + LIFT + TURN), ["joint0", "joint1", "joint2"]),
        (body(TURN, "arm"), ["arm"]),
        (body(TURN), ["joint0"]),
        (body("<freejoint/>", "box") + body('<joint type="ball"/>', "head"), ["box", "head"]),
        (body('<joint name="lift" type="slide"/>' + TURN, "arm"), ["lift", "arm"]),
        (
            body(SKEW + TURN + '<joint type="ball"/>', "arm"),
            ["arm/hinge_0", "arm/hinge_y", "arm/ball"],
        ),
        (
            body(TURN + SLIDE + '<joint axis="0 1 0" pos="1 0 0"/>', "arm"),
            ["arm/hinge_0", "arm/slide_x", "arm/hinge_2"],
        ),
        (body('<joint name="arm"/>', "base") + body(TURN, "arm"), ["arm", "joint1"]),
        (body('<joint name="joint1"/>') + body(TURN), ["joint1", "joint1_"]),
    ],
)
def test_names_of_joints(bodies, wanted):
    """Body, kind and axis where a body has several without a name; the body's name where it has
    one.
    """
    assert joint_names(model_of(bodies)) == wanted


@pytest.mark.parametrize(
    ("actuators", "wanted"),
    [
        ('<motor joint="a"/>', ["a"]),
        ('<motor joint="a"/><motor joint="a"/>', ["actuator0", "actuator1"]),
        ('<motor name="a" joint="b"/><motor joint="a"/>', ["a", "actuator1"]),
        ('<motor name="push" joint="b"/><motor body="a"/>', ["push", "actuator1"]),
    ],
)
def test_names_of_actuators(actuators, wanted):
    """The joint that an actuator alone drives, else its number."""
    if "body=" in actuators:
        actuators = actuators.replace('<motor body="a"/>', '<adhesion body="a" ctrlrange="0 1"/>')
    bodies = body('<joint name="a"/>', "a") + body('<joint name="b"/>', "b")
    assert actuator_names(model_of(bodies, actuators)) == wanted


def test_no_joint_is_lost():
    """A body's unnamed slide, slide and hinge are three joints, each at its own place, with its own
    unit.
    """
    found = model_joints(model_of(body(SLIDE + LIFT + TURN, "torso"))).joints
    assert [(joint.qpos, joint.qvel, joint.units("qvel")) for joint in found.values()] == [
        (0, 0, ("m/s",)),
        (1, 1, ("m/s",)),
        (2, 2, ("rad/s",)),
    ]
    assert list(found) == [joint.name for joint in found.values()]
    assert len(found) == 3


def test_everyone_says_the_same():
    """Observations, parameters, effects and logs know a joint by one name."""
    drive = '<motor joint="lift"/>'
    model = model_of(
        body(SLIDE + '<joint name="lift" type="slide" axis="0 0 1"/>' + TURN, "torso"), drive
    )
    names = ["torso/slide_x", "lift", "torso/hinge_y"]
    assert joint_names(model) == names
    assert list(model_joints(model).joints) == list(element_names(model, "joint")) == names
    assert degrees_of_freedom(model) == [
        ("torso/slide_x", "N"),
        ("lift", "N"),
        ("torso/hinge_y", "N m"),
    ]
    parameter = FieldParameter("damping", 0.0, 1.0, field="dof_damping", element="torso/hinge_y")
    items = ["qpos.torso/slide_x", "qvel"]
    simulator = MujocoSimulator(
        model, [parameter], observation=items, action=["ctrl.lift"], threads=1
    )
    assert simulator.layout.names == ["qpos.torso/slide_x", *(f"qvel.{name}" for name in names)]
    assert simulator.action_names == ["lift"]
    simulator.bindings[0].set(model, 0.5)
    np.testing.assert_array_equal(model.dof_damping, [0, 0, 0.5])
    targets = {
        instance.target for instance in find("effects", "joint_armature")(simulator.effect_context)
    }
    assert targets - {None} == set(names)
    assert [one.name for one in joints(model)] == names


def test_a_floating_base_has_no_joints_of_its_own():
    """Three joints of a body that hangs from the world, none of them driven."""
    assert joints(model_of(body(SLIDE + LIFT + TURN, "torso"))) == []
