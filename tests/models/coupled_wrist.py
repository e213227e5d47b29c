"""A gantry's wrist whose second joint a belt couples to the first, of which alone is logged."""

import mujoco
import numpy as np

from dropo.core.contracts.problem import Problem
from dropo.simulators.mujoco.simulator import MujocoSimulator
from tests.models.servo_runs import goals_of, logged, simulated

XML = """
<mujoco>
  <option timestep="0.002"/>
  <worldbody>
    <body name="column">
      <joint name="lift" type="slide" axis="0 0 1"/>
      <inertial pos="0 0 0" mass="2" diaginertia="0.01 0.01 0.01"/>
      <body name="wrist">
        <joint name="pitch" axis="0 1 0"/>
        <inertial pos="0.08 0 0" mass="0.5" diaginertia="0.001 0.001 0.001"/>
        <body name="tool" pos="0.16 0 0">
          <joint name="level" axis="0 1 0"/>
          <inertial pos="0.03 0 0" mass="0.3" diaginertia="0.0003 0.0003 0.0003"/>
        </body>
      </body>
    </body>
  </worldbody>
  <equality><joint name="belt" joint1="level" joint2="pitch" polycoef="0 -2 0 0 0"/></equality>
  <actuator>
    <position name="axis" joint="lift" kp="4000" kv="120"/>
    <position name="motor" joint="pitch" kp="40" kv="1.5"/>
  </actuator>
</mujoco>
"""
ROTOR = 0.006
"""Of the follower [kg m^2]: at its leader, twice as slow, four times as much."""
LOAD = 0.4
"""[kg] at the tool."""
NOISE = 2e-5  # [m, rad]
SIGNALS = ["qpos.lift", "qpos.pitch"]


def machine() -> MujocoSimulator:
    """What the model lacks, in steps of 0.2 ms."""
    spec = mujoco.MjSpec.from_string(XML)
    spec.option.timestep = 0.0002
    spec.joint("level").armature = ROTOR
    spec.body("tool").mass += LOAD
    return MujocoSimulator(spec, [], frame_skip=50, threads=1)


def coupled_wrist_problem(seed: int, *, runs: int = 3, count: int = 600) -> Problem:
    """Runs of 6 s under sums of sines; the last is held out."""
    rng = np.random.default_rng(seed)
    goals = goals_of([0.02, 0.25], runs, count, rng)
    measured = simulated(machine(), goals, runs)[..., : len(SIGNALS)]
    measured += rng.normal(0, NOISE, measured.shape)
    data = logged(measured, goals)
    spec = mujoco.MjSpec.from_string(XML)
    simulator = MujocoSimulator(spec, [], observation=SIGNALS, frame_skip=5, threads=1)
    return Problem(
        "coupled wrist",
        simulator,
        data.select(range(runs - 1)),
        held_out=data.select([runs - 1]),
    )
