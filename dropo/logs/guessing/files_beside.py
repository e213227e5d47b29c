"""Files beside a log that hold its commands or its IMU, by their names and stamps."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from dropo.core.services.errors import BadFile
from dropo.core.services.validation import Array
from dropo.logs.beside import file_beside, name_beside
from dropo.logs.guessing import words
from dropo.logs.guessing.scales import DEFAULTS as SCALES
from dropo.logs.guessing.scales import ScaleSettings, time_unit
from dropo.logs.guessing.words import ColumnName, read_names
from dropo.logs.readers.reader import Log, open_log
from dropo.logs.units import seconds

_OF_LOGS = (
    *("log", "logs", "joint", "joints", "state", "states", "pos", "positions", "position"),
    *("measured", "meas", "encoder", "encoders", "feedback", "data", "robot", "rec", "recording"),
)
"""Words of a log's name that its other files need not have."""
_OF_COMMANDS = (
    *("cmd", "cmds", "command", "commands", "commanded", "target", "targets", "goal", "goals"),
    *("ctrl", "control", "controls", "action", "actions", "setpoint", "setpoints", "reference"),
    *("references", "desired", "input", "inputs", "volt", "volts", "voltage", "voltages", "pwm"),
)
_OF_SENSORS = ("imu", "gyro", "acc", "accel", "sensor", "sensors", "force", "forces", "ft")


@dataclass(frozen=True)
class BesideSettings:
    """When a file beside a log is on the log's clock.

    Attributes
    ----------
    shared : float
        Fraction of the shorter of both that their stamps must have in common.
    scales : ScaleSettings
        What the size of stamps says of their unit.
    """

    shared: float = 0.5
    scales: ScaleSettings = field(default_factory=lambda: SCALES)


DEFAULTS = BesideSettings()


@dataclass(frozen=True, eq=False)
class FileBeside:
    """A file beside a log.

    Attributes
    ----------
    name : str
        As a mapping names it for all logs.
    log : Log
        Its reader.
    columns : tuple of ColumnName
        Its columns.
    clock : dict
        Its column of stamps and their unit.
    same : bool
        Whether the stamps are of the log's clock.
    """

    name: str
    log: Log
    columns: tuple[ColumnName, ...]
    clock: dict[str, Any]
    same: bool

    def stamps(self) -> Array:
        """Give the stamps [s] of its rows, on their own origin.

        Returns
        -------
        (n,) array
        """
        return read_stamps(self.log, self.clock["column"], self.clock["unit"])


def read_stamps(log: Log, column: str, unit: str) -> Array:
    """Read the stamps of a log.

    Parameters
    ----------
    log : Log
        One table.
    column, unit : str
        Of the stamps.

    Returns
    -------
    (n,) array
        In s, NaN where there is none.
    """
    values = log.read(None, [column], lambda fraction, text: None)[column]
    return seconds(values, unit)


def find_files(
    log: Log,
    names: Sequence[str],
    given: Mapping[str, str | None],
    time: dict[str, Any],
    settings: BesideSettings = DEFAULTS,
) -> list[FileBeside]:
    """Find the files beside a log that may hold its commands or its IMU.

    Parameters
    ----------
    log : Log
        The log.
    names : sequence of str
        Joints and actuators, whose words keep their meaning.
    given : mapping of str to str
        Files that a mapping names, with a word that holds for all columns, such as "command".
    time : dict
        The log's column of stamps and their unit.
    settings : BesideSettings, optional
        When a file is on the log's clock.

    Returns
    -------
    list of FileBeside
        Those that have a column of stamps.
    """
    if log.topics() or not log.path.is_file() or "column" not in time:
        return []
    wanted = {file_beside(log.path, file): file for file in given}
    above = {path: given[file] for path, file in wanted.items()}
    for other in sorted(log.path.parent.iterdir()):
        if other not in wanted and is_part(log.path, other):
            wanted[other] = name_beside(log.path, other)
            is_command = set(words.tokens(other.stem)) & {*_OF_COMMANDS}
            above[other] = other.stem if is_command else None
    if not wanted:
        return []
    time = {"unit": "s", **time}
    own = read_stamps(log, time["column"], time["unit"])
    found = []
    for path, file in wanted.items():
        one = _read_file(path, file, names, above[path], own, time, settings)
        if one is not None:
            found.append(one)
    return found


def is_part(log: Path, other: Path) -> bool:
    """Tell by their names whether a file holds the commands or the IMU of a log.

    Parameters
    ----------
    log, other : Path
        The log, and another file.

    Returns
    -------
    bool
    """
    if other == log or not other.is_file() or other.suffix.lower() != log.suffix.lower():
        return False
    mine = words.tokens(log.stem)
    theirs = words.tokens(other.stem)
    parts = {*_OF_COMMANDS, *_OF_SENSORS}
    if set(mine) & parts or not set(theirs) & parts:
        return False
    idle = {*parts, *_OF_LOGS}
    return [w for w in mine if w not in idle] == [w for w in theirs if w not in idle]


def own_recordings(logs: Sequence[str | Path]) -> list[str | Path]:
    """Leave out the logs that by their names hold the commands or the IMU of another one.

    Parameters
    ----------
    logs : sequence of str or Path
        As they were named.

    Returns
    -------
    list of str or Path
        The others; all where none would be left.
    """
    paths = [Path(log) for log in logs]
    alone = []
    for log, path in zip(logs, paths, strict=True):
        if not any(one.parent == path.parent and is_part(one, path) for one in paths):
            alone.append(log)
    return alone or list(logs)


def _read_file(
    path: Path,
    file: str,
    names: Sequence[str],
    above: str | None,
    own: Array,
    time: dict[str, Any],
    settings: BesideSettings,
) -> FileBeside | None:
    """A file with its columns and stamps; None of one without."""
    try:
        log = open_log(path)
        columns = read_names(log, names, above)
    except BadFile:
        return None
    stamps = [one for one in columns if one.quantity == words.TIME]
    if log.topics() or not stamps:
        return None
    first = next((one for one in stamps if one.column == time["column"]), stamps[0])
    values = log.read(None, [first.column], lambda fraction, text: None)[first.column]
    is_date = values.dtype.kind == "M"
    if not is_date and values.dtype.kind not in "iuf":
        return None
    units = ["s"]
    if not is_date:
        guessed = time_unit(values[np.isfinite(values)], first.unit, settings.scales).unit
        units = [guessed, time["unit"]]
    here = {unit: read_stamps(log, first.column, unit) for unit in units}
    together = [unit for unit in units if _are_together(own, here[unit], settings)]
    clock = {"column": first.column, "unit": (together or units)[0]}
    parts = tuple(
        ColumnName(one.column, None, one.quantity, one.kind, one.unit, one.rest, file)
        for one in columns
        if one.quantity != words.TIME
    )
    return FileBeside(file, log, parts, clock, bool(together))


def _are_together(one: Array, other: Array, settings: BesideSettings) -> bool:
    """Whether stamps are of the same time, for the most part of the shorter of both."""
    one = one[np.isfinite(one)]
    other = other[np.isfinite(other)]
    if len(one) < 2 or len(other) < 2:
        return False
    common = min(one[-1], other[-1]) - max(one[0], other[0])
    return bool(common > settings.shared * min(np.ptp(one), np.ptp(other)))
