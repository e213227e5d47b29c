"""The numbers that a model has of its joints and commands."""

import mujoco
import numpy as np
import pytest

from dropo.mjmodel.joints import (
    all_joints,
    command_limits,
    dry_frictions,
    inertias,
    numbers_of,
    reference_pose,
)

MODEL = """<mujoco><worldbody>
  <body><joint name="free" type="free"/><geom size="0.1" mass="2"/></body>
  <body pos="1 0 0">
    <joint name="lift" type="slide" armature="0.2" damping="0.3" frictionloss="0.4" stiffness="5"
      springref="0.1" ref="0.2"/>
    <geom size="0.1" mass="3"/></body></worldbody>
  <actuator><motor name="bound" joint="lift" ctrlrange="-2 3" ctrllimited="true"/>
    <motor name="unbound" joint="lift"/></actuator></mujoco>"""


@pytest.fixture(scope="module")
def model():
    return mujoco.MjModel.from_xml_string(MODEL)


def test_numbers_are_those_of_the_joint_behind_a_free_one(model):
    """Places in qpos and qvel differ from the joint's number, and each number is its own."""
    found = numbers_of(model, all_joints(model)[1])
    assert (found.armature, found.damping, found.friction) == (0.2, 0.3, 0.4)
    assert (found.stiffness, found.rest) == (5.0, 0.1)
    assert found.inertia == pytest.approx(3.2)
    assert dry_frictions(model).tolist() == [0.0] * 6 + [0.4]
    assert inertias(model)[[0, 6]] == pytest.approx([2.0, 3.2])
    assert reference_pose(model).tolist() == [0, 0, 0, 1, 0, 0, 0, 0.2]


def test_what_is_read_does_not_change_the_model(model):
    """They are copies."""
    dry_frictions(model)[:] = 1.0
    reference_pose(model)[:] = 1.0
    assert dry_frictions(model)[6] == 0.4
    assert reference_pose(model)[7] == 0.2


def test_commands_without_a_range_have_infinite_limits(model):
    """(2, nu): lower limits, then upper ones."""
    assert command_limits(model).tolist() == [[-2.0, -np.inf], [3.0, np.inf]]
