"""Actions that were left out of a simulated recording are found again; what no action explains is
said.
"""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from dropo.core.records.trajectories import Trajectories
from dropo.core.services.errors import Incompatible
from dropo.mjmodel.fields import FieldParameter
from dropo.simulators.mujoco.inferred_actions import by_ideal_controllers, by_inverse_dynamics
from dropo.simulators.mujoco.simulator import MujocoSimulator

XML = """
<mujoco>
  <option timestep="0.002"/>
  <worldbody>
    <body><joint name="shoulder" axis="0 1 0" damping="0.05" frictionloss="0.02" armature="0.01"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.02" mass="0.5"/>
      <body name="arm" pos="0 0 -0.3"><joint name="elbow" axis="0 1 0" damping="0.05"/>
        <geom type="capsule" fromto="0 0 0 0 0 -0.2" size="0.02" mass="0.4"/>
        <body pos="0.1 0 -0.2"><joint name="wrist" type="ball" damping="0.02"/>
          <geom size="0.05" mass="0.1" pos="0.1 0 0"/></body>
      </body>
    </body>
  </worldbody>
  <actuator>
    {actuators}
  </actuator>
</mujoco>
"""
TORQUES = """<motor name="one" joint="shoulder" gear="5" ctrllimited="true" ctrlrange="-1 1"/>
             <general name="two" joint="elbow" gainprm="2" biastype="affine"
               biasprm="0.1 -0.5 -0.05"/>
             <motor name="three" joint="wrist" gear="1 0 0"/>
               <motor name="four" joint="wrist" gear="0 1 0"/>
             <motor name="five" joint="wrist" gear="0 0 1"/>"""
POSITIONS = (
    '<position name="one" joint="shoulder" kp="20" kv="1"/><velocity name="two" joint="elbow" '
    'kv="3"/>'
)


def robot(actuators, frame_skip=5):
    mass = FieldParameter("mass", 0.1, 1.0, "kg", field="body_mass", element="arm")
    return MujocoSimulator(
        mujoco.MjSpec.from_string(XML.format(actuators=actuators)),
        [mass],
        frame_skip=frame_skip,
        threads=1,
    )


def recording(simulator, values, seed=0, rows=150):
    """A trajectory of random commands that the simulator made at these values."""
    rng = np.random.default_rng(seed)
    q = len(simulator.controls)
    actions = (
        np.clip(np.cumsum(rng.normal(0, 0.1, (rows, q)), axis=0), -0.9, 0.9)
        * [0.2, 0.3, 0.004, 0.004, 0.004][:q]
    )
    model = simulator.model
    model = mujoco.MjSpec.from_string(
        XML.format(actuators=TORQUES if q == 5 else POSITIONS)
    ).compile()
    simulator.bindings[0].set(model, values[0])
    data = mujoco.MjData(model)
    mujoco.mj_setConst(model, data)
    mujoco.mj_resetData(model, data)
    states = [np.concatenate([data.qpos, data.qvel])]
    for action in actions:
        data.ctrl = action
        for _ in range(simulator.frame_skip):
            mujoco.mj_step(model, data)
        states.append(np.concatenate([data.qpos, data.qvel]))
    states = np.array(states)
    return Trajectories(states[:-1], actions, states[1:], np.arange(rows) == rows - 1)


@pytest.mark.parametrize("frame_skip", [1, 5])
def test_inverse_dynamics_finds_the_commands(frame_skip):
    """Within a thousandth (a tenth where friction holds a joint), through gears, biases and held
    commands, with another mass.
    """
    simulator = robot(TORQUES, frame_skip)
    true = recording(simulator, [0.5])
    found = by_inverse_dynamics(
        simulator, replace(true, actions=np.zeros_like(true.actions)), [0.5]
    )
    scale = true.actions.std(axis=0)
    np.testing.assert_array_less(
        np.median(np.abs(found.trajectories.actions - true.actions), axis=0) / scale, 1e-3
    )
    np.testing.assert_array_less(
        np.abs(found.trajectories.actions - true.actions).max(axis=0) / scale, 0.1
    )
    wrong = by_inverse_dynamics(simulator, true, [0.6])
    assert (
        np.median(np.abs(wrong.trajectories.actions[:, 0] - true.actions[:, 0])) > 0.01 * scale[0]
    )


def test_what_no_action_gives_is_said():
    """A push at the elbow, which has no actuator here, is left over there and when it acted, and
    nowhere else.
    """
    simulator = robot('<motor name="one" joint="shoulder"/>', 1)
    model = simulator.model
    data = mujoco.MjData(simulator.model)
    states = [np.concatenate([data.qpos, data.qvel])]
    data.qpos[0] = 0.5
    for row in range(60):
        data.qfrc_applied[1] = 0.2 if 20 <= row < 40 else 0.0
        data.ctrl[0] = 0.3
        mujoco.mj_step(model, data)
        states.append(np.concatenate([data.qpos, data.qvel]))
    rows = np.array(states)
    found = by_inverse_dynamics(
        simulator, Trajectories(rows[1:-1], np.zeros((59, 1)), rows[2:], np.arange(59) == 58)
    )
    pushed = (np.arange(1, 60) >= 20) & (np.arange(1, 60) < 40)
    np.testing.assert_allclose(found.unexplained[pushed, 1], 0.2, rtol=0.05)
    assert np.abs(found.unexplained[~pushed]).max() < 0.01
    np.testing.assert_allclose(found.trajectories.actions[:, 0], 0.3, atol=0.02)


def test_ideal_controllers_reach_their_set_points():
    """Position actuators are commanded where the joint was at the step's end, velocity actuators as
    fast as it was.
    """
    simulator = robot(POSITIONS)
    true = recording(simulator, [0.4])
    found = by_ideal_controllers(simulator, true)
    np.testing.assert_allclose(
        found.trajectories.actions[:, 0], true.next_observations[:, 0], atol=1e-12
    )
    np.testing.assert_allclose(
        found.trajectories.actions[:, 1], true.next_observations[:, 7], atol=1e-12
    )
    assert np.abs(found.trajectories.actions - true.actions).max() > 0.01


def test_refusals():
    """A motor is no controller; velocities that are not observed must be estimated first."""
    simulator = robot(TORQUES)
    true = recording(simulator, [0.4], rows=10)
    with pytest.raises(Incompatible, match="'one' is no position or velocity controller"):
        by_ideal_controllers(simulator, true)
    half = MujocoSimulator(simulator.model, [], observation=["qpos"])
    columns = true.observations[:, :6], true.next_observations[:, :6]
    with pytest.raises(Incompatible, match=r"qvel\[0\] is not observed"):
        by_inverse_dynamics(
            half, replace(true, observations=columns[0], next_observations=columns[1])
        )
