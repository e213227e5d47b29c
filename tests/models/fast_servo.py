"""A strong servo that moves fast, beside a model whose only fault is its physics step."""

import mujoco
import numpy as np

from dropo.core.contracts.problem import Problem
from dropo.core.records.trajectories import Trajectories
from dropo.simulators.mujoco.simulator import MujocoSimulator

XML = """
<mujoco>
  <option timestep="0.002"/>
  <worldbody>
    <body name="arm">
      <joint name="elbow" axis="0 1 0"/>
      <inertial pos="0 0 -0.14" mass="1.2" diaginertia="0.01 0.01 0.001"/>
    </body>
  </worldbody>
  <actuator><position name="servo" joint="elbow" kp="60" kv="2"/></actuator>
</mujoco>
"""
NOISE = 1e-4  # [rad]


def machine():
    """The same in steps of 0.1 ms."""
    spec = mujoco.MjSpec.from_string(XML)
    spec.option.timestep = 0.0001
    return MujocoSimulator(spec, [], frame_skip=100, threads=1)


def fast_servo_problem(seed, *, runs=2, count=1000):
    """Runs under sums of sines, of which nothing is missing but the machine's continuous time."""
    rng = np.random.default_rng(seed)
    time = 0.01 * np.arange(count)
    goals = np.zeros((runs, count))
    for frequency in (0.3, 0.7, 1.1, 1.5):
        phase = rng.uniform(0, 2 * np.pi, (runs, 1))
        goals += 0.25 * np.sin(2 * np.pi * frequency * time + phase)
    goals = (goals * np.minimum(1.0, time)).reshape(-1, 1)
    rest = np.zeros((len(goals), 2))
    ends = np.arange(len(goals)) % count == count - 1
    segments = Trajectories(rest, goals, rest, ends).segments(count, every_step=True)
    after = machine().predict(np.zeros((1, 0)), segments)[0].reshape(runs, count, 2)
    measured = np.concatenate([np.zeros((runs, 1, 2)), after], axis=1)
    measured[..., 0] += rng.normal(0, NOISE, measured.shape[:2])
    data = Trajectories(
        measured[:, :-1].reshape(-1, 2), goals, measured[:, 1:].reshape(-1, 2), ends
    )
    spec = mujoco.MjSpec.from_string(XML)
    return Problem("fast servo", MujocoSimulator(spec, [], frame_skip=5, threads=1), data)
