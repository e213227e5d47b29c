"""What is to be typed into the model."""

import mujoco
import numpy as np

from dropo.core.contracts.effect import instances_of
from dropo.core.contracts.problem import Problem
from dropo.core.records.trajectories import Trajectories
from dropo.diagnosis.findings.to_type import SHOWN, to_type, typed_lines
from dropo.simulators.mujoco.simulator import MujocoSimulator

XML = """
<mujoco>
  <option timestep="0.002"/>
  <worldbody>
    <body name="arm">
      <joint name="elbow" axis="0 1 0" damping="0.1"/>
      <geom type="capsule" fromto="0 0 0 0.2 0 0" size="0.02" mass="0.4"/>
    </body>
  </worldbody>
  <actuator><motor name="drive" joint="elbow"/></actuator>
</mujoco>
"""


def problem(simulator):
    """Two rows of nothing."""
    rest = np.zeros((2, 2))
    data = Trajectories(rest, np.zeros((2, 1)), rest, np.array([False, True]))
    return Problem("arm", simulator, data)


def changed():
    """The arm with friction, a late drive and half the step."""
    came = MujocoSimulator(mujoco.MjSpec.from_string(XML), [], frame_skip=5, threads=1)
    context = came.effect_context
    friction = next(iter(instances_of(context, "joint_friction")))
    delay = next(iter(instances_of(context, "actuator_delay")))
    fixed = [(friction, np.array([0.05])), (delay, np.array([0.003]))]
    return came, came.with_finer_steps(2).with_effects((), fixed)


def test_elements_that_change_are_listed():
    """The step, the joint with its friction, and the delay, which no element holds; nothing of a
    model that is as it came.
    """
    came, found = changed()
    lines = to_type(problem(came), problem(found), {})
    assert lines == (
        '<option timestep="0.001"/>  <!-- option: new element -->',
        '<joint name="elbow" frictionloss="0.05"/>'
        "  <!-- body arm > joint elbow: new: frictionloss -->",
        "no element of MJCF: actuator delay at drive, delay 0.003 s",
    )
    assert to_type(problem(came), problem(came), {}) == ()


def test_few_lines_are_printed():
    """Those beyond are counted; nothing is printed of nothing."""
    assert typed_lines(()) == []
    assert typed_lines(("<a/>",)) == ["Type into the model:", "  <a/>"]
    many = typed_lines(["<a/>"] * (SHOWN + 2))
    assert len(many) == SHOWN + 2
    assert many[-1] == "  ... and 2 lines more, in extended/model.xml"


def test_of_a_compiled_model_nothing_is_listed():
    """It has no text to type into, which ends no diagnosis."""
    came = problem(MujocoSimulator(mujoco.MjModel.from_xml_string(XML), [], threads=1))
    assert to_type(came, came, {}) == ()
