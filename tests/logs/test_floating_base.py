"""The base of a machine on legs, whose pose nobody logged."""

import re
from dataclasses import replace
from functools import cache
from pathlib import Path

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dropo.core.contracts.problem import Problem
from dropo.core.services.errors import Incompatible
from dropo.diagnosis.regression.quick import QuickDiagnose
from dropo.estimators.dropo import DROPO
from dropo.estimators.support.common_errors import common_coordinates
from dropo.logs.floating_base import missing_for_base
from dropo.logs.signals.base_motion import BaseMotion, estimate_base, imu_of
from dropo.logs.signals.velocities import estimate_velocities
from dropo.logs.starting import InitResult, init
from dropo.mjmodel.joints import model_joints
from dropo.problems.loading import load
from dropo.problems.simulated.example_quadruped import (
    MODEL,
    WALK,
    WalkLog,
    walked,
    write_quadruped,
)

SHORT = replace(WALK, seconds=3.0, imu=True)
TRUE = replace(SHORT, position=0.0, rotation=0.0)
"""The pose of such a log, which its text leaves out, is the true one."""


@cache
def log_of(seed: int) -> WalkLog:
    """A walk with an IMU."""
    return walked(np.random.default_rng(seed), TRUE)


def estimated(log: WalkLog, imu: np.ndarray) -> BaseMotion:
    """The motion of the base by angles and an IMU."""
    robot = model_joints(mujoco.MjModel.from_xml_string(MODEL))
    smooth = estimate_velocities(log.time, log.angles)
    n = len(log.time)
    positions = np.concatenate([np.zeros((n, 7)), smooth.positions], axis=1)
    velocities = np.concatenate([np.zeros((n, 6)), smooth.velocities], axis=1)
    sensors = robot.sensors
    seen = imu_of(robot, sensors["gyro"], sensors["acc"], imu[:, :3], imu[:, 3:])
    assert seen is not None
    noise = float(smooth.velocity_noise.mean())
    return estimate_base(robot, log.time, positions, velocities, noise, seen)


def test_the_base_moves_as_it_did() -> None:
    """Height, inclination and velocity of the trunk are within three stated errors of the truth,
    root mean squares of a walk whose feet slide; feet stand most of the time.
    """
    log = log_of(7)
    assert log.imu is not None
    found = estimated(log, log.imu)
    truth = Rotation.from_quat(log.pose[:, 3:], scalar_first=True)
    turns = Rotation.from_quat(found.positions[:, 3:], scalar_first=True)
    up = np.array([0, 0, 1.0])
    inclination = turns.inv().apply(up) - truth.inv().apply(up)
    speeds = turns.inv().apply(found.velocities[:, :3]) - truth.inv().apply(log.speeds[:, :3])
    height = found.positions[:, 2] - log.pose[:, 2]
    assert np.sqrt(np.mean(height**2)) < 3 * found.position_sd[2] < 0.003
    assert np.sqrt(np.mean(inclination[:, :2] ** 2)) < 3 * found.position_sd[3] < 0.01
    assert (np.sqrt(np.mean(speeds**2, axis=0)) < 3 * found.velocity_sd[:3]).all()
    assert (found.velocity_sd[:3] < 0.03).all()
    assert found.standing > 0.7


@pytest.mark.parametrize(
    "turn",
    [[0, 0, np.pi / 2], [np.pi, 0, 0]],
)
def test_an_imu_that_is_mounted_otherwise(turn: list[float]) -> None:
    """Feet hardly ever stand where the IMU's axes are not those of the model."""
    log = log_of(7)
    assert log.imu is not None
    turned = Rotation.from_rotvec(turn)
    imu = np.concatenate([turned.apply(log.imu[:, :3]), turned.apply(log.imu[:, 3:])], axis=1)
    assert estimated(log, imu).standing < 0.4


def test_an_imu_that_is_far_askew() -> None:
    """Turned by 0.25 rad, half of the feet are so high that they would count as flying: the bias is
    found all the same, within a tenth, and the feet stand.
    """
    log = log_of(7)
    assert log.imu is not None
    turned = Rotation.from_rotvec([0, -0.25, 0])
    imu = np.concatenate([turned.apply(log.imu[:, :3]), turned.apply(log.imu[:, 3:])], axis=1)
    found = estimated(log, imu)
    assert abs(found.bias[3] / (-9.81 * np.sin(0.25)) - 1) < 0.1
    assert found.footholds > 1.2


WHEEL = """<body name="w{0}" pos="{1} {2} 0"><joint name="w{0}" axis="0 1 0" armature="0.001"/>
  <geom type="sphere" size="0.1" mass="0.3"/></body>"""
PLACES = ((0.2, 0.15), (0.2, -0.15), (-0.2, 0.15), (-0.2, -0.15))
WHEELS = "".join(WHEEL.format(i, x, y) for i, (x, y) in enumerate(PLACES))
DRIVES = "".join(f'<velocity name="w{i}" joint="w{i}" kv="0.5"/>' for i in range(4))
CAR = f"""<mujoco><option timestep="0.002"/><worldbody><geom type="plane" size="9 9 0.1"/>
  <body name="car" pos="0 0 0.1"><freejoint name="root"/>
    <geom type="box" size="0.25 0.1 0.05" mass="5" contype="0" conaffinity="0"/>
    <site name="imu" pos="0 0 0.05"/>{WHEELS}</body></worldbody><actuator>{DRIVES}</actuator>
  <sensor><gyro name="gyro" site="imu"/><accelerometer name="acc" site="imu"/></sensor></mujoco>"""


