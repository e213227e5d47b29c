"""Regression over inverse dynamics of a machine on legs, and the friction of its feet."""

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np

from dropo.core.contracts.problem import Problem
from dropo.diagnosis.regression.equation import UniformLog
from dropo.diagnosis.regression.kernels import derivative_kernels
from dropo.diagnosis.regression.quick import QuickDiagnose
from dropo.logs.starting import init
from dropo.mjmodel.joints import all_joints
from dropo.problems.loading import load
from dropo.problems.simulated.example_quadruped import WALK, Change, write_quadruped


def walking(folder: Path, change: Change, seconds: float) -> Problem:
    """The problem that `dropo init` makes of two logs, the second held out."""
    walk = replace(WALK, seconds=seconds)
    paths = write_quadruped(folder, 2, seed=0, walk=walk, change=change)
    init(paths[0], paths[1:], folder / "out")
    return load(folder / "out" / "problem.yaml", threads=1)


def heavier(model: mujoco.MjModel) -> None:
    """1.5 kg more at the trunk, 0.6 N m more dry friction at one hip."""
    model.body_mass[model.body("trunk").id] += 1.5
    model.dof_frictionloss[model.joint("FL_hip").dofadr[0]] += 0.6


def test_a_payload_and_a_joints_friction(tmp_path: Path) -> None:
    """Both are named with their places, first and within 4.5 standard errors, of 15 masses, 12
    joints and 12 drives. A payload at the trunk's own centre is a heavier trunk, which says so.
    Where so much friction makes a joint stick, its rotor may be named too.
    """
    found = QuickDiagnose().run(walking(tmp_path, heavier, seconds=4.0))
    sizes = {(cause.effect, cause.target): cause.estimate for cause in found.causes}
    names = [(cause.effect, cause.target) for cause in found.causes]
    assert set(names[:2]) == {("body_mass", "trunk"), ("joint_friction", "FL_hip")}
    trunk = found.causes[names.index(("body_mass", "trunk"))]
    assert ("payload", "trunk") in [(one.effect, one.target) for one in trunk.confused_with]
    assert {target for _, target in names[2:]} <= {"FL_hip"}
    mass = sizes["body_mass", "trunk"]["mass"]
    assert abs(mass.value - 1.5) < 4.5 * mass.se < 4.5 * 0.5
    friction = sizes["joint_friction", "FL_hip"]["frictionloss"]
    assert abs(friction.value - 0.6) < 4.5 * friction.se < 4.5 * 0.2


def slippery(model: mujoco.MjModel) -> None:
    """The ground's friction is 0.4 in the place of 0.7."""
    model.geom_friction[model.geom("floor").id, 0] = 0.4


def test_the_grounds_friction(tmp_path: Path) -> None:
    """It alone is named, within 3 standard errors of a few percent; what is to be typed has it."""
    found = QuickDiagnose().run(walking(tmp_path, slippery, seconds=3.0))
    assert [(cause.effect, cause.target) for cause in found.causes] == [("contact_friction", None)]
    factor = found.causes[0].estimate["sliding"]
    assert abs(factor.value - (0.4 / 0.7 - 1)) < 3 * factor.se < 3 * 0.05
    assert "short simulations" in found.headline()
    assert found.to_json()["simulator_steps"] > 0
    assert any('name="floor"' in line for line in found.to_type)


def test_the_motion_of_a_free_body() -> None:
    """Smoothed quaternions give the angular velocity and acceleration that MuJoCo has, also where
    the log's quaternions change their sign.
    """
    text = """<mujoco><option timestep="0.001" gravity="0 0 0"/><worldbody><body><freejoint/>
      <geom type="box" size="0.1 0.2 0.3" mass="1"/></body></worldbody></mujoco>"""
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    data.qvel[:] = [0.3, 0, 0.1, 2, 3, 1]
    rows, speeds, pushes = [], [], []
    for _ in range(400):
        rows.append(np.concatenate([data.qpos, data.qvel]))
        mujoco.mj_forward(model, data)
        speeds.append(data.qvel.copy())
        pushes.append(data.qacc.copy())
        mujoco.mj_step(model, data)
    log = UniformLog.__new__(UniformLog)
    log.nv = 6
    log.step = 0.001
    log.joints = all_joints(model)
    positions = np.array(rows)[:, :7]
    positions[100::7, 3:] *= -1
    kernels = derivative_kernels(0.004, 0.001)
    _, velocity, acceleration = log.motion(kernels, log._continued(positions.copy()))
    inner = slice(50, 350)
    np.testing.assert_allclose(velocity[inner], np.array(speeds)[inner], atol=0.01)
    np.testing.assert_allclose(acceleration[inner], np.array(pushes)[inner], atol=0.1)
    assert np.abs(np.array(pushes)[inner]).max() > 1.0
