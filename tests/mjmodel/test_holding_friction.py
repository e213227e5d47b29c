"""Dry friction that holds what rests, and the creeping of MuJoCo's own."""

import mujoco
import numpy as np
import pytest

from dropo.core.records.trajectories import Trajectories
from dropo.mjmodel.dynamics.holding_friction import holds
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
    held = creeps.with_holding_friction()
    assert holds(held.model)
    assert not holds(creeps.model)
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
    """By d T / 2; that of `hold_friction` hardly does."""
    creeps = servo(FRICTION)
    assert early(creeps.with_holding_friction().model) < 1e-3
    assert early(creeps.model) == pytest.approx(0.9 * 0.02 / 2, abs=1e-3)


def test_it_is_written_into_the_mjcf():
    """A model that is read again holds as well."""
    text = format_model(servo(FRICTION).with_holding_friction())
    assert holds(mujoco.MjModel.from_xml_string(text))
    assert not holds(mujoco.MjModel.from_xml_string(format_model(servo(FRICTION))))
