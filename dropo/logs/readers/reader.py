"""Raw logs: the contract of their readers, and which reader a file takes."""

import importlib
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from dropo.core.services.errors import BadFile

Arrays = dict[str, NDArray[Any]]
Progress = Callable[[float, str], None]
"""progress(share of the work, what is being done)."""


class Log(ABC):
    """A file or folder of recorded numbers: one table of named columns, or several by topic.

    run_column: the column that tells its runs apart, where the kind of log has one; time_column:
    its own column of stamps;
    separate_runs: each run counts its own rows.
    """

    run_column: str | None = None
    time_column: str | None = None
    separate_runs = False

    def __init__(self, path: str | Path):
        self.path = Path(path)

    def topics(self) -> dict[str, str]:
        """Topic -> type of its messages; none where the log is one table."""
        return {}

    @abstractmethod
    def columns(self, topic: str | None) -> list[str]:
        """The names of the columns; a vector's are "name[0]", "name[1]", ..."""

    @abstractmethod
    def read(self, topic: str | None, columns: Sequence[str], progress: Progress) -> Arrays:
        """Columns by name, (n,) each: numbers (NaN: no value in that row), dates, or texts.

        All are in `columns(topic)`.
        """

    def broken(self, expected: str, where: str, reason: object) -> BadFile:
        """The refusal of a truncated or corrupt file, with the place."""
        return BadFile(
            self.path,
            where,
            expected,
            f"a truncated or corrupt file ({' '.join(str(reason).split()).removesuffix('.')})",
        )


def open_log(path: str | Path) -> Log:
    """The reader for a file or folder, chosen by its ending and layout."""
    place = Path(path)
    if not place.exists():
        raise BadFile(path, "", "a log", "no such file")
    if place.is_file() and place.stat().st_size == 0:
        raise BadFile(path, "", "a log", "an empty file")
    module, name = _reader(place)
    return cast(Log, getattr(importlib.import_module(f"dropo.logs.readers.{module}"), name)(place))


_BY_SUFFIX = {
    ".csv": ("tables", "CsvLog"),
    ".tsv": ("tables", "CsvLog"),
    ".txt": ("tables", "CsvLog"),
    ".parquet": ("tables", "ParquetLog"),
    ".pq": ("tables", "ParquetLog"),
    ".npz": ("archives", "npz_log"),
    ".mcap": ("bags", "McapLog"),
    ".bag": ("bags", "RosLog"),
    ".db3": ("bags", "RosLog"),
}


def _reader(place: Path) -> tuple[str, str]:
    if place.is_dir():
        if (place / "meta" / "info.json").is_file():
            return "episodes", "LeRobotLog"
        if (place / "metadata.yaml").is_file():
            return "bags", "RosLog"
        if any(
            (place / name).exists()
            for name in (
                "data/metadata.json",
                "metadata.json",
                "data/main_data.hdf5",
                "main_data.hdf5",
            )
        ):
            return "episodes", "MinariLog"
        raise BadFile(
            place,
            "",
            "a ROS 2 bag (metadata.yaml), LeRobot episodes (meta/info.json) or a Minari data set",
            "another folder",
        )
    if place.suffix.lower() not in _BY_SUFFIX:
        raise BadFile(
            place, "", f"a log that ends in {', '.join(_BY_SUFFIX)}", f"a file {place.suffix!r}"
        )
    return _BY_SUFFIX[place.suffix.lower()]


def package(name: str, path: Path, extra: str) -> Any:
    """A package that only some logs need, imported when one is read."""
    try:
        return importlib.import_module(name)
    except ImportError:
        wanted = f"the package {name.split('.')[0]!r} to read it (pip install 'dropo[{extra}]')"
        raise BadFile(path, "", wanted, "no such package") from None


def expanded(columns: dict[str, NDArray[Any]]) -> Arrays:
    """Arrays (n,) under their names, and of arrays (n, ...) every column, "name[0]", "name[1]",
    ..., flattened row by row.
    """
    out: Arrays = {}
    for name, array in columns.items():
        rows = array.reshape(len(array), -1) if array.ndim > 1 else array
        out |= (
            {name: rows}
            if rows.ndim == 1
            else {f"{name}[{i}]": rows[:, i] for i in range(rows.shape[1])}
        )
    return out


def joined(blocks: Iterable[Arrays], columns: Sequence[str]) -> Arrays:
    """Blocks of rows one behind the other."""
    parts: dict[str, list[NDArray[Any]]] = {name: [] for name in columns}
    for block in blocks:
        for name in columns:
            parts[name].append(block[name])
    return {
        name: np.concatenate(arrays) if arrays else np.empty(0) for name, arrays in parts.items()
    }
