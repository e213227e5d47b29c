"""Columns of IMUs are known by their names, and their units by names, gravity and the motion."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dropo.core.services.errors import BadArgument
from dropo.logs.guessing.guess import guess_mapping
from dropo.logs.readers.reader import open_log
from dropo.logs.starting import InitResult, init
from dropo.mjmodel.joints import load_model_joints
from tests.models.imu_arm import COLUMNS, IMU, SKIP, noisy, record, write_logs

ROS = {
    "gyro": "imu.angular_velocity.",
    "acc": "imu.linear_acceleration.",
    "quat": "imu.orientation.",
}
SHORT = {"gyro_": "g", "acc_": "a", "quat_": "q"}


def started(folder: Path, names: Any = None, change: Any = None, sensors: Any = IMU) -> InitResult:
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


def test_imu_messages_of_ros(tmp_path: Path) -> None:
    """JointState and Imu in one bag, the IMU twice as often: all is mapped, by topic, and imported
    whole.
    """
    pytest.importorskip("rosbags")
    from rosbags import rosbag2
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    of_joints, of_imu = "sensor_msgs/msg/JointState", "sensor_msgs/msg/Imu"
    kinds = ("std_msgs/msg/Header", "builtin_interfaces/msg/Time", "geometry_msgs/msg/Vector3")
    header, time, vector = (store.types[kind] for kind in kinds)
    quaternion = store.types["geometry_msgs/msg/Quaternion"]
    rng = np.random.default_rng(3)
    run = record(rng, 120)
    angles, shown = noisy(run, rng)
    write_logs(tmp_path, runs=0)
    unknown = np.zeros(9)
    with rosbag2.Writer(tmp_path / "bag", version=9) as writer:
        joints = writer.add_connection("/joint_states", of_joints, typestore=store)
        imu = writer.add_connection("/wrist/imu", of_imu, typestore=store)
        for i, at in enumerate(run.time):
            stamp = 10**9 + round(1e9 * float(at))
            head = header(stamp=time(sec=stamp // 10**9, nanosec=stamp % 10**9), frame_id="")
            w, x, y, z = shown["imu_quat"][i].tolist()
            message = store.types[of_imu](
                header=head,
                orientation=quaternion(x=x, y=y, z=z, w=w),
                orientation_covariance=unknown,
                angular_velocity=vector(*shown["imu_gyro"][i].tolist()),
                angular_velocity_covariance=unknown,
                linear_acceleration=vector(*shown["imu_acc"][i].tolist()),
                linear_acceleration_covariance=unknown,
            )
            writer.write(imu, stamp, store.serialize_cdr(message, of_imu))
            if i % SKIP == 0:
                state = store.types[of_joints](
                    header=head,
                    name=["yaw", "pitch"],
                    position=angles[i],
                    velocity=np.zeros(0),
                    effort=run.commands[i],
                )
                writer.write(joints, stamp, store.serialize_cdr(state, of_joints))
    found = init(tmp_path / "arm.xml", tmp_path / "bag", tmp_path / "out")
    entries = found.mapping["sensordata"]
    assert {entry["topic"] for entry in entries.values()} == {"/wrist/imu"}
    assert entries["imu_quat"]["columns"] == [f"orientation.{axis}" for axis in "wxyz"]
    assert entries["imu_gyro"]["columns"] == [f"angular_velocity.{axis}" for axis in "xyz"]
    assert found.imported.observation[2:] == [f"sensordata.{name}" for name in COLUMNS]
    assert found.imported.findings == []
    assert len(found.imported.arrays["observations"]) > 110
