"""Every kind of log gives the same numbers, and a truncated or corrupt one is refused with its
place.
"""

import json
import sys
import types
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dropo.core.services.errors import BadFile
from dropo.logs.mapping import read_mapping
from dropo.logs.readers.reader import open_log
from dropo.logs.recordings import LogRun, read_runs
from dropo.mjmodel.joints import load_model_joints

Columns = dict[str, Any]
N = 50


def silent(share: float, text: str) -> None:
    """No progress."""


@pytest.fixture
def columns(arm: Any) -> Columns:
    """Half a second at 100 Hz."""
    log: Columns = arm.log(rate=100.0, seconds=N / 100)
    return log


def runs(folder: Path, log: Path, text: str) -> list[LogRun]:
    """The runs of a log by the mapping in a text."""
    (folder / "map.yaml").write_text(text)
    return read_runs(
        [log], read_mapping(folder / "map.yaml", load_model_joints(folder / "robot.xml")), silent
    )


def mapped(place: Callable[[str, int], str], more: str = "") -> str:
    """A mapping whose columns are called place("q", 0), place("dq", 0), place("tau", 0), ..."""
    rows = [
        ("qpos", "q", ("shoulder", "elbow")),
        ("qvel", "dq", ("shoulder", "elbow")),
        ("ctrl", "tau", ("m1", "m2")),
    ]
    lines = []
    for field, kind, names in rows:
        entries = [f"{name}: {{column: {place(kind, i)!r}}}" for i, name in enumerate(names)]
        lines.append(f"{field}: {{{', '.join(entries)}}}")
    return "\n".join([*lines, more])


def same(run: LogRun, columns: Columns, rows: slice = slice(None), start: float = 0.0) -> None:
    """The run holds the columns' numbers, all of them, bit for bit; stamps to a nanosecond."""
    keys = {"qpos": "q", "qvel": "dq", "ctrl": "tau"}
    assert len(run.series) == 6
    for series in run.series:
        number = 1 + ["shoulder", "elbow", "m1", "m2"].index(series.channel.name) % 2
        np.testing.assert_array_equal(
            series.values[:, 0], columns[f"{keys[series.channel.field]}{number}"][rows]
        )
        np.testing.assert_allclose(series.time, columns["t"][rows] - start, rtol=0, atol=2e-9)


PLAIN = mapped(lambda kind, i: f"{kind}{i + 1}", "time: {column: t}\n")
MATRIX = mapped(lambda kind, i: f"{kind}[{i}]")


def matrices(columns: Columns, rows: slice = slice(None)) -> Columns:
    return {
        kind: np.stack([columns[f"{kind}1"][rows], columns[f"{kind}2"][rows]], axis=1)
        for kind in ("q", "dq", "tau")
    }


@pytest.mark.parametrize("separator", [",", ";", "\t", " "])
def test_csv(folder: Path, columns: Columns, csv: Any, separator: str) -> None:
    """Whatever separates the cells; a byte order mark and a "#" before the names are ignored."""
    path = csv(folder / "log.csv", columns)
    path.write_text("\ufeff# " + path.read_text().replace(",", separator))
    (run,) = runs(folder, path, PLAIN)
    same(run, columns)
    assert (run.name, run.rows) == ("log", N)


