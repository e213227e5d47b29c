"""A pendulum that hangs on a driven arm, and is driven by nothing itself."""

import mujoco
import numpy as np

from dropo.core.contracts.problem import Problem
from dropo.core.records.trajectories import Trajectories
from dropo.simulators.mujoco.simulator import MujocoSimulator

XML = """
<mujoco>
  <option timestep="0.001"/>
  <worldbody>
    <body name="arm">
      <inertial pos="0.1 0 0" mass="0.12" diaginertia="0.0003 0.0013 0.0013"/>
      <joint name="arm" axis="0 0 1"/>
      <body name="pendulum" pos="0.2 0 0">
        <inertial pos="0 0 -0.15" mass="0.12" diaginertia="0.0009 0.0009 1e-6"/>
        <joint name="swing" axis="1 0 0"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor name="motor" joint="arm"/></actuator>
</mujoco>
"""
ARMATURE = 0.001  # of the arm [kg m^2]
FRICTION = 0.01  # of the arm [N m]
DAMPING = (0.004, 0.0006)  # of both joints [N m s/rad]
TICK = 2 * np.pi / 1024  # of the encoders [rad]


def machine():
    """The pendulum with all that its first model lacks, in steps of 0.25 ms."""
    spec = mujoco.MjSpec.from_string(XML)
    spec.option.timestep = 0.00025
    arm, swing = spec.joints
    arm.armature = ARMATURE
    arm.frictionloss = FRICTION
    arm.damping = [DAMPING[0], 0, 0]
    swing.damping = [DAMPING[1], 0, 0]
    return MujocoSimulator(spec, [], frame_skip=20, threads=1)


def furuta_problem(seed, *, runs=2, count=2000):
    """Its first model, beside runs under sums of sines that encoders measured every 5 ms."""
    rng = np.random.default_rng(seed)
    time = 0.005 * np.arange(count)
    actions = np.zeros((runs, count))
    for frequency in (0.4, 0.9, 1.6, 2.3):
        phase = rng.uniform(0, 2 * np.pi, (runs, 1))
        actions += 0.025 * np.sin(2 * np.pi * frequency * time + phase)
    actions = actions.reshape(-1, 1)
    rest = np.zeros((len(actions), 4))
    ends = np.arange(len(actions)) % count == count - 1
    segments = Trajectories(rest, actions, rest, ends).segments(count, every_step=True)
    after = machine().predict(np.zeros((1, 0)), segments)[0].reshape(runs, count, 4)
    measured = np.concatenate([np.zeros((runs, 1, 4)), after], axis=1)
    measured[..., :2] = TICK * np.round(measured[..., :2] / TICK)
    data = Trajectories(
        measured[:, :-1].reshape(-1, 4), actions, measured[:, 1:].reshape(-1, 4), ends
    )
    spec = mujoco.MjSpec.from_string(XML)
    return Problem("furuta", MujocoSimulator(spec, [], frame_skip=5, threads=1), data)
