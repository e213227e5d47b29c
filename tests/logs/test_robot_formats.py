"""Recordings of other robot projects are read by their documented layouts, written here."""

import json
import struct
from pathlib import Path
from typing import Any
from zlib import crc32

import mujoco
import numpy as np
import pytest

from dropo.core.services.errors import BadFile
from dropo.logs.guessing.guess import guess_mapping
from dropo.logs.readers.crazyflie import CrazyflieLog
from dropo.logs.readers.messages import columns_of, make_getter
from dropo.logs.readers.pace import PaceLog
from dropo.logs.readers.reader import Log, open_log
from dropo.logs.readers.sage import SageLog
from dropo.mjmodel.joints import model_joints
from dropo.testing import check_log_reader

SERVOS = """
<mujoco>
  <worldbody>
    <body name="a"><joint name="pan" axis="0 0 1" range="-100 100"/><geom size="0.1" mass="1"/>
      <body name="b" pos="0 0 0.3"><joint name="lift" axis="0 1 0" range="-100 100"/>
        <geom size="0.1" mass="1"/></body></body>
  </worldbody>
  <actuator><position name="pan" joint="pan" kp="20"/>
    <position name="lift" joint="lift" kp="20"/></actuator>
</mujoco>
"""
N = 60
TIME = np.arange(N) / 50
ANGLES = np.stack([0.8 * np.sin(2 * TIME), 0.5 * np.cos(3 * TIME)], axis=1)
GOALS = np.stack([0.9 * np.sin(2 * TIME + 0.1), 0.6 * np.cos(3 * TIME + 0.1)], axis=1)


def read(log: Log, topic: str | None, columns: list[str]) -> dict[str, Any]:
    return log.read(topic, columns, lambda fraction, text: None)


def mapped(path: Path) -> dict[str, Any]:
    """The mapping that is guessed of a recording."""
    model = model_joints(mujoco.MjModel.from_xml_string(SERVOS))
    found = guess_mapping(open_log(path), model)
    assert found.undecided == []
    return found.mapping


def sage(folder: Path) -> Path:
    """A motion: microseconds, lists in quotes, rows of other types and outside the motion."""
    path = folder / "wave"
    path.mkdir()
    (path / "joint_list.txt").write_text("pan\nlift\n")
    for name, kind, values in (
        ("state_motor", "STATE_MOTOR", ANGLES),
        ("control", "CONTROL", GOALS),
    ):
        lines = ["type,timestamp,positions,velocities,torques"]
        for k in range(N):
            row = ", ".join(repr(float(x)) for x in values[k])
            lines.append(f'{kind},{1_000_000 + 20_000 * k},"[{row}]","[0.0, 0.0]","[1.5, 2.5]"')
        lines.insert(5, f'STATE_BASE,{1_000_000 + 61_000},"[0, 0]","[0, 0]","[0, 0]"')
        (path / f"{name}.csv").write_text("\n".join(lines) + "\n")
    events = "type,timestamp,event\nEVENT,1100000,MOTION_START\nEVENT,1900000,DISABLE\n"
    (path / "event.csv").write_text(events)
    return path


def test_sage(tmp_path: Path) -> None:
    """Columns by joint, stamps in seconds, the motion alone; commands on their own stamps."""
    path = sage(tmp_path)
    log = open_log(path)
    assert isinstance(log, SageLog)
    inside = (TIME >= 0.1 - 1e-9) & (TIME <= 0.9 + 1e-9)
    found = read(log, "state", ["time", "positions[lift]"])
    np.testing.assert_allclose(found["time"], 1 + TIME[inside])
    np.testing.assert_array_equal(found["positions[lift]"], ANGLES[inside, 1])
    found = read(log, "control", ["positions[pan]"])
    np.testing.assert_array_equal(found["positions[pan]"], GOALS[inside, 0])
    check_log_reader(SageLog, path)
    mapping = mapped(path)
    assert mapping["qpos"]["pan"]["column"] == "positions[pan]"
    assert mapping["qpos"]["pan"]["topic"] == "state"
    assert mapping["ctrl"]["lift"] == {
        "column": "positions[lift]",
        "unit": "rad",
        "topic": "control",
    }
    (path / "joint_list.txt").write_text("pan\nlift\njaw\n")
    with pytest.raises(BadFile, match=r"lists of 3 numbers, as joint_list.txt has joints, got 2"):
        open_log(path).columns("state")
    (path / "state_motor.csv").unlink()
    with pytest.raises(BadFile, match=r"state_motor.csv: expected what was measured"):
        open_log(path).topics()


