"""Raw logs: the contract of their readers, and which reader a file takes.

A reader is a plug-in of kind "readers"; its name is the ending of the files that it reads.
"""

import importlib
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from dropo.core.services.errors import BadFile
from dropo.core.services.registry import HINT, find, names

Arrays = dict[str, NDArray[Any]]
Progress = Callable[[float, str], None]
"""Called with the fraction of the work that is done, and what is being done."""
CRAZYFLIE_MAGIC = b"\xbc"
"""The first byte of a Crazyflie's log."""
MINARI_FILES = (
    "data/metadata.json",
    "metadata.json",
    "data/main_data.hdf5",
    "main_data.hdf5",
)
"""Files by which a folder is known as a Minari data set."""


def part_progress(progress: Progress, part: int, parts: int) -> Progress:
    """Report the progress of one of several equal parts as that of all.

    Parameters
    ----------
    progress : callable
        Of all parts.
    part, parts : int
        Which of how many.

    Returns
    -------
    callable
        Of the part.
    """
    return lambda fraction, text: progress((part + fraction) / parts, text)


class Log(ABC):
    """A file or folder of recorded numbers: one table of named columns, or several by topic.

    Parameters
    ----------
    path : str or Path
        The file or folder.

    Attributes
    ----------
    path : Path
        The same.
    run_column : str or None
        The column that tells its runs apart, where the kind of log has one.
    time_column : str or None
        Its own column of stamps: numbers in s, or dates.
    separate_runs : bool
        Whether each run counts its own rows.
    """

    run_column: str | None = None
    time_column: str | None = None
    separate_runs = False

    def __init__(self, path: str | Path):
        self.path = Path(path)

    def topics(self) -> dict[str, str]:
        """List the topics of a log.

        Returns
        -------
        dict of str to str
            By name, the type of its messages; empty where the log is one table.
        """
        return {}

    def stamps(self, topic: str | None) -> str | None:
        """Name the column of time stamps.

        Parameters
        ----------
        topic : str or None
            One of its topics, where it has such.

        Returns
        -------
        str or None
            `time_column`, unless overridden; None where the log has no stamps of its own.
        """
        return self.time_column

    @abstractmethod
    def columns(self, topic: str | None) -> list[str]:
        """List the names of the columns; a vector's are "name[0]", "name[1]", ...

        Parameters
        ----------
        topic : str or None
            One of its topics, where it has such.

        Returns
        -------
        list of str

        Raises
        ------
        BadFile
            If the log cannot be read, or has no such topic.
        """

    @abstractmethod
    def read(self, topic: str | None, columns: Sequence[str], progress: Progress) -> Arrays:
        """Read columns.

        Parameters
        ----------
        topic : str or None
            One of its topics, where it has such.
        columns : sequence of str
            Names in `columns(topic)`.
        progress : callable
            Called with the fraction of the work that is done, and what is being done.

        Returns
        -------
        dict
            By name (n,) numbers, NaN where a row has no value, or dates, or texts.

        Raises
        ------
        BadFile
            If the log cannot be read.
        """

    def broken(self, expected: str, where: str, reason: object) -> BadFile:
        """Make the error for a truncated or corrupt file.

        Parameters
        ----------
        expected : str
            What had to stand there.
        where : str
            The place in the file.
        reason : object
            What its decoder says.

        Returns
        -------
        BadFile
            To be raised by the caller.
        """
        text = " ".join(str(reason).split()).removesuffix(".")
        return BadFile(self.path, where, expected, f"a truncated or corrupt file ({text})")


def open_log(path: str | Path) -> Log:
    """Choose the reader for a file or folder by its ending and layout.

    Parameters
    ----------
    path : str or Path
        The log.

    Returns
    -------
    Log

    Raises
    ------
    BadFile
        If there is no such file, or it is none that is read.
    """
    place = Path(path)
    if not place.exists():
        raise BadFile(path, "", "a log", "no such file")
    if place.is_file() and place.stat().st_size == 0:
        raise BadFile(path, "", "a log", "an empty file")
    return cast(Log, find("readers", _reader_name(place))(place))


_FOLDERS = ("crazyflie", "lerobot", "minari", "ros2", "sage")
"""Readers that are chosen by the layout of a folder or the first byte, not by an ending."""


def _reader_name(place: Path) -> str:
    """The name of the reader for a file, which is its ending, or for a folder."""
    if place.is_dir():
        if (place / "meta" / "info.json").is_file():
            return "lerobot"
        if (place / "joint_list.txt").is_file():
            return "sage"
        if (place / "metadata.yaml").is_file():
            return "ros2"
        if any((place / name).exists() for name in MINARI_FILES):
            return "minari"
        expected = (
            "a ROS 2 bag (metadata.yaml), LeRobot episodes (meta/info.json), a SAGE motion "
            "(joint_list.txt) or a Minari data set"
        )
        raise BadFile(place, "", expected, "another folder")
    if _begins_like_crazyflie(place):
        return "crazyflie"
    endings = [name for name in names("readers") if name not in _FOLDERS]
    ending = place.suffix.lower().removeprefix(".")
    if ending not in endings:
        expected = f"a log that ends in {', '.join(f'.{name}' for name in endings)}"
        raise BadFile(place, "", expected, f"a file {place.suffix!r}", HINT)
    return ending


def _begins_like_crazyflie(place: Path) -> bool:
    """Whether a file without a usual ending begins as a Crazyflie's log, which has none."""
    if place.suffix not in ("", ".bin", ".log", ".usd"):
        return False
    with place.open("rb") as file:
        return file.read(1) == CRAZYFLIE_MAGIC


def package(name: str, path: Path, extra: str) -> Any:
    """Import a package that only some logs need.

    Parameters
    ----------
    name : str
        The module.
    path : Path
        The log that needs it.
    extra : str
        The optional dependencies of this package that hold it.

    Returns
    -------
    module

    Raises
    ------
    BadFile
        If it is not installed.
    """
    try:
        return importlib.import_module(name)
    except ImportError:
        wanted = f"the package {name.split('.')[0]!r} to read it (pip install 'dropo[{extra}]')"
        raise BadFile(path, "", wanted, "no such package") from None


def expand_columns(arrays: Arrays) -> Arrays:
    """Take arrays apart into columns.

    Parameters
    ----------
    arrays : dict
        By name (n,) or (n, ...).

    Returns
    -------
    dict
        By name (n,); of an array (n, ...) "name[0]", "name[1]", ..., flattened row by row.
    """
    out: Arrays = {}
    for name, array in arrays.items():
        if array.ndim == 1:
            out[name] = array
            continue
        rows = array.reshape(len(array), -1)
        for i in range(rows.shape[1]):
            out[f"{name}[{i}]"] = rows[:, i]
    return out


def join_blocks(blocks: Iterable[Arrays], columns: Sequence[str]) -> Arrays:
    """Join blocks of rows.

    Parameters
    ----------
    blocks : iterable of dict
        Each with all columns.
    columns : sequence of str
        Their names.

    Returns
    -------
    dict
        By name all rows, those of each block behind those of the one before.
    """
    parts: dict[str, list[NDArray[Any]]] = {name: [] for name in columns}
    for block in blocks:
        for name in columns:
            parts[name].append(block[name])
    out: Arrays = {}
    for name, arrays in parts.items():
        out[name] = np.concatenate(arrays) if arrays else np.empty(0)
    return out
