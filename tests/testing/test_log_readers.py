"""The check of log readers: the built-in ones pass, and one that breaks a rule is found out."""

import json
from pathlib import Path

import numpy as np
import pytest

from dropo.core.services.registry import find, register
from dropo.logs.readers.reader import Log, open_log
from dropo.testing import check_log_reader

COLUMNS = {"t": np.arange(40) * 0.01, "q": np.sin(np.arange(40.0)), "u": np.cos(np.arange(40.0))}


@pytest.fixture
def csv(tmp_path: Path) -> Path:
    """A log of 40 rows as a table of text."""
    path = tmp_path / "log.csv"
    table = np.stack(list(COLUMNS.values()), axis=1)
    np.savetxt(path, table, delimiter=",", header=",".join(COLUMNS), comments="")
    return path


def test_built_in_readers_pass(csv: Path) -> None:
    np.savez(csv.parent / "log.npz", **COLUMNS)
    check_log_reader(find("readers", "csv"), csv)
    check_log_reader(find("readers", "npz"), csv.parent / "log.npz")


def test_the_parquet_reader_passes(tmp_path: Path) -> None:
    arrow = pytest.importorskip("pyarrow")
    parquet = pytest.importorskip("pyarrow.parquet")
    parquet.write_table(arrow.table(COLUMNS), tmp_path / "log.parquet")
    check_log_reader(find("readers", "parquet"), tmp_path / "log.parquet")


class Lines(Log):
    """Three numbers a line, by names that are known beforehand; keeps to the contract."""

    def columns(self, topic):
        return ["t", "q", "u"]

    def read(self, topic, columns, progress):
        try:
            rows = [json.loads(line) for line in self.path.read_text().splitlines()]
        except ValueError as error:
            raise self.broken("numbers", "", error) from None
        progress(1.0, "reading")
        return {name: np.array([row[name] for row in rows]) for name in columns}


class Raises(Lines):
    """Lets a parser's own error through."""

    def read(self, topic, columns, progress):
        rows = [json.loads(line) for line in self.path.read_text().splitlines()]
        progress(1.0, "reading")
        return {name: np.array([row[name] for row in rows]) for name in columns}


class Twice(Lines):
    """Gives a name twice."""

    def columns(self, topic):
        return ["t", "q", "q"]


class Everything(Lines):
    """Gives columns that were not asked for."""

    def read(self, topic, columns, progress):
        return super().read(topic, self.columns(topic), progress)


class Ragged(Lines):
    """Gives columns of different lengths."""

    def read(self, topic, columns, progress):
        found = super().read(topic, columns, progress)
        return {name: array[: len(array) - (name == "u")] for name, array in found.items()}


class Silent(Lines):
    """Never says how far it is."""

    def read(self, topic, columns, progress):
        return super().read(topic, columns, lambda share, text: None)


class Objects(Lines):
    """Gives Python objects in place of numbers."""

    def read(self, topic, columns, progress):
        found = super().read(topic, columns, progress)
        return {name: array.astype(object) for name, array in found.items()}


class Restless(Lines):
    """Gives other numbers each time."""

    reads = 0

    def read(self, topic, columns, progress):
        Restless.reads += 1
        found = super().read(topic, columns, progress)
        return {name: array + Restless.reads for name, array in found.items()}


class Lists(Lines):
    """Gives lists in place of arrays."""

    def read(self, topic, columns, progress):
        found = super().read(topic, columns, progress)
        return {name: array.tolist() for name, array in found.items()}


class Nothing(Lines):
    """Forgets to return what it has read."""

    def read(self, topic, columns, progress):
        super().read(topic, columns, progress)


class Unnamed(Lines):
    """Gives no list of names."""

    def columns(self, topic):
        return None


class Untimed(Lines):
    """Names a column of stamps that it does not have."""

    time_column = "time"


class Unparted(Lines):
    """Names a column of runs that it does not have."""

    run_column = "run"


class Dated(Lines):
    """Keeps to the contract: its stamps are a column of its own."""

    time_column = "t"


class Wordy(Lines):
    """Its stamps are texts."""

    time_column = "q"

    def read(self, topic, columns, progress):
        found = super().read(topic, columns, progress)
        return {name: array.astype(str) for name, array in found.items()}


@pytest.fixture
def lines(tmp_path: Path) -> Path:
    """The same log, one JSON object a line."""
    path = tmp_path / "log.jsonl"
    rows = [
        json.dumps({name: float(array[i]) for name, array in COLUMNS.items()}) for i in range(40)
    ]
    path.write_text("\n".join(rows))
    return path


def test_a_reader_of_ones_own_passes_and_is_found_by_its_ending(lines, monkeypatch) -> None:
    check_log_reader(Lines, lines)
    check_log_reader(Dated, lines)
    monkeypatch.setattr("dropo.core.services.registry._registered", {"readers": {}})
    register("readers", "jsonl", Lines)
    assert isinstance(open_log(lines), Lines)


@pytest.mark.parametrize(
    ("reader", "message"),
    [
        (Raises, "cut in half with JSONDecodeError"),
        (Twice, "a name twice"),
        (Everything, r"gives \['q', 't', 'u'\], not \['t'\]"),
        (Ragged, "several lengths"),
        (Silent, "never reports"),
        (Objects, "no numbers, dates or texts"),
        (Restless, "differently a second time"),
        (Lists, "reads 't' as list, not as a NumPy array"),
        (Nothing, "read gives NoneType, not a dict of arrays"),
        (Unnamed, "columns gives NoneType, not a list of names"),
        (
            Untimed,
            r"names the column of stamps 'time', which is none of its columns \['t', 'q', 'u'\]",
        ),
        (Unparted, "names the column of runs 'run', which is none"),
        (Wordy, "the column of stamps 'q' .* must be numbers, in s, or dates"),
        (lambda path: None, "which is no Log"),
    ],
)
def test_a_broken_rule_is_named(lines, reader, message) -> None:
    with pytest.raises(AssertionError, match=message):
        check_log_reader(reader, lines)