def test_a_machine_on_wheels() -> None:
    """A wheel that rolls stands where it touches: a car's velocity is known to 0.01 m/s."""
    model = mujoco.MjModel.from_xml_string(CAR)
    data = mujoco.MjData(model)
    rng = np.random.default_rng(0)
    rows = []
    for k in range(300):
        mujoco.mj_forward(model, data)
        rows.append(np.concatenate([data.qpos, data.qvel, data.sensordata]))
        data.ctrl[:] = 4 * np.sin(0.03 * k)
        mujoco.mj_step(model, data, 5)
    table = np.array(rows)
    time = np.asarray(0.01 * np.arange(300), dtype=np.float64)
    smooth = estimate_velocities(time, table[:, 7:11] + 1e-3 * rng.normal(size=(300, 4)))
    positions = np.concatenate([np.zeros((300, 7)), smooth.positions], axis=1)
    velocities = np.concatenate([np.zeros((300, 6)), smooth.velocities], axis=1)
    robot = model_joints(model)
    shown = table[:, -6:] + np.repeat([0.01, 0.1], 3) * rng.normal(size=(300, 6))
    sensors = robot.sensors
    seen = imu_of(robot, sensors["gyro"], sensors["acc"], shown[:, :3], shown[:, 3:])
    assert seen is not None
    found = estimate_base(robot, time, positions, velocities, 0.05, seen)
    error = found.velocities[:, 0] - table[:, 11]
    assert np.sqrt(np.mean(error**2)) < 0.01 < 0.1 * table[:, 11].std()
    assert found.standing > 0.99


def started(folder: Path, tilt: float = 0.0) -> tuple[InitResult, Problem]:
    """What `dropo init` makes of two logs, and the problem."""
    paths = write_quadruped(folder, 2, seed=11, walk=replace(SHORT, tilt=tilt))
    start = init(paths[0], paths[1:], folder / "out")
    return start, load(folder / "out" / "problem.yaml", threads=1)


def test_init_estimates_the_base(tmp_path: Path) -> None:
    """Its pose and velocity are in the data and declared as estimated, and a note says so."""
    start, problem = started(tmp_path)
    names = {signal.name for signal in problem.simulator.signals}
    own = {name for name in names if ".base" in name}
    assert len(own) == 12
    assert own <= set(problem.estimated)
    assert "sensordata.gyro[0]" in names - set(problem.estimated)
    assert any("The pose of base is not logged" in note for note in start.imported.notes)
    assert not start.imported.findings
    places = [signal.name for signal in problem.simulator.signals]
    common = {places[i] for i in common_coordinates(problem)}
    assert common == own
    assert common_coordinates(replace(problem, estimated={"qvel.base[0]": 0.01})) == {}
    file = tmp_path / "out" / "problem.yaml"
    entries = [line[2:] for line in file.read_text().splitlines() if "contact_friction:" in line]
    file.write_text(file.read_text() + "\n".join(["parameters:", *entries]) + "\n")
    assert load(file, threads=1).space.names == ("contact_friction",)


def test_an_imu_askew_is_found(tmp_path: Path) -> None:
    """One that is mounted askew by 0.1 rad shows gravity where the feet say that there is none."""
    start, _ = started(tmp_path, tilt=0.1)
    said = [finding for finding in start.imported.findings if finding.level == "warning"]
    assert [finding.signal for finding in said] == ["acc"]
    angle = re.search(r"mounted askew by ([\d.]+) rad", said[0].sentence)
    assert angle is not None
    assert abs(float(angle[1]) - 0.1) < 0.02


def test_without_an_imu_nothing_is_fitted(tmp_path: Path) -> None:
    """Angles alone: the line of `init` says what is missing, fit and diagnosis refuse."""
    paths = write_quadruped(tmp_path, 1, seed=11, walk=SHORT)
    lines = paths[1].read_text().splitlines()
    kept = [",".join([*line.split(",")[:1], *line.split(",")[7:]]) for line in lines]
    paths[1].write_text("\n".join(kept) + "\n")
    start = init(paths[0], paths[1:], tmp_path / "out")
    assert any("none can be estimated without the model's gyro" in line for line in start.lines)
    file = tmp_path / "out" / "problem.yaml"
    mass = "{field: body_mass, name: trunk, low: 2.5, high: 12, unit: kg}"
    file.write_text(file.read_text() + f"\nparameters:\n  trunk: {mass}\n")
    problem = load(file, threads=1)
    for run in (DROPO().fit, QuickDiagnose().run):
        with pytest.raises(Incompatible, match="The pose of the base 'base' is not in the data"):
            run(problem)


def test_what_is_missing_is_named() -> None:
    """The sensor, the joint and the ground."""
    robot = model_joints(mujoco.MjModel.from_xml_string(MODEL))
    every = [name for name in robot.joints if name != "base"]
    assert missing_for_base(robot, every, ["gyro", "acc"]) == ()
    assert missing_for_base(robot, every, ["gyro"]) == (
        "the model's accelerometer on a site of the base, in the log",
    )
    assert missing_for_base(robot, every[1:], ["gyro", "acc"]) == ("the angle of FR_abduction",)
