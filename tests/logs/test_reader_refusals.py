"""What log readers refuse, each with file, place and what was got; and their rarer layouts."""

import json
import sqlite3
import struct
from pathlib import Path
from typing import Any
from zlib import crc32

import numpy as np
import pytest

from dropo.core.services.errors import BadFile
from dropo.logs.readers.archives import NpzLog, RunsLog
from dropo.logs.readers.bags import McapLog, RosLog
from dropo.logs.readers.crazyflie import CrazyflieLog
from dropo.logs.readers.reader import Log, open_log
from dropo.logs.readers.sage import SageLog
from dropo.logs.readers.tables import CsvLog, ParquetLog


def read(log: Log, topic: str | None, columns: list[str]) -> dict[str, Any]:
    return log.read(topic, columns, lambda fraction, text: None)


@pytest.mark.parametrize(
    ("content", "told"),
    [
        (b"t,q\n0,1\n1\n", "line 3: "),
        (b"t,\xff\n0,1\n", r"byte 2: .*no text"),
        (b"t,q\n0,1\n1,\xff\n", r"byte 10: .*no text"),
        (b"t,q,t\n0,1,2\n", "line 1: expected every column's name once, got 't' twice"),
        (b"0,1\n1,2\n", "line 1: expected the names of the columns, got numbers"),
        (b"0,0\n1,2\n", "line 1: expected the names of the columns, got numbers"),
        (b"t,q\n", "line 2: expected rows below the names, got none"),
        (b"t,q\n0,1\n1,on\n", "line 3, column 'q': expected a number, got 'on'"),
        (b't,q\n0,"[1, 2]"\n\n1,"[3]"\n', r"line 4, column 'q\[1\]': expected a list as long"),
    ],
)
def test_tables_of_text(tmp_path: Path, content: bytes, told: str) -> None:
    """The line and column, or the byte, where a table ends to be one."""
    path = tmp_path / "log.csv"
    path.write_bytes(content)
    with pytest.raises(BadFile, match=rf"log.csv: {told}"):
        read(CsvLog(path), None, CsvLog(path).columns(None))


def test_numbers_with_a_comma_in_them(tmp_path: Path) -> None:
    """As tables of some countries have them, where something else separates the columns."""
    path = tmp_path / "log.csv"
    path.write_text("t;q;run\n0;1,5;a\n0,01;-2,25;b,c\n")
    found = read(CsvLog(path), None, ["t", "q", "run"])
    assert found["t"].tolist() == [0.0, 0.01]
    assert found["q"].tolist() == [1.5, -2.25]
    assert found["run"].tolist() == ["a", "b,c"]


def test_lists_may_be_empty(tmp_path: Path) -> None:
    """A row without a list has NaN in each of its columns, as a cell without a number has."""
    path = tmp_path / "log.csv"
    path.write_text('t,q,note\n0,"[1, 2]",NULL\n1,,3\n2,"[5 6]",\n')
    found = read(CsvLog(path), None, ["q[1]", "note", "t"])
    np.testing.assert_array_equal(found["q[1]"], [2, np.nan, 6])
    np.testing.assert_array_equal(found["note"], [np.nan, 3, np.nan])


def test_tables_of_parquet(tmp_path: Path) -> None:
    """Another file's first bytes, a broken table of contents; a table without rows has columns."""
    arrow = pytest.importorskip("pyarrow")
    parquet = pytest.importorskip("pyarrow.parquet")
    path = tmp_path / "log.parquet"
    path.write_bytes(b"t,q\n0,1\n")
    with pytest.raises(BadFile, match=r"byte 0: expected a Parquet file, which begins with b'PAR1"):
        ParquetLog(path).columns(None)
    path.write_bytes(b"PAR1" + bytes(40) + b"PAR1")
    with pytest.raises(BadFile, match="byte 48: expected a Parquet file"):
        ParquetLog(path).columns(None)
    empty = arrow.table({"t": arrow.array([], arrow.float64()), "q": arrow.array([], "int32")})
    parquet.write_table(empty, path)
    assert ParquetLog(path).columns(None) == ["t", "q"]