def test_csv_in_blocks(
    folder: Path, columns: Columns, csv: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("dropo.logs.readers.tables.BLOCK", 7)
    shares: list[float] = []
    (folder / "map.yaml").write_text(PLAIN)
    mapping = read_mapping(folder / "map.yaml", load_model_joints(folder / "robot.xml"))
    (run,) = read_runs(
        [csv(folder / "log.csv", columns)], mapping, lambda share, text: shares.append(share)
    )
    same(run, columns)
    assert len(shares) == 8
    assert shares == sorted(shares)
    assert shares[-1] == 1.0


def test_dates_and_empty_cells(folder: Path, columns: Columns, csv: Any) -> None:
    """ISO dates count from the first one; a cell without a number is left out of its own signal
    alone.
    """
    dates = np.datetime64("2026-01-02T03:04:05", "ns") + np.round(columns["t"] * 1e9).astype(
        "timedelta64[ns]"
    )
    q2 = columns["q2"].copy()
    q2[::3] = np.nan
    path = csv(folder / "log.csv", {**columns, "q2": q2})
    lines = path.read_text().splitlines()
    path.write_text(
        "\n".join(
            [
                lines[0],
                *(
                    f"{date}Z,{line.split(',', 1)[1]}"
                    for date, line in zip(dates, lines[1:], strict=True)
                ),
            ]
        )
    )
    (run,) = runs(folder, path, PLAIN)
    elbow = run.of("qpos", "elbow")
    assert elbow is not None
    keep = np.arange(N) % 3 != 0
    np.testing.assert_array_equal(elbow.values[:, 0], columns["q2"][keep])
    np.testing.assert_allclose(elbow.time, (columns["t"] - columns["t"][0])[keep], atol=2e-9)
    np.testing.assert_array_equal(elbow.rows, np.flatnonzero(keep))


def test_runs_of_one_table(folder: Path, columns: Columns, csv: Any) -> None:
    """A column tells the runs apart; `only` takes some of them."""
    path = csv(folder / "log.csv", columns)
    lines = path.read_text().splitlines()
    words = ["run_id", *("ab"[i >= 20] + "_x" for i in range(N))]
    path.write_text("\n".join(f"{line},{word}" for line, word in zip(lines, words, strict=True)))
    a, b = runs(folder, path, PLAIN + "run: {column: run_id}")
    same(a, columns, slice(0, 20))
    same(b, columns, slice(20, None))
    assert [
        run.name for run in runs(folder, path, PLAIN + "run: {column: run_id, only: ['b*']}")
    ] == ["b_x"]
    with pytest.raises(
        BadFile, match=r"run.only: expected runs of the logs, got patterns that fit none"
    ):
        runs(folder, path, PLAIN + "run: {column: run_id, only: [c]}")


def test_npz(folder: Path, columns: Columns) -> None:
    """Columns as arrays, or matrices of them."""
    np.savez(folder / "a.npz", **columns)
    same(runs(folder, folder / "a.npz", PLAIN)[0], columns)
    np.savez(folder / "b.npz", t=columns["t"], note=np.array("x"), **matrices(columns))
    same(runs(folder, folder / "b.npz", MATRIX + "time: {column: t}")[0], columns)


def test_many_runs_in_one_archive(folder: Path, columns: Columns) -> None:
    """Arrays "000/time", "000/q": time and run need no mapping; rows count in each run."""
    parts = [slice(0, 20), slice(20, None)]
    arrays = {
        f"{i:03d}/{key}": value
        for i, rows in enumerate(parts)
        for key, value in {"time": columns["t"][rows], **matrices(columns, rows)}.items()
    }
    np.savez(folder / "runs.npz", names=np.array(["one", "two"]), meta="{}", **arrays)
    one, two = runs(folder, folder / "runs.npz", MATRIX)
    same(one, columns, parts[0])
    same(two, columns, parts[1])
    assert two.series[0].rows[0] == 0
    del arrays["001/tau"]
    np.savez(folder / "runs.npz", names=np.array(["one", "two"]), **arrays)
    with pytest.raises(
        BadFile,
        match=r"run 'two' of .*column 'tau\[0\]': expected at least two rows with a number, got 0",
    ):
        runs(folder, folder / "runs.npz", MATRIX)


def test_parquet(folder: Path, columns: Columns) -> None:
    """Plain columns, columns of lists, and time stamps as dates."""
    arrow = pytest.importorskip("pyarrow")
    parquet = pytest.importorskip("pyarrow.parquet")
    parquet.write_table(arrow.table(columns), folder / "a.parquet", row_group_size=20)
    same(runs(folder, folder / "a.parquet", PLAIN)[0], columns)
    stamps = arrow.array(np.round(columns["t"] * 1e9).astype("int64")).cast(arrow.timestamp("ns"))
    table = arrow.table(
        {"t": stamps, **{key: arrow.array(list(value)) for key, value in matrices(columns).items()}}
    )
    parquet.write_table(table, folder / "b.parquet")
    same(
        runs(folder, folder / "b.parquet", MATRIX + "time: {column: t}")[0],
        columns,
        start=columns["t"][0],
    )
    whole = (folder / "a.parquet").read_bytes()
    (folder / "half.parquet").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(
        BadFile,
        match=rf"half.parquet: byte {len(whole) // 2}: .*it ends before the table of its contents",
    ):
        runs(folder, folder / "half.parquet", PLAIN)
    (folder / "bad.parquet").write_bytes(whole[:100] + bytes(400) + whole[500:])
    with pytest.raises(BadFile, match=r"bad.parquet: rows from 0 \(row group 0\)"):
        runs(folder, folder / "bad.parquet", PLAIN)


def lerobot(folder: Path, columns: Columns) -> Path:
    """Two episodes in LeRobot's layout: state q1, q2, dq1, dq2; action tau1, tau2."""
    arrow = pytest.importorskip("pyarrow")
    parquet = pytest.importorskip("pyarrow.parquet")
    names = {
        "observation.state": {"names": ["s.pos", "e.pos", "s.vel", "e.vel"]},
        "action": {"names": {"motors": ["s", "e"]}},
    }
    (folder / "set" / "meta").mkdir(parents=True)
    (folder / "set" / "data" / "chunk-000").mkdir(parents=True)
    (folder / "set" / "meta" / "info.json").write_text(json.dumps({"fps": 100, "features": names}))
    for i, rows in enumerate([slice(0, 20), slice(20, None)]):
        parts = matrices(columns, rows)
        table = {
            "observation.state": list(np.hstack([parts["q"], parts["dq"]])),
            "action": list(parts["tau"]),
            "timestamp": columns["t"][rows],
            "episode_index": np.full(len(parts["q"]), i),
        }
        parquet.write_table(
            arrow.table(table), folder / "set" / "data" / "chunk-000" / f"episode_{i:06d}.parquet"
        )
    return folder / "set"


def test_lerobot(folder: Path, columns: Columns) -> None:
    """Elements by their number or name; episodes are runs."""
    path = lerobot(folder, columns)
    named = {
        "q": "observation.state[{}.pos]",
        "dq": "observation.state[{}.vel]",
        "tau": "action[{}]",
    }
    one, two = runs(folder, path, mapped(lambda kind, i: named[kind].format("se"[i])))
    same(one, columns, slice(0, 20))
    same(two, columns, slice(20, None))
    first = {"q": 0, "dq": 2, "tau": 0}
    by_number = mapped(
        lambda kind, i: f"{'action' if kind == 'tau' else 'observation.state'}[{first[kind] + i}]"
    )
    same(runs(folder, path, by_number)[0], columns, slice(0, 20))


def test_minari(folder: Path, columns: Columns, monkeypatch: pytest.MonkeyPatch) -> None:
    """T + 1 observations and T actions an episode, rows a control step apart; a stand-in for the
    package.
    """
    q, dq, tau = matrices(columns).values()
    episode = types.SimpleNamespace(
        observations={"state": np.hstack([q, dq])}, actions=tau[:-1], rewards=np.zeros(N - 1)
    )
    package = types.ModuleType("minari")
    package.MinariDataset = lambda path: types.SimpleNamespace(
        iterate_episodes=lambda: iter([episode])
    )  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "minari", package)
    (folder / "set" / "data").mkdir(parents=True)
    (folder / "set" / "data" / "metadata.json").write_text("{}")
    text = mapped(
        lambda kind, i: (
            f"actions[{i}]" if kind == "tau" else f"observations.state[{i + 2 * (kind == 'dq')}]"
        )
    )
    (run,) = runs(folder, folder / "set", text + "rate: 100")
    torque = run.of("ctrl", "m1", "command")
    angle = run.of("qpos", "shoulder")
    assert torque is not None
    assert angle is not None
    np.testing.assert_array_equal(torque.values[:, 0], columns["tau1"][:-1])
    np.testing.assert_allclose(angle.time, np.arange(N) / 100)
    with pytest.raises(
        BadFile,
        match=(
            r"rate: expected the rows of a second \[Hz\], since .* has no time stamps, got "
            r"nothing"
        ),
    ):
        runs(folder, folder / "set", text)