def test_pace(tmp_path: Path) -> None:
    """Tensors of torch; by number, or by joint where the file names them."""
    torch = pytest.importorskip("torch")
    path = tmp_path / "chirp_data.pt"
    content: dict[str, Any] = {
        "time": torch.tensor(TIME),
        "dof_pos": torch.tensor(ANGLES),
        "des_dof_pos": torch.tensor(GOALS),
        "note": "hung",
    }
    torch.save(content, path)
    log = open_log(path)
    assert isinstance(log, PaceLog)
    columns = ["time", "dof_pos[0]", "dof_pos[1]", "des_dof_pos[0]", "des_dof_pos[1]"]
    assert log.columns(None) == columns
    np.testing.assert_array_equal(read(log, None, ["dof_pos[1]"])["dof_pos[1]"], ANGLES[:, 1])
    assert mapped(path)["ctrl"]["lift"]["column"] == "des_dof_pos[1]"
    torch.save(content | {"joint_order": ["lift", "pan"]}, path)
    assert mapped(path)["qpos"]["pan"]["column"] == "dof_pos[pan]"
    check_log_reader(PaceLog, path)
    torch.save({"dof_pos": content["dof_pos"]}, path)
    with pytest.raises(BadFile, match="`time` and `dof_pos` among them, got dof_pos"):
        open_log(path).columns(None)


def crazyflie(path: Path, version: int) -> Path:
    """A log of two kinds of events."""
    names = b"fixed\0" + struct.pack("<H", 2) + b"gyro.x(f)\0pwm.m1(H)\0"
    data = b"\xbc" + struct.pack("<HH", version, 2)
    data += struct.pack("<H", 7) + names
    data += struct.pack("<H", 9) + b"estimator\0" + struct.pack("<H", 1) + b"z(f)\0"
    for k in range(5):
        stamp = struct.pack("<I", 10 * k) if version == 1 else struct.pack("<Q", 10_000 * k)
        data += struct.pack("<H", 7) + stamp + struct.pack("<fH", 0.5 * k, 1000 + k)
        if k % 2 == 0:
            data += struct.pack("<H", 9) + stamp + struct.pack("<f", -k)
    path.write_bytes(data + struct.pack("<I", crc32(data)))
    return path


@pytest.mark.parametrize("version", [1, 2])
def test_crazyflie(tmp_path: Path, version: int) -> None:
    """Both versions: kinds of events are topics, stamps in seconds; a changed byte is noticed."""
    path = crazyflie(tmp_path / "log00", version)
    log = open_log(path)
    assert isinstance(log, CrazyflieLog)
    assert list(log.topics()) == ["fixed", "estimator"]
    found = read(log, "fixed", log.columns("fixed"))
    np.testing.assert_allclose(found["timestamp"], 0.01 * np.arange(5))
    np.testing.assert_array_equal(found["gyro.x"], 0.5 * np.arange(5))
    np.testing.assert_array_equal(found["pwm.m1"], 1000 + np.arange(5))
    np.testing.assert_array_equal(read(log, "estimator", ["z"])["z"], [0, -2, -4])
    check_log_reader(CrazyflieLog, path)
    content = bytearray(path.read_bytes())
    content[-8] ^= 1
    path.write_bytes(bytes(content))
    with pytest.raises(BadFile, match=r"truncated or corrupt file .its last four bytes"):
        open_log(path).topics()


