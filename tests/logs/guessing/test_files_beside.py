"""Commands in a file of their own beside the log are found, on the log's clock or on another."""

from pathlib import Path

import numpy as np
import pytest

from dropo.core.services.validation import Array
from dropo.logs.beside import file_beside, logs_alone, name_beside
from dropo.logs.guessing.files_beside import is_part
from dropo.logs.starting import InitResult, init
from dropo.problems.loading import load
from dropo.problems.simulated.example_log import ExampleMachine, write_example

EPOCH = 1_700_000_000.0


def write(path: Path, header: str, table: Array, digits: str) -> None:
    np.savetxt(path, table, fmt=digits, delimiter=",", header=header, comments="")


def apart(folder: Path, names: tuple[str, str], late: float = 0.0, unit: float = 1.0) -> None:
    """An example's logs with angles at 100 Hz and commands at 50 Hz in files of their own.

    late: what the commands' clock is ahead [s]; unit: its ticks in a second.
    """
    write_example(folder, machine=ExampleMachine(rows=400))
    for i in (1, 2, 3):
        log = folder / f"log{i}.csv"
        table = np.loadtxt(log, delimiter=",", skiprows=1)
        log.unlink()
        time = EPOCH + 100 * i + table[:, 0] / 1000
        angles = np.column_stack([time, table[:, 1:3]])
        write(folder / names[0].format(i), "time,shoulder angle,elbow angle", angles, "%.4f")
        stamps = unit * (time + late)
        targets = np.column_stack([stamps, table[:, 4], table[:, 3]])[::2]
        write(folder / names[1].format(i), "time,elbow,shoulder", targets, "%.4f")


def commands(found: InitResult) -> Array:
    """The commanded angles of the first run [rad]."""
    return found.imported.arrays["actions"][found.imported.arrays["group"] == 0]


@pytest.mark.parametrize(
    ("names", "file"),
    [
        (("log{}.csv", "log{}_cmd.csv"), "{stem}_cmd.csv"),
        (("joints_{}.csv", "commands_{}.csv"), "commands_{number}.csv"),
    ],
)
def test_commands_beside_the_log(tmp_path: Path, names: tuple[str, str], file: str) -> None:
    """They are taken from their file, of all logs alike, and are what was told then."""
    apart(tmp_path, names)
    everything = sorted(tmp_path.glob("*.csv"))
    found = init(tmp_path / "arm.xml", everything, tmp_path / "out")
    assert {entry["file"] for entry in found.mapping["ctrl"].values()} == {file}
    assert f'(`file: "{file}"`), on the log\'s clock' in " ".join(found.lines)
    assert list(found.imported.rows) == [names[0].format(i)[:-4] for i in (1, 2, 3)]
    assert all(run["dropped"] == 0 for run in found.imported.rows.values())
    table = np.loadtxt(tmp_path / names[1].format(1), delimiter=",", skiprows=1)
    told = np.radians(np.repeat(table[:, [2, 1]], 2, axis=0))
    got = commands(found)
    start = round(float(found.imported.arrays["time"][0]) / 0.01)
    np.testing.assert_allclose(got[:-4], told[start:][: len(got) - 4], atol=2e-4)
    assert load(tmp_path / "out" / "problem.yaml", threads=1).held_out is not None


def test_other_units_of_the_same_clock(tmp_path: Path) -> None:
    """Stamps in ms are those of the log in s: nothing is estimated of the clock."""
    apart(tmp_path, ("log{}.csv", "log{}_cmd.csv"), unit=1000)
    found = init(tmp_path / "arm.xml", sorted(tmp_path.glob("log?.csv")), tmp_path / "out")
    clock = found.mapping["ctrl"]["elbow_servo"]["clock"]
    assert clock == {"column": "time", "unit": "ms", "same": True}
    other = tmp_path / "again"
    other.mkdir()
    apart(other, ("log{}.csv", "log{}_cmd.csv"))
    same = init(other / "arm.xml", sorted(other.glob("log?.csv")), other / "out")
    np.testing.assert_allclose(commands(found), commands(same), atol=1e-3)


def test_a_clock_of_its_own(tmp_path: Path) -> None:
    """Stamps that have no time in common with the log's are of another clock, which is found."""
    apart(tmp_path, ("log{}.csv", "log{}_cmd.csv"), late=-EPOCH)
    found = init(tmp_path / "arm.xml", sorted(tmp_path.glob("log?.csv")), tmp_path / "out")
    assert found.mapping["ctrl"]["elbow_servo"]["clock"] == {"column": "time", "unit": "s"}
    assert "on a clock of its own" in " ".join(found.lines)
    assert any(delay.removed for delay in found.imported.delays)


def test_a_file_that_is_named(tmp_path: Path) -> None:
    """A file of any name, where the given mapping names it for one entry."""
    apart(tmp_path, ("log{}.csv", "vendor{}.csv"))
    (tmp_path / "mine.yaml").write_text(
        'ctrl: {elbow_servo: {file: "vendor{number}.csv", column: elbow}}\n'
    )
    found = init(
        tmp_path / "arm.xml",
        sorted(tmp_path.glob("log?.csv")),
        tmp_path / "out",
        mapping=tmp_path / "mine.yaml",
    )
    assert found.mapping["ctrl"]["elbow_servo"]["file"] == "vendor{number}.csv"


@pytest.mark.parametrize(
    ("log", "other", "part"),
    [
        ("log0.csv", "log0_cmd.csv", True),
        ("joints.csv", "commands.csv", True),
        ("run_3_states.csv", "run_3_imu.csv", True),
        ("log0.csv", "log1_cmd.csv", False),
        ("log0.csv", "log1.csv", False),
        ("log0_cmd.csv", "log0.csv", False),
        ("log0.csv", "log0_cmd.npz", False),
    ],
)
def test_parts_by_their_names(tmp_path: Path, log: str, other: str, part: bool) -> None:
    (tmp_path / log).touch()
    (tmp_path / other).touch()
    assert is_part(tmp_path / log, tmp_path / other) is part


def test_names_for_all_logs() -> None:
    """What a name stands for is found again; such files are no logs of their own."""
    pairs = {"a7.csv": "a7_imu.csv", "q_07.csv": "u_07.csv", "joints.csv": "cmd.csv"}
    for log, other in pairs.items():
        name = name_beside(Path(log), Path(other))
        assert file_beside(Path(log), name) == Path(other)
    assert logs_alone(["a7.csv", "a7_imu.csv"], ["{stem}_imu.csv"]) == ["a7.csv"]
