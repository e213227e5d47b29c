"""What drives take, and feed back at a joint."""

import mujoco
import pytest

from dropo.mjmodel.dynamics.drives import command_kind, feedback_at
from dropo.mjmodel.dynamics.forces import force_per_command
from dropo.mjmodel.joints import joints

MODEL = """<mujoco><worldbody>
  <body><joint name="one" axis="0 1 0"/><geom size="0.1"/></body>
  <body pos="1 0 0"><joint name="two" axis="0 1 0"/><geom size="0.1"/></body></worldbody>
  <actuator><motor joint="one" gear="3"/><position joint="two" kp="10" kv="0.5" gear="2"/>
    <velocity joint="two" kv="0.25"/></actuator></mujoco>"""


@pytest.fixture(scope="module")
def model():
    return mujoco.MjModel.from_xml_string(MODEL)


def test_what_an_actuator_takes(model):
    """A motor, a position servo and a velocity servo."""
    assert [command_kind(model, i) for i in range(3)] == ["torque", "position", "velocity"]
    assert [force_per_command(model, i) for i in range(3)] == [3.0, 20.0, 0.25]


def test_servos_of_a_joint_are_added_behind_their_gears(model):
    """kp gear^2, and kv gear^2 of both; a motor feeds nothing back."""
    one, two = joints(model)
    assert feedback_at(model, one) == (0.0, 0.0)
    assert feedback_at(model, two) == (40.0, 2.25)