# Recorded messages

TOPICS = mapped(
    lambda kind, i: {"q": "position", "dq": "velocity", "tau": "effort"}[kind] + f"[{'se'[i]}]"
)


def joint_states(columns: Columns) -> list[tuple[int, dict[str, Any]]]:
    """(stamp in ns, message) like sensor_msgs/JointState, with the two joints in changing order."""
    out = []
    for k in range(N):
        order = [0, 1] if k % 2 else [1, 0]
        values = {
            field: [float(columns[f"{kind}{i + 1}"][k]) for i in order]
            for field, kind in (("position", "q"), ("velocity", "dq"), ("effort", "tau"))
        }
        out.append(
            (
                round(columns["t"][k] * 1e9) + 1_700_000_000_000_000_000,
                {"name": ["se"[i] for i in order], **values},
            )
        )
    return out


def write_mcap(path: Path, columns: Columns) -> Path:
    """JSON messages on /joints, and others on /camera."""
    writer_module = pytest.importorskip("mcap.writer")
    with path.open("wb") as file:
        writer = writer_module.Writer(file)
        writer.start()
        schema = writer.register_schema("JointState", "jsonschema", b"{}")
        joints = writer.register_channel("/joints", "json", schema)
        camera = writer.register_channel("/camera", "json", schema)
        for stamp, message in joint_states(columns):
            content = {
                "header": {"stamp": {"sec": stamp // 10**9, "nsec": stamp % 10**9}},
                **message,
            }
            writer.add_message(joints, stamp + 5_000_000, json.dumps(content).encode(), stamp)
        writer.add_message(camera, stamp, b"{}", stamp)
        writer.finish()
    return path


def test_mcap(folder: Path, columns: Columns) -> None:
    """The header's stamp is taken, not when the message was received; joints go by their names."""
    path = write_mcap(folder / "log.mcap", columns)
    (run,) = runs(folder, path, TOPICS + "\ntime: {topic: /joints}")
    same(run, columns, start=columns["t"][0])
    assert open_log(path).columns("/joints")[:2] == ["log_time", "header.stamp"]
    with pytest.raises(
        BadFile,
        match=(
            r"topic: expected one of its topics: /camera \(JointState\), /joints "
            r"\(JointState\), got '/joint'"
        ),
    ):
        runs(folder, path, TOPICS + "\ntime: {topic: /joint}")
    whole = path.read_bytes()
    (folder / "half.mcap").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(BadFile, match=rf"half.mcap: byte {len(whole) // 2}: .*truncated"):
        runs(folder, folder / "half.mcap", TOPICS + "\ntime: {topic: /joints}")
    (folder / "bad.mcap").write_bytes(whole[:400] + bytes(100) + whole[500:])
    with pytest.raises(BadFile, match=r"bad.mcap: /joints, byte \d+: .*corrupt"):
        runs(folder, folder / "bad.mcap", TOPICS + "\ntime: {topic: /joints}")


@pytest.mark.parametrize("kind", ["ros1", "ros2"])
def test_ros_bags(folder: Path, columns: Columns, kind: str) -> None:
    """Bags of ROS 1 and 2, written by rosbags."""
    pytest.importorskip("rosbags")
    from rosbags import rosbag1, rosbag2
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC if kind == "ros1" else Stores.ROS2_HUMBLE)
    name = "sensor_msgs/msg/JointState"
    state, header, time = (
        store.types[key] for key in (name, "std_msgs/msg/Header", "builtin_interfaces/msg/Time")
    )
    path = folder / ("log.bag" if kind == "ros1" else "log")
    writer: Any = rosbag1.Writer(path) if kind == "ros1" else rosbag2.Writer(path, version=9)
    with writer:
        connection = writer.add_connection("/joints", name, typestore=store)
        for i, (stamp, message) in enumerate(joint_states(columns)):
            extra = {"seq": i} if kind == "ros1" else {}
            head = header(
                stamp=time(sec=stamp // 10**9, nanosec=stamp % 10**9), frame_id="", **extra
            )
            arrays = {key: np.array(message[key]) for key in ("position", "velocity", "effort")}
            content = state(header=head, name=message["name"], **arrays)
            data = (
                store.serialize_ros1(content, name)
                if kind == "ros1"
                else store.serialize_cdr(content, name)
            )
            writer.write(connection, stamp + 5_000_000, data)
    (run,) = runs(folder, path, TOPICS)
    same(run, columns, start=columns["t"][0])
    with pytest.raises(
        BadFile,
        match=(
            r"topic: expected one of its topics: /joints \(sensor_msgs/msg/JointState\), got "
            r"'/joint'"
        ),
    ):
        runs(folder, path, TOPICS + "\ntime: {topic: /joint}")
    if kind == "ros1":
        whole = path.read_bytes()
        (folder / "half.bag").write_bytes(whole[: len(whole) // 2])
        with pytest.raises(BadFile, match=r"half.bag.*truncated or corrupt"):
            runs(folder, folder / "half.bag", TOPICS)


def test_mcap_of_ros2(folder: Path, columns: Columns) -> None:
    """A ROS 2 recording in an MCAP file alone, with its message definitions inside."""
    writer_module = pytest.importorskip("mcap.writer")
    pytest.importorskip("rosbags")
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    name = "geometry_msgs/msg/Vector3"
    definition = "float64 x\nfloat64 y\nfloat64 z\n"
    path = folder / "log.mcap"
    with path.open("wb") as file:
        writer = writer_module.Writer(file)
        writer.start("ros2")
        schema = writer.register_schema(name, "ros2msg", definition.encode())
        for topic, kind in (("/q", "q"), ("/dq", "dq"), ("/tau", "tau")):
            channel = writer.register_channel(topic, "cdr", schema)
            for k in range(N):
                message = store.types[name](
                    x=columns[f"{kind}1"][k], y=columns[f"{kind}2"][k], z=0.0
                )
                stamp = round(columns["t"][k] * 1e9)
                writer.add_message(channel, stamp, bytes(store.serialize_cdr(message, name)), stamp)
        writer.finish()
    lines = [
        f"{field}: {{{first}: {{column: x, topic: /{kind}}}, "
        f"{second}: {{column: y, topic: /{kind}}}}}"
        for field, kind, first, second in (
            ("qpos", "q", "shoulder", "elbow"),
            ("qvel", "dq", "shoulder", "elbow"),
            ("ctrl", "tau", "m1", "m2"),
        )
    ]
    (run,) = runs(folder, path, "\n".join(lines))
    same(run, columns, start=columns["t"][0])


# Broken logs


def test_broken_tables(folder: Path, columns: Columns, csv: Any) -> None:
    """The line or the byte is named."""
    path = csv(folder / "log.csv", columns)
    whole = path.read_bytes()
    lines = whole.split(b"\n")

    def refusal(content: bytes) -> str:
        path.write_bytes(content)
        with pytest.raises(BadFile) as caught:
            runs(folder, path, PLAIN)
        return str(caught.value).replace(f"{folder}/", "")

    cut = b"\n".join([*lines[:20], b",".join(lines[20].split(b",")[:3])])
    assert refusal(cut) == (
        "log.csv: line 21: expected as many cells in every line, got a truncated or "
        "corrupt file (3 cells for 7 columns)."
    )
    word = b"\n".join(
        [*lines[:10], lines[10].replace(lines[10].split(b",")[2], b"x?"), *lines[11:]]
    )
    assert refusal(word) == "log.csv: line 11, column 'q2': expected a number, got 'x?'."
    assert "log.csv: byte 200: expected a table of text" in refusal(
        whole[:200] + b"\xff\xfe" + whole[202:]
    )
    assert (
        refusal(b"1,2,3\n4,5,6\n")
        == "log.csv: line 1: expected the names of the columns, got numbers."
    )
    assert (
        refusal(b"t,q1,t\n1,2,3\n")
        == "log.csv: line 1: expected every column's name once, got 't' twice."
    )
    assert refusal(b"") == "log.csv: expected a log, got an empty file."


def test_broken_archives(folder: Path, columns: Columns) -> None:
    path = folder / "log.npz"
    np.savez(path, **columns)
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(
        BadFile,
        match=r"log.npz: expected an .npz file, .*, got a file that cannot be read as one",
    ):
        runs(folder, path, PLAIN)
    at = whole.index(columns["q2"].tobytes())
    path.write_bytes(whole[:at] + bytes(80) + whole[at + 80 :])
    with pytest.raises(BadFile, match=r"log.npz: q2: .*corrupt"):
        runs(folder, path, PLAIN)


def test_other_files(folder: Path) -> None:
    with pytest.raises(BadFile, match=r"none.csv: expected a log, got no such file"):
        open_log(folder / "none.csv")
    with pytest.raises(
        BadFile, match=r"robot.xml: expected a log that ends in .*\.csv, .* got a file '.xml'"
    ):
        open_log(folder / "robot.xml")
    with pytest.raises(
        BadFile, match=r"expected a ROS 2 bag \(metadata.yaml\), .* got another folder"
    ):
        open_log(folder)


def test_a_missing_package_is_named(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pyarrow.parquet", None)
    (folder / "log.parquet").write_bytes(b"PAR1PAR1")
    with pytest.raises(
        BadFile, match=r"expected the package 'pyarrow' to read it \(pip install 'dropo\[logs\]'\)"
    ):
        open_log(folder / "log.parquet").columns(None)