def crazyflie(path: Path, version: int, kinds: bytes, events: bytes, count: int = 1) -> Path:
    data = b"\xbc" + struct.pack("<HH", version, count) + kinds + events
    path.write_bytes(data + struct.pack("<I", crc32(data)))
    return path


def kind(number: int, name: bytes, *variables: bytes) -> bytes:
    fields = b"".join(one + b"\0" for one in variables)
    return struct.pack("<H", number) + name + b"\0" + struct.pack("<H", len(variables)) + fields


@pytest.mark.parametrize(
    ("version", "kinds", "events", "told"),
    [
        (3, kind(7, b"fixed"), b"", "byte 1: expected version 1 or 2, got 3"),
        (1, kind(7, b"fixed", b"x(?)"), b"", "its header: "),
        (1, b"\7\0fixed", b"", "its header: "),
        (1, kind(7, b"fixed", b"x(f)"), b"\x08\0" + bytes(8), "an event of the unknown kind 8"),
        (1, kind(7, b"fixed", b"x(f)"), b"\x07\0" + bytes(4), "or one that is cut off"),
    ],
)
def test_memory_cards(tmp_path: Path, version: int, kinds: bytes, events: bytes, told: str) -> None:
    """Another version, a letter that is none, a header or an event that is cut off."""
    path = crazyflie(tmp_path / "log00", version, kinds, events)
    with pytest.raises(BadFile, match=told):
        CrazyflieLog(path).topics()


def test_kinds_of_events_are_named(tmp_path: Path) -> None:
    """One kind needs no name; of several, and of a wrong name, those that there are are listed."""
    path = tmp_path / "log00"
    path.write_bytes(b"t,q\n")
    with pytest.raises(BadFile, match=r"which begins with b'\\xbc', got b't'"):
        CrazyflieLog(path).topics()
    event = b"\x07\0" + struct.pack("<If", 20, 1.5)
    log = CrazyflieLog(crazyflie(path, 1, kind(7, b"fixed", b"x(f)"), event))
    np.testing.assert_allclose(read(log, None, ["timestamp", "x"])["timestamp"], [0.02])
    two = kind(7, b"fixed", b"x(f)") + kind(8, b"other", b"y(f)")
    both = event + b"\x08\0" + struct.pack("<If", 20, 1.5)
    log = CrazyflieLog(crazyflie(path, 1, two, both, count=2))
    assert log.stamps("other") == "timestamp"
    with pytest.raises(BadFile, match="one of its kinds of events: fixed, other, got none"):
        log.columns(None)
    with pytest.raises(BadFile, match="one of its kinds of events: fixed, other, got 'third'"):
        log.columns("third")


def test_motions_of_sage(tmp_path: Path) -> None:
    """A folder without names of joints, a table without stamps, a topic that is none; without
    events all rows count, in seconds where they are a simulation's.
    """
    path = tmp_path / "wave"
    path.mkdir()
    state = path / "state_motor.csv"
    state.write_text('time,positions\n0,"[1]"\n')
    log = SageLog(path)
    with pytest.raises(BadFile, match="line 1: expected a column 'timestamp', got time, positions"):
        log.columns("state")
    rows = "".join(f'{0.02 * k:.2f},"[{k}]"\n' for k in range(5))
    state.write_text("timestamp,positions\n" + rows)
    with pytest.raises(BadFile, match=r"joint_list\.txt: expected a joint's name in every line"):
        SageLog(path).columns("state")
    (path / "joint_list.txt").write_text("pan\n\n")
    found = read(SageLog(path), "state", ["time", "positions[pan]"])
    np.testing.assert_allclose(found["time"], 0.02 * np.arange(5))
    np.testing.assert_array_equal(found["positions[pan]"], np.arange(5))
    assert SageLog(path).stamps("state") == "time"
    for topic, got in ((None, "none"), ("control", "'control'")):
        with pytest.raises(BadFile, match=f"topic: expected one of its tables: state, got {got}"):
            SageLog(path).columns(topic)


