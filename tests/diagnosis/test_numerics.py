"""What remains because of the physics step is said to be the step's."""

import mujoco
import numpy as np
import pytest

from dropo import Diagnose, Problem
from dropo.core.records.trajectories import Trajectories
from dropo.simulators.mujoco.simulator import MujocoSimulator

XML = """
<mujoco>
  <option timestep="0.01"/>
  <worldbody>
    <body>
      <joint name="pivot" axis="0 1 0"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.02" mass="0.5"/>
    </body>
  </worldbody>
  <actuator><motor name="motor" joint="pivot"/></actuator>
</mujoco>
"""
DAMPING = 0.03  # [N m s/rad]
NOISE = np.array([2e-4, 2e-3])  # [rad, rad/s]
RUNS, STEPS = 12, 60


def pendulum(damping=0.0, finer=1):
    """A pendulum on a motor, its physics steps so many times shorter."""
    spec = mujoco.MjSpec.from_string(XML)
    spec.option.timestep /= finer
    spec.joints[0].damping[0] = damping
    return MujocoSimulator(spec, [], frame_skip=2 * finer, threads=1)


def recorded(finer):
    """A log of a pendulum that has damping, beside the model that has none."""
    rng = np.random.default_rng(3)
    phase = rng.uniform(0, 2 * np.pi, (RUNS, 1))
    torque = 0.5 * np.sin(0.15 * np.arange(STEPS) + phase).reshape(-1, 1)
    rest = np.zeros((len(torque), 2))
    ends = np.arange(len(torque)) % STEPS == STEPS - 1
    segments = Trajectories(rest, torque, rest, ends).segments(STEPS, every_step=True)
    after = pendulum(DAMPING, finer).predict(np.zeros((1, 0)), segments)[0]
    exact = np.concatenate([np.zeros((RUNS, 1, 2)), after.reshape(RUNS, STEPS, 2)], axis=1)
    measured = exact + NOISE * rng.normal(size=exact.shape)
    before = measured[:, :-1].reshape(-1, 2)
    return Problem(
        "pendulum", pendulum(), Trajectories(before, torque, measured[:, 1:].reshape(-1, 2), ends)
    )


@pytest.mark.parametrize("finer", [8, 1])
def test_the_steps_share_is_said(finer):
    """A machine in steps eight times shorter: damping is named, and that shorter steps explain
    data held out better. Control: in the model's own steps, that is not said.
    """
    found = Diagnose(("joint_damping",), disturbances=False).run(recorded(finer), rng=0)
    assert [cause.effect for cause in found.causes] == ["joint_damping"]
    said = [text for text in found.numerics if "physics steps of half the length (5 ms)" in text]
    assert bool(said) == (found.verdict == "partly") == (finer == 8)
