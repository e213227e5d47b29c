"""Columns of IMUs are known by their names, and their units by names, gravity and the motion."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dropo.core.services.errors import BadArgument
from dropo.logs.guessing.guess import guess_mapping
from dropo.logs.readers.reader import open_log
from dropo.logs.starting import Start, init
from dropo.mjmodel.joints import load_model_joints
from tests.models.imu_arm import COLUMNS, IMU, write_logs

ROS = {
    "gyro": "imu.angular_velocity.",
    "acc": "imu.linear_acceleration.",
    "quat": "imu.orientation.",
}
SHORT = {"gyro_": "g", "acc_": "a", "quat_": "q"}


def started(folder: Path, names: Any = None, change: Any = None, sensors: Any = IMU) -> Start:
    """What `init` makes of logs whose columns are called otherwise."""
    logs = write_logs(folder, 3, runs=1, steps=120, sensors=sensors, change=change, names=names)
    return init(folder / "arm.xml", logs, folder / "out")


def counting_in_degrees(shown: dict[str, Any]) -> dict[str, Any]:
    """A gyro in deg/s and an accelerometer in g."""
    gyro, acceleration = np.degrees(shown["imu_gyro"]), shown["imu_acc"] / 9.80665
    return shown | {"imu_gyro": gyro, "imu_acc": acceleration}


def test_names_of_imus(tmp_path: Path) -> None:
    """Plain names, ROS's, and two letters; each guess is a line."""
    for i, names in enumerate(
        [
            None,
            {f"{kind}_{axis}": f"{full}{axis}" for kind, full in ROS.items() for axis in "wxyz"},
            {f"{kind}{axis}": f"{short}{axis}" for kind, short in SHORT.items() for axis in "wxyz"},
        ]
    ):
        folder = tmp_path / str(i)
        folder.mkdir()
        logs = write_logs(folder, 3, runs=1, steps=60, sensors=tuple(COLUMNS), names=names)
        found = guess_mapping(open_log(logs[0]), load_model_joints(folder / "arm.xml"))
        expected = {
            sensor: [(names or {}).get(column, column) for column in columns]
            for sensor, columns in COLUMNS.items()
        }
        guessed = {name: entry["columns"] for name, entry in found.mapping["sensordata"].items()}
        assert guessed == expected
        assert len([line for line in found.lines if line.startswith("sensor: ")]) == 3
        assert not any("not used" in line for line in found.lines)


def test_units_without_a_name(tmp_path: Path) -> None:
    """g by gravity, degrees by the model's own gyro along the motion; both said."""
    found = started(tmp_path, change=counting_in_degrees, sensors=IMU)
    entries = found.mapping["sensordata"]
    assert (entries["imu_gyro"]["unit"], entries["imu_acc"]["unit"]) == ("deg/s", "g")
    assert found.imported.observation[2:] == [f"sensordata.{name}" for name in IMU]
    assert (
        "sensor: imu_gyro is in deg/s, by what the model's own shows along the motion"
        in found.lines
    )


def test_units_by_name(tmp_path: Path) -> None:
    """In words behind the axis."""
    names = {f"gyro_{axis}": f"gyro_{axis}_dps" for axis in "xyz"}
    names |= {f"acc_{axis}": f"acc{axis.upper()} [g]" for axis in "xyz"}
    found = started(tmp_path, names, counting_in_degrees, IMU)
    entries = found.mapping["sensordata"]
    assert (entries["imu_gyro"]["unit"], entries["imu_acc"]["unit"]) == ("deg/s", "g")


def test_a_turned_mount_is_refused(tmp_path: Path) -> None:
    """With the entry to give by --map; nothing is written."""
    upside_down = np.array([1, -1, -1])
    with pytest.raises(BadArgument, match=r"Map `rotation: \[x, -y, -z\]` of all sensors"):
        started(
            tmp_path,
            change=lambda shown: shown | {name: shown[name] * upside_down for name in IMU},
            sensors=IMU,
        )
    assert not (tmp_path / "out").exists()
