"""Jacobians are the slopes of the places beside them."""

import mujoco
import numpy as np
import pytest

from dropo.core.contracts.effect import StepState
from dropo.mjmodel.kinematics import centre_motion, site_pose
from dropo.mjmodel.names import element_id

MODEL = """<mujoco><worldbody><body><joint axis="0 1 0"/><geom size="0.1" mass="2" pos="0.2 0 0"/>
  <body name="hand" pos="1 0 0"><joint axis="0 0 1"/><geom size="0.1" mass="1" pos="0.3 0.1 0"/>
  <site name="tip" pos="0.5 0 0.1"/></body></body></worldbody></mujoco>"""
POSES = np.array([[0.3, -0.2], [-1.0, 0.7]])
STEP = 1e-6


@pytest.fixture(scope="module")
def model():
    return mujoco.MjModel.from_xml_string(MODEL)


def state(model, poses):
    """Simulations at rest in some poses."""
    n = len(poses)
    return StepState(
        poses, np.zeros((n, 2)), np.zeros((n, 0)), 0, np.zeros((n, 0)), model, np.zeros(n)
    )


def test_jacobians_of_a_centre_of_mass_are_its_slopes(model):
    """By central differences, in each of several simulations."""
    body = element_id(model, "body", "hand")
    _, jacobians = centre_motion(state(model, POSES), body)
    for dof in range(2):
        moved = STEP * np.eye(2)[dof]
        after, _ = centre_motion(state(model, POSES + moved), body)
        before, _ = centre_motion(state(model, POSES - moved), body)
        assert jacobians[:, :, dof] == pytest.approx((after - before) / (2 * STEP), abs=1e-8)


def test_the_jacobian_of_a_site_is_its_slope(model):
    """Of its place, and of its rotation: dR = [w] R."""
    data = mujoco.MjData(model)
    site = element_id(model, "site", "tip")
    pose = site_pose(model, data, site, POSES[0])
    assert pose.rotation @ pose.rotation.T == pytest.approx(np.eye(3), abs=1e-12)
    for dof in range(2):
        moved = STEP * np.eye(2)[dof]
        after = site_pose(model, data, site, POSES[0] + moved)
        before = site_pose(model, data, site, POSES[0] - moved)
        slope = (after.position - before.position) / (2 * STEP)
        assert pose.jacobian[:3, dof] == pytest.approx(slope, abs=1e-8)
        turn = (after.rotation - before.rotation) / (2 * STEP) @ pose.rotation.T
        assert pose.jacobian[3:, dof] == pytest.approx(turn[[2, 0, 1], [1, 2, 0]], abs=1e-8)
