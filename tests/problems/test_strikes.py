"""Strikes of the arm keep to its limits, and do what their latents say."""

import mujoco
import numpy as np
import pytest

from dropo.problems.panda.sliding import (
    STEPS,
    sliding_spec,
)
from dropo.problems.panda.strikes import StrikeSettings, rest, speed_and_direction, strikes

STEP = 0.004  # [s] of control
FASTEST = np.radians([110, 110, 128, 128, 204, 184, 184])  # [rad/s] the LWR4+'s limits
CORNERS = np.array([[v, d] for v in (-2.0, 0.0, 2.0) for d in (-2.0, 0.0, 2.0)])


@pytest.fixture(scope="module")
def model():
    return sliding_spec().compile()


def ahead(turn):
    return np.stack([-np.sin(turn), np.cos(turn), 0 * turn], axis=1)


def commanded_speeds(model, settings):
    """The largest speed (7,) [rad/s] commanded to each joint."""
    angles = strikes(model, CORNERS, STEPS, STEP, settings)
    return np.abs(np.diff(angles, axis=1)).max(axis=(0, 1)) / STEP


def test_strikes_keep_to_the_arms_limits(model):
    """No joint is commanded beyond its range or its speed; the control: strikes of twice the
    speed are.
    """
    angles = strikes(model, CORNERS, STEPS, STEP)
    assert (angles > model.jnt_range[:7, 0]).all()
    assert (angles < model.jnt_range[:7, 1]).all()
    assert (commanded_speeds(model, StrikeSettings()) < FASTEST).all()
    twice_as_fast = StrikeSettings(speed=(0.8, 2.08))
    assert (commanded_speeds(model, twice_as_fast) > FASTEST).any()


def test_the_blade_meets_the_puck_as_the_latent_says(model):
    """The commanded blade is fastest at the latent's speed, and in its direction; it starts where
    every strike starts.
    """
    angles = strikes(model, CORNERS, 1500, 0.001)
    data = mujoco.MjData(model)
    path = np.empty((len(CORNERS), 1500, 3))
    for i, one in enumerate(angles):
        for t, now in enumerate(one):
            data.qpos[:7] = now
            mujoco.mj_kinematics(model, data)
            path[i, t] = data.site("blade").xpos
    velocity = np.diff(path, axis=1) / 0.001
    speed = np.linalg.norm(velocity, axis=2)
    wanted, turn = speed_and_direction(CORNERS)
    there = np.argmin(
        np.linalg.norm(
            path[:, :-1] - (model.body("puck").pos - 0.038 * ahead(turn))[:, None], axis=2
        ),
        axis=1,
    )
    np.testing.assert_allclose(speed[np.arange(9), there], wanted, rtol=0.03)
    np.testing.assert_allclose(
        velocity[np.arange(9), there] / wanted[:, None], ahead(turn), atol=0.05
    )
    np.testing.assert_allclose(path[:, :, 2], model.body("puck").pos[2], atol=2e-3)
    np.testing.assert_allclose(angles[:, 0], np.tile(rest(model), (9, 1)), atol=1e-3)
