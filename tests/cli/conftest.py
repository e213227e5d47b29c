"""A small problem of its own: a cart on a rail, pushed at random."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

from dropo.core.records.trajectories import Trajectories
from dropo.mjmodel.fields import FieldParameter
from dropo.simulators.mujoco.simulator import MujocoSimulator

XML = """
<mujoco>
  <option timestep="0.01"/>
  <worldbody>
    <body name="cart"><joint name="slide" type="slide" axis="1 0 0" damping="0.5"/>
      <geom name="box" size="0.1" mass="2"/></body>
  </worldbody>
  <actuator><motor name="push" joint="slide" ctrllimited="true" ctrlrange="-1 1"/></actuator>
</mujoco>
"""
TEXT = """
model: robot.xml
data: data.npz
parameters:
  mass: {field: body_mass, name: cart, low: 1, high: 4, unit: kg}
  damping: {field: dof_damping, name: slide, low: 0.1, high: 1.0, unit: N s/m}
epsilon: 1e-8
"""


@pytest.fixture
def problem(tmp_path: Path) -> Path:
    """problem.yaml beside its model and data: 2 trajectories of 20 transitions with noise of sd
    1e-4.
    """
    mass = FieldParameter("mass", 1, 4, field="body_mass", element="cart")
    simulator = MujocoSimulator(mujoco.MjSpec.from_string(XML), [mass], threads=1)
    rng = np.random.default_rng(0)
    n = 40
    terminals = np.arange(n) % 20 == 19
    blank = Trajectories(np.zeros((n, 2)), rng.uniform(-1, 1, (n, 1)), np.zeros((n, 2)), terminals)
    following = simulator.predict([[2.0]], blank.segments(reset="start"))[0]
    observations = np.where(np.roll(terminals, 1)[:, None], 0.0, np.roll(following, 1, axis=0))
    following = following + rng.normal(0, 1e-4, following.shape)
    (tmp_path / "robot.xml").write_text(XML)
    np.savez(
        tmp_path / "data.npz",
        observations=observations,
        actions=blank.actions,
        next_observations=following,
        terminals=terminals,
    )
    (tmp_path / "problem.yaml").write_text(TEXT)
    return tmp_path / "problem.yaml"
