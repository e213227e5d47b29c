"""A strong servo that moves fast, beside a model whose only fault is its physics step."""

import mujoco
import numpy as np

from dropo.core.contracts.problem import Problem
from dropo.simulators.mujoco.simulator import MujocoSimulator
from tests.models.servo_runs import goals_of, logged, simulated

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
    goals = goals_of([0.25], runs, count, rng)
    measured = simulated(machine(), goals, runs)
    measured[..., 0] += rng.normal(0, NOISE, measured.shape[:2])
    data = logged(measured, goals)
    spec = mujoco.MjSpec.from_string(XML)
    return Problem("fast servo", MujocoSimulator(spec, [], frame_skip=5, threads=1), data)