def test_lerobot_3(tmp_path: Path) -> None:
    """Version 3: several episodes in a file, several files in a chunk, names of motors."""
    arrow = pytest.importorskip("pyarrow")
    parquet = pytest.importorskip("pyarrow.parquet")
    folder = tmp_path / "set"
    (folder / "data" / "chunk-000").mkdir(parents=True)
    (folder / "meta" / "episodes" / "chunk-000").mkdir(parents=True)
    names = ["pan.pos", "lift.pos"]
    feature = {"dtype": "float32", "shape": [2], "names": names}
    info = {
        "codebase_version": "v3.0",
        "fps": 50,
        "total_episodes": 3,
        "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
        "features": {"observation.state": feature, "action": feature},
    }
    (folder / "meta" / "info.json").write_text(json.dumps(info))
    episodes = arrow.table({"episode_index": [0, 1, 2], "length": [20, 20, 20]})
    parquet.write_table(episodes, folder / "meta" / "episodes" / "chunk-000" / "file-000.parquet")
    parts = [slice(0, 40), slice(40, 60)]
    for number, part in enumerate(parts):
        rows = np.arange(N)[part]
        table = {
            "observation.state": list(ANGLES[part].astype(np.float32)),
            "action": list(GOALS[part].astype(np.float32)),
            "timestamp": (TIME[rows % 20]).astype(np.float32),
            "frame_index": rows % 20,
            "episode_index": rows // 20,
            "index": rows,
            "task_index": np.zeros(len(rows), dtype=int),
        }
        place = folder / "data" / "chunk-000" / f"file-{number:03d}.parquet"
        parquet.write_table(arrow.table(table), place)
    log = open_log(folder)
    found = read(log, None, ["observation.state[lift.pos]", "episode_index"])
    np.testing.assert_allclose(found["observation.state[lift.pos]"], ANGLES[:, 1], atol=1e-6)
    np.testing.assert_array_equal(found["episode_index"], np.arange(N) // 20)
    mapping = mapped(folder)
    assert mapping["qpos"]["pan"]["column"] == "observation.state[pan.pos]"
    assert mapping["ctrl"]["lift"]["column"] == "action[lift.pos]"
    assert "run" not in mapping


def test_transforms_go_by_their_frames() -> None:
    """A frame's numbers, in whichever place of a message it is; NaN where it is not."""

    def transform(frame: str, x: float) -> dict[str, Any]:
        turn = {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}
        content = {"translation": {"x": x, "y": 0.0, "z": 0.0}, "rotation": turn}
        return {"child_frame_id": frame, "transform": content}

    one = {"transforms": [transform("base_link", 1.0), transform("tool", 2.0)]}
    other = {"transforms": [transform("tool", 3.0)]}
    assert "transforms[tool].transform.translation.x" in columns_of(one)
    getter = make_getter("transforms[tool].transform.translation.x")
    assert (getter(one), getter(other)) == (2.0, 3.0)
    assert np.isnan(make_getter("transforms[base_link].transform.translation.x")(other))


def test_joint_states_and_commands_of_a_bag(tmp_path: Path) -> None:
    """Topics of JointState, commands and an Imu in an MCAP file: joints, commands, base found."""
    writer_module = pytest.importorskip("mcap.writer")
    path = tmp_path / "log.mcap"
    with path.open("wb") as file:
        writer = writer_module.Writer(file)
        writer.start()
        schema = writer.register_schema("any", "jsonschema", b"{}")
        channels = {
            topic: writer.register_channel(topic, "json", schema)
            for topic in ("/joint_states", "/joint_commands", "/imu/data", "/tf")
        }
        for k in range(N):
            stamp = {"sec": 100, "nanosec": round(1e9 * float(TIME[k]))}
            turn = {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}
            messages = {
                "/joint_states": {"name": ["lift", "pan"], "position": ANGLES[k, ::-1].tolist()},
                "/joint_commands": {"name": ["lift", "pan"], "position": GOALS[k, ::-1].tolist()},
                "/imu/data": {"orientation": turn, "angular_velocity": {"x": 0.0, "y": 0, "z": 0}},
            }
            for topic, message in messages.items():
                content = json.dumps({"header": {"stamp": stamp}} | message).encode()
                at = round(1e9 * (100.001 + TIME[k]))
                writer.add_message(channels[topic], at, content, at)
            frames = [{"child_frame_id": ("base", "tool")[k % 2], "transform": {"w": 1.0}}]
            content = json.dumps({"transforms": frames}).encode()
            writer.add_message(channels["/tf"], at, content, at)
        writer.finish()
    mapping = mapped(path)
    assert mapping["qpos"]["pan"]["column"] == "position[pan]"
    assert mapping["qpos"]["pan"]["topic"] == "/joint_states"
    assert mapping["ctrl"]["lift"]["topic"] == "/joint_commands"
    log = open_log(path)
    assert "transforms[tool].transform.w" in log.columns("/tf")
    found = read(log, "/tf", ["transforms[tool].transform.w"])["transforms[tool].transform.w"]
    np.testing.assert_array_equal(np.isnan(found), np.arange(N) % 2 == 0)
