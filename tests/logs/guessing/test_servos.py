"""First gains of drives are those of the servos that moved the joints, where the log shows them."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

from dropo.logs.guessing.check import check_logs
from dropo.logs.guessing.servos import command_sizes, estimate_drives
from dropo.logs.mapping import read_mapping
from dropo.logs.recordings import LogRun, read_runs
from dropo.mjmodel.files.robots import DriveGuess
from dropo.mjmodel.joints import ModelJoints, load_model_joints

DAMPING = 0.4
ARM = f"""
<mujoco>
  <option timestep="0.001" gravity="0 0 0" integrator="implicitfast"/>
  <worldbody>
    <body name="upper"><joint name="pan" axis="0 0 1"/>
      <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.02" mass="0.8"/>
      <body name="tip" pos="0.3 0 0"><joint name="wrist" axis="1 0 0" damping="0.05"/>
        <geom size="0.03" mass="0.2"/></body></body>
  </worldbody>
  <actuator><velocity name="pan" joint="pan" kv="{DAMPING}"/>
    <motor name="wrist" joint="wrist"/></actuator>
</mujoco>
"""


def moved(folder: Path, text: str) -> tuple[list[LogRun], ModelJoints]:
    """A log of four seconds under changing commanded velocities, by a mapping."""
    model = mujoco.MjModel.from_xml_string(ARM)
    data = mujoco.MjData(model)
    rows = []
    for k in range(800):
        wanted = 1.5 * np.sin(0.05 * k) + (k // 100) % 2
        rows.append((0.005 * k, *data.qpos, wanted))
        data.ctrl[0] = wanted
        mujoco.mj_step(model, data, 5)
    columns = np.array(rows).T
    np.savez(folder / "log.npz", t=columns[0], q=columns[1], w=columns[2], u=columns[3])
    (folder / "arm.xml").write_text(ARM)
    (folder / "map.yaml").write_text("time: {column: t}\n" + text)
    robot = load_model_joints(folder / "arm.xml")
    mapping = read_mapping(folder / "map.yaml", robot)
    return read_runs([folder / "log.npz"], mapping, lambda share, what: None), robot


@pytest.mark.parametrize("measured", ["pan: {column: q}, wrist: {column: w}", "pan: {column: q}"])
def test_a_velocity_servo(tmp_path: Path, measured: str) -> None:
    """Its gain within a tenth, of one joint alone, too; a motor has none."""
    runs, robot = moved(tmp_path, f"qpos: {{{measured}}}\nctrl: {{pan: {{column: u}}}}")
    drives = {"pan": DriveGuess("velocity"), "wrist": DriveGuess("torque")}
    found = estimate_drives(runs, robot, drives)
    assert found["wrist"] == DriveGuess("torque")
    assert found["pan"].kind == "velocity"
    assert found["pan"].damping == pytest.approx(DAMPING, rel=0.1)
    assert found["pan"].describe() == f"velocity servo with kv {found['pan'].damping:g}"
    assert found["wrist"].describe() == "motor"


def test_gains_that_the_log_does_not_show(tmp_path: Path) -> None:
    """A joint at rest that is commanded to be there: a servo of the usual frequency."""
    runs, robot = moved(tmp_path, "qpos: {wrist: {column: w}, pan: {column: q}}")
    found = estimate_drives(runs, robot, {"wrist": DriveGuess("velocity")})
    usual = float(robot.model.dof_M0[1]) * 2 * np.pi * 5.0
    assert found["wrist"].damping == pytest.approx(usual, rel=1e-2)
    found = estimate_drives(runs, robot, {"wrist": DriveGuess("position")})
    assert found["wrist"].stiffness == pytest.approx(usual * 2 * np.pi * 5.0, rel=1e-2)


GEARED = ARM.replace('<motor name="wrist" joint="wrist"/>', "").replace(
    f'<velocity name="pan" joint="pan" kv="{DAMPING}"/>',
    '<motor name="pan" joint="pan" gear="2"/>',
)


@pytest.mark.parametrize("unit", ["V", "A", "1"])
def test_what_a_volt_is_worth(tmp_path: Path, unit: str) -> None:
    """A motor that the machine drives by 0.7 N m a volt with 0.4 N m s/rad of back EMF."""
    model = mujoco.MjModel.from_xml_string(GEARED)
    data = mujoco.MjData(model)
    rows = []
    for k in range(800):
        told = 1.5 * np.sin(0.05 * k) + (k // 100) % 2
        rows.append((0.005 * k, data.qpos[0], 20 * told))
        for _ in range(5):
            data.ctrl[0] = (0.7 * 20 * told - DAMPING * data.qvel[0]) / 2
            mujoco.mj_step(model, data)
    t, q, u = np.array(rows).T
    np.savez(tmp_path / "log.npz", t=t, q=q, u=u)
    (tmp_path / "arm.xml").write_text(GEARED)
    told = f"{{column: u, unit: {unit!r}}}"
    text = f"time: {{column: t}}\nqpos: {{pan: {{column: q}}}}\nctrl: {{pan: {told}}}"
    (tmp_path / "map.yaml").write_text(text)
    robot = load_model_joints(tmp_path / "arm.xml")
    mapping = read_mapping(tmp_path / "map.yaml", robot)
    runs = read_runs([tmp_path / "log.npz"], mapping, lambda share, what: None)
    (size,) = command_sizes(runs, robot)
    assert size.force == pytest.approx(0.7, rel=0.1)
    assert size.damping == pytest.approx(DAMPING, rel=0.1)
    assert size.factor == pytest.approx(0.35, rel=0.1)
    found = [one for one in check_logs([], runs, mapping, robot) if one.signal == "ctrl.pan"]
    named = [one for one in found if "back EMF" in one.sentence]
    assert len(named) == (0 if unit == "1" else 1)  # 1 may well be newton metres


def test_volts_for_a_servo_are_refused(tmp_path: Path) -> None:
    text = "qpos: {pan: {column: q}}\nctrl: {pan: {column: u, unit: V}}"
    runs, robot = moved(tmp_path, text)
    mapping = read_mapping(tmp_path / "map.yaml", robot)
    errors = [one for one in check_logs([], runs, mapping, robot) if one.level == "error"]
    assert [one.sentence for one in errors] == [
        "its commands are in V, and the model's actuator takes a velocity."
    ]
