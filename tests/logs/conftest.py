"""A simulated arm of two joints with known motion, and the log of it that a perfect logger writes."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.interpolate import CubicHermiteSpline

XML = """
<mujoco model="arm">
  <option timestep="0.001" integrator="implicitfast"/>
  <worldbody>
    <body name="upper">
      <joint name="shoulder" type="hinge" axis="0 -1 0" damping="0.05"/>
      <geom name="link" type="capsule" fromto="0 0 0 0 0 -0.3" size="0.02" mass="0.8" contype="0" conaffinity="0"/>
      <body name="lower" pos="0 0 -0.3">
        <joint name="elbow" type="hinge" axis="0 -1 0" damping="0.05"/>
        <geom name="tip" type="capsule" fromto="0 0 0 0 0 -0.25" size="0.02" mass="0.4" contype="0" conaffinity="0"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor name="m1" joint="shoulder" ctrllimited="true" ctrlrange="-6 6"/>
    <motor name="m2" joint="elbow" ctrllimited="true" ctrlrange="-6 6"/>
  </actuator>
</mujoco>
"""
MAP = """
time: {column: t, unit: s}
qpos: {shoulder: {column: q1, unit: rad}, elbow: {column: q2, unit: rad}}
qvel: {shoulder: {column: dq1, unit: rad/s}, elbow: {column: dq2, unit: rad/s}}
ctrl: {m1: {column: tau1, unit: N m}, m2: {column: tau2, unit: N m}}
"""
STEP = 0.001
SECONDS = 20.0
Columns = dict[str, NDArray[Any]]


@dataclass(frozen=True)
class Arm:
    """The true motion at any instant: qpos, qvel (n, 2); and the torques that are held for a
    physics step.
    """

    qpos: Callable[[NDArray[np.float64]], NDArray[np.float64]]
    qvel: Callable[[NDArray[np.float64]], NDArray[np.float64]]
    ctrl: Callable[[NDArray[np.float64]], NDArray[np.float64]]

    def log(self, rate: float = 500.0, seconds: float = 8.0, start: float = 1.0) -> Columns:
        """The columns of MAP, without any fault."""
        t = start + np.arange(round(seconds * rate)) / rate
        q = self.qpos(t)
        dq = self.qvel(t)
        tau = self.ctrl(t)
        return {
            "t": t,
            "q1": q[:, 0],
            "q2": q[:, 1],
            "dq1": dq[:, 0],
            "dq2": dq[:, 1],
            "tau1": tau[:, 0],
            "tau2": tau[:, 1],
        }


@pytest.fixture(scope="session")
def arm() -> Arm:
    """20 s of motion under torques that are sums of sines."""
    model = mujoco.MjModel.from_xml_string(XML)
    data = mujoco.MjData(model)
    n = round(SECONDS / STEP)
    time = np.arange(n + 1) * STEP
    rates = 2 * np.pi * np.array([0.4, 0.9, 1.7, 2.6])
    torques = np.stack(
        [0.6 * np.sin(np.outer(time, rates) + phase).sum(axis=1) for phase in (0.0, 1.0)], axis=1
    ) * [1.0, 0.4]
    qpos = np.zeros((n + 1, 2))
    qvel = np.zeros((n + 1, 2))
    for i in range(n):
        data.ctrl[:] = torques[i]
        mujoco.mj_step(model, data)
        qpos[i + 1], qvel[i + 1] = data.qpos, data.qvel
    # the model's own velocities are those of the middle of the step before; their slope is that of
    # the positions, half a step earlier
    slopes = np.gradient(qvel, STEP, axis=0)
    return Arm(
        CubicHermiteSpline(time, qpos, qvel + slopes * STEP / 2),
        CubicHermiteSpline(time, qvel, slopes),
        lambda t: torques[np.clip(np.floor(t / STEP + 1e-6).astype(int), 0, n)],
    )


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with the model, robot.xml, and the mapping, map.yaml."""
    (tmp_path / "robot.xml").write_text(XML)
    (tmp_path / "map.yaml").write_text(MAP)
    return tmp_path


def write_csv(path: Path, columns: Columns) -> Path:
    """A table of text, with all digits; NaN is an empty cell."""
    rows = (
        [("" if value != value else repr(value.item())) for value in row]
        for row in zip(*columns.values(), strict=True)
    )
    path.write_text("\n".join([",".join(columns), *(",".join(row) for row in rows)]) + "\n")
    return path


@pytest.fixture
def csv() -> Callable[[Path, Columns], Path]:
    """write_csv(path, columns)."""
    return write_csv
