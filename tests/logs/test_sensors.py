"""Sensors of the model in logs: mapped, brought to the motion, checked against it, fitted."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from dropo.core.services.errors import InvalidInput
from dropo.logs.importing import Import, import_logs
from dropo.logs.signals.states import with_states
from dropo.problems.loading import load
from tests.models.imu_arm import (
    COLUMNS,
    IMU,
    SD,
    SKIP,
    noisy,
    problem,
    record,
    sensor_map,
    write_logs,
)

ALL = (*IMU, "imu_quat")
TURN = np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 1.0]])
"""From the axes of a log to those of the model: [y, -x, z]."""
Shown = dict[str, Any]


def imported(folder: Path, content: dict[str, Any], **more: Any) -> Import:
    """The import of logs by a mapping."""
    logs = write_logs(folder, **({"sensors": ALL, "runs": 1, "steps": 120} | more))
    (folder / "map.yaml").write_text(yaml.safe_dump(content))
    return import_logs(logs, folder / "map.yaml", folder / "arm.xml", folder / "data.npz")


def refusal(folder: Path, content: dict[str, Any], **more: Any) -> str:
    """Why an import is refused; it writes nothing."""
    with pytest.raises(InvalidInput) as caught:
        imported(folder, content, **more)
    assert not (folder / "data.npz").exists()
    assert not (folder / "problem.yaml").exists()
    return str(caught.value).replace(f"{folder}/", "").removeprefix("run0.csv: ")


def in_mount(shown: Shown) -> Shown:
    """What an IMU shows that is mounted turned."""
    turned = {name: shown[name] @ TURN for name in IMU}
    quaternion = Rotation.from_quat(shown["imu_quat"], scalar_first=True)
    whole = (quaternion * Rotation.from_matrix(TURN)).as_quat(scalar_first=True)
    return shown | turned | {"imu_quat": whole}


def test_an_imu_is_imported(tmp_path: Path) -> None:
    """As items of the observation, with its noise by axis, and no finding; the problem loads."""
    found = imported(tmp_path, sensor_map(*ALL))
    assert found.observation == ["qpos", "qvel", *(f"sensordata.{name}" for name in ALL)]
    assert found.findings == []
    assert not any(delay.removed for delay in found.delays)
    for name in ("imu_gyro", "imu_quat"):
        for i in range(len(COLUMNS[name])):
            assert 0.7 < (found.noise[f"sensordata.{name}[{i}]"].sd or 0) / SD[name] < 1.6
    loaded = load(tmp_path / "problem.yaml")
    assert [one.unit for one in loaded.simulator.signals[4:]] == ["rad/s"] * 3 + ["m/s^2"] * 3 + [
        "rad"
    ] * 3
    assert set(loaded.estimated) == {"qvel.yaw", "qvel.pitch"}


def test_units_signs_and_mounts_are_mapped(tmp_path: Path) -> None:
    """Degrees, g, another sign and a turned mount give the numbers that the plain log gives."""
    plain = imported(tmp_path, sensor_map(*ALL)).arrays["observations"]

    def change(shown: Shown) -> Shown:
        turned = in_mount(shown)
        gyro, acceleration = np.degrees(turned["imu_gyro"]), -turned["imu_acc"] / 9.80665
        return turned | {"imu_gyro": gyro, "imu_acc": acceleration}

    content = sensor_map(*ALL, rotation=["y", "-x", "z"])
    content["sensordata"]["imu_gyro"] |= {"unit": "deg/s"}
    content["sensordata"]["imu_acc"] |= {"unit": "g", "sign": -1}
    other = imported(tmp_path, content, change=change).arrays["observations"]
    plain[:, 10:] /= np.linalg.norm(plain[:, 10:], axis=1, keepdims=True)
    np.testing.assert_allclose(other, plain, atol=1e-6)
    quaternion = Rotation.from_matrix(TURN).as_quat(scalar_first=True).tolist()
    for entry in content["sensordata"].values():
        entry["rotation"] = quaternion
    again = imported(tmp_path, content, change=change).arrays["observations"]
    np.testing.assert_allclose(again, plain, atol=1e-6)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (
            lambda shown: shown | {"imu_gyro": np.degrees(shown["imu_gyro"])},
            "its numbers are in deg/s, not rad/s. Map `unit: deg/s`.",
        ),
        (
            lambda shown: shown | {"imu_acc": shown["imu_acc"] / 9.80665},
            "its numbers are in g, not m/s^2. Map `unit: g`.",
        ),
        (
            lambda shown: shown | {"imu_gyro": -shown["imu_gyro"]},
            "the sign of sensordata.imu_gyro is the other one. Map `sign: -1` of "
            "sensordata.imu_gyro.",
        ),
        (
            in_mount,
            "its mount is turned by 90 degrees. Map `rotation: [y, -x, z]` of all sensors of this "
            "mount.",
        ),
        (
            lambda shown: shown | {"imu_quat": np.roll(shown["imu_quat"], -1, axis=1)},
            "its quaternion is in the order x, y, z, w, by how the model turns along the motion. "
            "Map the four columns in the order w, x, y, z.",
        ),
        (
            lambda shown: (
                shown
                | {
                    "imu_quat": (
                        Rotation.from_euler("z", 1.0)
                        * Rotation.from_quat(shown["imu_quat"], scalar_first=True)
                    ).as_quat(scalar_first=True)
                }
            ),
            "it is measured from a world that is turned by 57 degrees about [0.00, 0.00, 1.00] "
            "against the model's. Turn the orientations into the model's world first, or leave the "
            "sensor out.",
        ),
    ],
    ids=["degrees", "g", "sign", "mount", "order", "north"],
)
def test_what_the_motion_contradicts(tmp_path: Path, change: Any, told: str) -> None:
    """Each is refused in a sentence that says which mapping to write."""
    found = refusal(tmp_path, sensor_map(*ALL), change=change)
    assert found.replace("-0.00", "0.00").endswith(told)


def test_a_tilted_mount_is_told(tmp_path: Path) -> None:
    """A warning gives the quaternion; mapped, nothing is left to say."""
    tilt = Rotation.from_euler("xy", [20, 10], degrees=True)

    def change(shown: Shown) -> Shown:
        return shown | {name: shown[name] @ tilt.as_matrix() for name in IMU}

    (finding,) = imported(tmp_path, sensor_map(*IMU), change=change, sensors=IMU).findings
    assert finding.level == "warning"
    assert "it stands turned by 22 degrees" in finding.sentence
    advised = yaml.safe_load(finding.advice.split("`")[1])["rotation"]
    np.testing.assert_allclose(advised, tilt.as_quat(scalar_first=True), atol=0.02)
    assert (
        imported(tmp_path, sensor_map(*IMU, rotation=advised), change=change, sensors=IMU).findings
        == []
    )


@pytest.mark.parametrize(
    ("name", "entry", "told"),
    [
        (
            "imu_gyr",
            {},
            "sensordata.imu_gyr: expected the name of a sensor of the model (the nearest is "
            "'imu_gyro')",
        ),
        ("imu_gyro", {"unit": "g"}, "sensordata.imu_gyro.unit: expected a unit"),
        (
            "imu_gyro",
            {"columns": ["gyro_x"]},
            "sensordata.imu_gyro.columns: expected 3 columns, got 1",
        ),
        (
            "imu_gyro",
            {"rotation": ["y", "x", "z"]},
            "sensordata.imu_gyro.rotation: expected a quaternion w, x, y, z",
        ),
    ],
)
def test_a_mapping_that_the_model_contradicts(
    tmp_path: Path, name: str, entry: Any, told: str
) -> None:
    """Each names the key, and the nearest sensor."""
    content = sensor_map("imu_gyro")
    content["sensordata"] = {name: content["sensordata"]["imu_gyro"] | entry}
    assert told in refusal(tmp_path, content)


def test_what_is_not_mapped_is_told(tmp_path: Path) -> None:
    """Columns of a sensor that the model has, and of one that it lacks, as information."""
    content = sensor_map("imu_gyro")
    found = imported(tmp_path, content, sensors=IMU).findings
    assert [(one.level, one.signal) for one in found] == [("information", "sensordata.imu_acc")]
    assert "'acc_x', 'acc_y', 'acc_z' are not mapped" in found[0].sentence
    logs = write_logs(tmp_path, runs=1, steps=100)
    text = (
        (tmp_path / "arm.xml").read_text().replace('<accelerometer name="imu_acc" site="imu"/>', "")
    )
    (tmp_path / "arm.xml").write_text(text)
    (finding,) = import_logs(
        logs, tmp_path / "map.yaml", tmp_path / "arm.xml", tmp_path / "data.npz"
    ).findings
    assert "the model no accelerometer that has a name" in finding.sentence


def test_lost_packets_of_one_sensor(tmp_path: Path) -> None:
    """Values that are missing at random are refused; every third row is a rate of its own."""

    def lose(shown: Shown) -> Shown:
        lost = np.random.default_rng(1).random(len(shown["imu_gyro"])) < 0.3
        return shown | {"imu_gyro": np.where(lost[:, None], np.nan, shown["imu_gyro"])}

    def thin(shown: Shown) -> Shown:
        rest = np.arange(len(shown["imu_gyro"])) % 3 > 0
        return shown | {"imu_gyro": np.where(rest[:, None], np.nan, shown["imu_gyro"])}

    content = sensor_map(*ALL)
    assert "packets were lost" in refusal(tmp_path, content, change=lose)
    assert imported(tmp_path, content, change=thin).findings == []


def test_a_late_sensor(tmp_path: Path) -> None:
    """7 ms are found within 3 of their errors and half a millisecond, and taken off."""

    def late(shown: Shown) -> Shown:
        time = 0.01 * np.arange(len(shown["imu_gyro"]))
        moved = {}
        for name in ("imu_gyro", "imu_quat"):
            columns = [np.interp(time - 7e-3, time, column) for column in shown[name].T]
            moved[name] = np.stack(columns, axis=1)
        return shown | moved

    found = imported(tmp_path, sensor_map("imu_gyro", "imu_quat"), change=late, steps=300)
    assert len(found.delays) == 2
    for delay in found.delays:
        assert delay.removed
        assert abs(delay.seconds - 7e-3) < 3 * delay.se + 5e-4


def test_a_clock_of_its_own(tmp_path: Path) -> None:
    """An IMU at its own rate in a file of its own, 12 s off: its rows come to the joints'."""
    rng = np.random.default_rng(5)
    run = record(rng, 300)
    angles, shown = noisy(run, rng)
    slow = np.arange(0, len(run.time), SKIP)
    log = np.column_stack([run.time, angles, run.commands])[slow]
    names = "t,q_yaw,q_pitch,tau_yaw,tau_pitch"
    np.savetxt(tmp_path / "a.csv", log, delimiter=",", header=names, comments="")
    imu = np.column_stack([run.time + 12, *(shown[name] for name in IMU)])
    names = ",".join(["ts", *COLUMNS["imu_gyro"], *COLUMNS["imu_acc"]])
    np.savetxt(tmp_path / "a_imu.csv", imu, delimiter=",", header=names, comments="")
    write_logs(tmp_path, runs=0)
    content = sensor_map(*IMU, file="{stem}_imu.csv", clock={"column": "ts"})
    (tmp_path / "map.yaml").write_text(yaml.safe_dump(content))
    found = import_logs(
        tmp_path / "a.csv", tmp_path / "map.yaml", tmp_path / "arm.xml", tmp_path / "data.npz"
    )
    (clock,) = [delay for delay in found.delays if delay.run is not None]
    assert abs(clock.seconds - 12) < 4 * clock.se
    assert clock.se < 2e-3
    shown_there = found.arrays["observations"][10:250, 4:7]
    at = found.arrays["time"][10:250]
    columns = [np.interp(at, run.time, column) for column in run.sensors["imu_gyro"].T]
    true = np.stack(columns, axis=1)
    assert np.sqrt(np.mean((shown_there - true) ** 2)) < 0.1 < np.std(true)


def test_states_are_estimated_with_an_imu() -> None:
    """Velocities come ten times nearer to the IMU than the smoother's; the IMU's columns stay."""
    log = problem(1, runs=1, steps=40)
    estimated, found = with_states(log, list(log.estimated))
    sizes = found.to_json()["signals"]
    assert sizes["qvel.pitch"]["measured_sd"] is None
    assert sizes["qvel.pitch"]["state_sd"] < 0.3 * log.estimated["qvel.pitch"]
    imu = slice(2, 8)
    before, after = log.trajectories, estimated.trajectories
    np.testing.assert_array_equal(after.observations[:, imu], before.observations[:, imu])
    assert not np.array_equal(after.observations[:, :2], before.observations[:, :2])