def test_archives_of_runs(tmp_path: Path) -> None:
    """A name for each run, columns of one length in each."""
    path = tmp_path / "runs.npz"
    arrays = {"000/time": np.arange(3.0), "000/q": np.arange(3.0), "001/time": np.arange(4.0)}
    np.savez(path, names=np.array(["a"]), **arrays)
    with pytest.raises(BadFile, match="names: expected a name for each of the 2 runs, got 1"):
        RunsLog(path).columns(None)
    np.savez(path, **arrays)
    found = read(RunsLog(path), None, ["run", "q"])
    assert found["run"].tolist() == ["000"] * 3 + ["001"] * 4
    np.testing.assert_array_equal(found["q"], [0, 1, 2, *[np.nan] * 4])
    np.savez(path, **(arrays | {"001/q": np.arange(2.0)}))
    with pytest.raises(BadFile, match="001: expected arrays of one length, got time of 4, q of 2"):
        RunsLog(path).columns(None)
    path.write_bytes(b"PK\3\4" + bytes(30))
    with pytest.raises(BadFile, match=r"runs\.npz"):
        NpzLog(path).columns(None)


def mcap(path: Path, encoding: str, messages: list[bytes], schema: str = "jsonschema") -> Path:
    """An MCAP file of one topic."""
    writer_module = pytest.importorskip("mcap.writer")
    with path.open("wb") as file:
        writer = writer_module.Writer(file)
        writer.start()
        known = writer.register_schema("thing/Thing", schema, b"")
        channel = writer.register_channel("/thing", encoding, known)
        for k, content in enumerate(messages):
            writer.add_message(channel, 1000 * (k + 1), content, 0)
        writer.finish()
    return path


def test_recorded_messages(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Another file, an encoding that is not read, messages that are none, a topic without any; many
    messages are read in blocks.
    """
    path = tmp_path / "log.mcap"
    path.write_bytes(b"t,q\n" + bytes(20))
    with pytest.raises(BadFile, match="byte 0: expected an MCAP file, which begins with"):
        McapLog(path).topics()
    with pytest.raises(BadFile, match=r"messages in an encoding that is read.*got 'protobuf' with"):
        McapLog(mcap(path, "protobuf", [b"1"])).columns("/thing")
    with pytest.raises(BadFile, match=r"/thing, byte \d+: .*JSONDecodeError"):
        McapLog(mcap(path, "json", [b"{"])).columns(None)
    with pytest.raises(BadFile, match="/thing: expected at least one message, got none"):
        McapLog(mcap(path, "json", [])).columns("/thing")
    whole = mcap(path, "json", [b"{}"]).read_bytes()
    path.write_bytes(whole[:8] + bytes(len(whole) - 16) + whole[-8:])
    with pytest.raises(BadFile, match="truncated or corrupt"):
        McapLog(path).topics()
    monkeypatch.setattr("dropo.logs.readers.bags.BLOCK", 3)
    log = McapLog(mcap(path, "json", [json.dumps({"x": k}).encode() for k in range(8)]))
    shares: list[float] = []
    found = log.read("/thing", ["log_time", "x"], lambda share, text: shares.append(share))
    np.testing.assert_array_equal(found["x"], np.arange(8))
    assert log.stamps("/thing") == "log_time"
    assert (np.diff(found["log_time"]).astype(int) == 1000).all()
    assert shares == pytest.approx([2 / 7, 5 / 7])


def test_bags_that_are_none(tmp_path: Path) -> None:
    """A folder, or a file of SQLite, without a bag in it; an MCAP file as anything else."""
    pytest.importorskip("rosbags")
    path = tmp_path / "log"
    path.mkdir()
    with sqlite3.connect(path / "log_0.db3"):
        pass
    for place in (path, path / "log_0.db3"):
        with pytest.raises(BadFile, match=r"expected a ROS bag|truncated or corrupt"):
            RosLog(place).topics()
    (tmp_path / "log.bag").write_bytes(b"#ROSBAG V2.0\n" + bytes(10))
    with pytest.raises(BadFile, match="of 23 bytes"):
        open_log(tmp_path / "log.bag").topics()
