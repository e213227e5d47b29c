"""Three kinds of dry friction."""

import mujoco
import numpy as np
import pytest

from dropo.core.records.trajectories import Trajectories
from dropo.mjmodel.dynamics.dry_friction import FrictionKind, friction_kind, set_friction_kind
from dropo.simulators.mujoco.model_xml import format_model
from tests.models.holding_servo import FRICTION, servo

LOAD = 0.4 * 9.81 * 0.1  # gravity of the level arm [N m]


def creeping(simulator):
    """The speed [rad/s] at which the level arm, its servo off, moves after it was let go."""
    model = simulator.model
    model.actuator_gainprm[:] = 0.0
    model.actuator_biasprm[:] = 0.0
    rest = np.zeros((50, 2))
    segments = Trajectories(rest, rest[:, :1], rest, np.arange(50) == 49).segments(
        50, every_step=True
    )
    return simulator.predict(np.zeros((1, 0)), segments)[0].reshape(50, 2)[-1, 1]


def test_mujocos_friction_creeps_as_its_constraint_says():
    """(1 - d) F T / (2 m), to the share that damping takes."""
    simulator = servo(2 * FRICTION)
    inertia = simulator.model.dof_M0[0]
    assert creeping(simulator) == pytest.approx(0.1 * LOAD * 0.02 / (2 * inertia), rel=0.1)


def test_friction_that_holds_does_not_creep():
    """A thousandth of it is left; the simulator that it was made of creeps as before."""
    creeps = servo(2 * FRICTION)
    held = creeps.with_friction(FrictionKind.HOLDING)
    assert friction_kind(held.model) is FrictionKind.HOLDING
    assert friction_kind(creeps.model) is FrictionKind.CREEPING
    assert abs(creeping(held)) < 2e-3 * creeping(creeps)


def early(model):
    """How long before the level arm turns, pushed to and fro, its friction is 0 [s]."""
    data = mujoco.MjData(model)
    model.opt.timestep = 2e-4
    model.opt.gravity[:] = 0.0
    model.actuator_gainprm[:] = 0.0
    model.actuator_biasprm[:] = 0.0
    velocity = []
    friction = []
    for step in range(10_000):
        data.qfrc_applied[0] = 3 * FRICTION * np.sin(np.pi * step * 2e-4)
        mujoco.mj_step(model, data)
        velocity.append(data.qvel[0])
        friction.append(-data.qfrc_constraint[0])
    turns = [np.flatnonzero(np.diff(np.sign(one[2000:])))[0] for one in (velocity, friction)]
    return 2e-4 * float(turns[0] - turns[1])


def test_mujocos_friction_turns_early_as_its_constraint_says():
    """By d T / 2; one that holds hardly does."""
    creeps = servo(FRICTION)
    assert early(creeps.with_friction(FrictionKind.HOLDING).model) < 1e-3
    assert early(creeps.model) == pytest.approx(0.9 * 0.02 / 2, abs=1e-3)


def test_friction_that_turns_is_proportional_to_a_small_velocity():
    """Up to the friction, which it has from that of two physics steps on."""
    model = servo(FRICTION, turning=True).model
    assert friction_kind(model) is FrictionKind.TURNING
    data = mujoco.MjData(model)
    turning = FRICTION * model.opt.timestep * model.dof_invweight0[0]
    for share in (-3.0, -0.5, 0.2, 0.9, 3.0):
        data.qvel[0] = share * turning
        mujoco.mj_forward(model, data)
        expected = -FRICTION * np.clip(share, -1, 1)
        assert data.qfrc_constraint[0] == pytest.approx(expected, abs=0.01 * FRICTION)


def test_it_is_written_into_the_mjcf():
    """A model that is read again holds as well."""
    text = format_model(servo(FRICTION).with_friction(FrictionKind.HOLDING))
    assert friction_kind(mujoco.MjModel.from_xml_string(text)) is FrictionKind.HOLDING
    model = mujoco.MjModel.from_xml_string(format_model(servo(FRICTION)))
    assert friction_kind(model) is FrictionKind.CREEPING


TWO_LINKS = """
<mujoco>
  <option timestep="0.002" integrator="implicitfast"/>
  <worldbody>
    <body>
      <joint name="first" axis="0 1 0" damping="0.05" frictionloss="0.3"/>
      <geom type="capsule" fromto="0 0 0 0.2 0 0" size="0.02" mass="0.4" contype="0"/>
      <body pos="0.2 0 0">
        <joint name="second" axis="0 1 0" damping="0.05" frictionloss="0.1" range="-60 60"/>
        <geom type="capsule" fromto="0 0 0 0.2 0 0" size="0.02" mass="0.2" contype="0"/>
      </body>
    </body>
  </worldbody>
</mujoco>
"""


def pushed(solver=None):
    """Angles (2000, 2) of two links with friction that holds, pushed to and fro, and the solver."""
    model = mujoco.MjModel.from_xml_string(TWO_LINKS)
    set_friction_kind(model, FrictionKind.HOLDING)
    own = model.opt.solver
    if solver is not None:
        model.opt.solver = solver
    data = mujoco.MjData(model)
    angles = []
    for step in range(2000):
        data.qfrc_applied[:] = np.array([1.5, 0.5]) * np.sin(2 * np.pi * step * 0.002)
        mujoco.mj_step(model, data)
        angles.append(data.qpos.copy())
    return np.array(angles), own


def test_gauss_and_seidel_solve_friction_as_newton_does():
    """Where nothing touches, through stops too; elsewhere the model's own solver stays."""
    angles, solver = pushed()
    assert solver == mujoco.mjtSolver.mjSOL_PGS
    by_newton, _ = pushed(mujoco.mjtSolver.mjSOL_NEWTON)
    assert np.ptp(angles) > 1.0
    np.testing.assert_allclose(angles, by_newton, atol=1e-6)
    touching = servo(FRICTION).with_friction(FrictionKind.HOLDING)
    assert touching.model.opt.solver == mujoco.mjtSolver.mjSOL_NEWTON
