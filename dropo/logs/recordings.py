"""Runs of raw logs as series of numbers, in SI units, each with its own time stamps.

In reading order: `read_runs` opens every log, `_read_table` reads the columns of one source by the
mapping, and `_make_run` cuts them into runs.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dropo.core.records.trajectories import Ints
from dropo.core.services.errors import BadFile
from dropo.core.services.files.file_content import describe_options, describe_value
from dropo.core.services.validation import Array
from dropo.logs.beside import file_beside, logs_alone
from dropo.logs.mapping import Channel, Mapping, Source
from dropo.logs.readers.reader import Arrays, Log, Progress, open_log, part_progress
from dropo.logs.units import SECONDS, seconds
from dropo.mjmodel.sensors import turned_columns


@dataclass(frozen=True)
class LogReadingSettings:
    """How logs are read.

    Attributes
    ----------
    far : float
        Stamps of more seconds than this count from the log's first one, so that digits are left;
        dates always do.
    """

    far: float = 1e6


DEFAULTS = LogReadingSettings()


@dataclass(frozen=True, eq=False)
class TimeSeries:
    """The numbers of a channel in the order of the log, without rows that have no value.

    Attributes
    ----------
    channel : Channel
        What was measured or commanded.
    time : (n,) array
        Stamps [s].
    values : (n, k) array
        In the channel's SI units.
    rows : (n,) int array
        Their places in the log.
    """

    channel: Channel
    time: Array
    values: Array
    rows: Ints

    @property
    def label(self) -> str:
        """Name in tables, such as "qpos.elbow"."""
        return self.channel.label

    def take(self, keep: NDArray[Any]) -> "TimeSeries":
        """Take some of the rows.

        Parameters
        ----------
        keep : (n,) bool or int array
            Which.

        Returns
        -------
        TimeSeries
        """
        return replace(self, time=self.time[keep], values=self.values[keep], rows=self.rows[keep])

    def shift(self, seconds: float) -> "TimeSeries":
        """Give the same values later stamps.

        Parameters
        ----------
        seconds : float
            By how much later.

        Returns
        -------
        TimeSeries
        """
        return replace(self, time=self.time + seconds)


@dataclass(frozen=True, eq=False)
class Stamps:
    """All time stamps of one source in a run.

    Attributes
    ----------
    name : str
        What messages call them.
    time : (n,) array
        In seconds.
    rows : (n,) int array
        Their places in the log.
    """

    name: str
    time: Array
    rows: Ints


@dataclass(frozen=True, eq=False)
class LogRun:
    """One recording.

    Attributes
    ----------
    name : str
        Of the run, or of its file.
    path : Path
        The log.
    series : tuple of TimeSeries
        One for each channel.
    stamps : tuple of Stamps
        One for each source.
    rows : int
        How many were read, of all sources.
    without_stamp : int
        How many of them lacked a stamp.
    """

    name: str
    path: Path
    series: tuple[TimeSeries, ...]
    stamps: tuple[Stamps, ...]
    rows: int
    without_stamp: int = 0

    def of(self, field: str, name: str, candidate: str = "") -> TimeSeries | None:
        """Find the series of a joint, actuator or sensor.

        Parameters
        ----------
        field : str
            "qpos", "qvel", "ctrl" or "sensordata".
        name : str
            The joint, actuator or sensor.
        candidate : str
            Of the commands, where a log has several.

        Returns
        -------
        TimeSeries or None
        """
        wanted = (field, name, candidate)
        for series in self.series:
            channel = series.channel
            if (channel.field, channel.name, channel.candidate) == wanted:
                return series
        return None


def read_runs(
    logs: Sequence[str | Path],
    mapping: Mapping,
    progress: Progress,
    settings: LogReadingSettings = DEFAULTS,
) -> list[LogRun]:
    """Read the runs of logs.

    Parameters
    ----------
    logs : sequence of str or Path
        Files or folders.
    mapping : Mapping
        Which columns are what, and which runs to take.
    progress : callable
        Called with the fraction of the work that is done, and what is being done.
    settings : LogReadingSettings, optional
        How stamps are read.

    Returns
    -------
    list of LogRun
        In the order of the logs; a file that the mapping looks for beside one of them is none.

    Raises
    ------
    BadFile
        If a log cannot be read, lacks a column or stamps, holds texts in place of numbers, or no
        run fits the mapping.
    """
    runs: list[LogRun] = []
    files = {channel.source.file for channel in mapping.channels} - {None}
    alone = logs_alone(logs, map(str, files))
    for i, path in enumerate(alone):
        part = part_progress(progress, i, len(alone))
        runs += _read_log(open_log(path), mapping, part, settings)
    if not runs:
        raise mapping.refusal("run.only", "runs of the logs", "patterns that fit none")
    return runs


def _read_log(
    log: Log, mapping: Mapping, progress: Progress, settings: LogReadingSettings
) -> list[LogRun]:
    """The runs of one log."""
    by_source: dict[Source, list[Channel]] = {}
    for channel in mapping.channels:
        by_source.setdefault(channel.source, []).append(channel)
    tables = []
    for source, channels in by_source.items():
        tables.append(_read_table(log, source, channels, mapping, progress))
    stamping = _Stamping(mapping.rate, settings)
    names = _run_names(tables[0], log, mapping)
    return [_make_run(log, name, tables, stamping) for name in names]


# The columns of one source


@dataclass(frozen=True, eq=False)
class _SourceTable:
    """What one source holds: columns (n,) of its channels, stamps (n,), and each row's run (n,)."""

    source: Source
    channels: list[Channel]
    columns: Arrays
    stamps: NDArray[Any] | None
    run: NDArray[Any] | None

    @property
    def name(self) -> str:
        """What messages call its stamps."""
        column = self.source.clock.column or "time"
        where = ", ".join(part for part in (self.source.file, self.source.topic) if part)
        return f"{column} of {where}" if where else column


def _read_table(
    log: Log, source: Source, channels: list[Channel], mapping: Mapping, progress: Progress
) -> _SourceTable:
    """Read the columns of one source."""
    if source.file is not None:
        log = open_log(file_beside(log.path, source.file))
    # every column must be there before any is read
    there = log.columns(source.topic)
    needed = []
    for channel in channels:
        for column in channel.columns:
            _require_column(column, there, log, mapping, f"{channel.key}.column")
            needed.append(column)
    stamp = source.clock.column or log.stamps(source.topic)
    if stamp is None and mapping.rate is None:
        expected = f"the rows of a second [Hz], since {log.path} has no time stamps"
        raise mapping.refusal("rate", expected, "nothing")
    if stamp is not None:
        key = f"{channels[0].key}.clock" if source.own_clock else "time.column"
        _require_column(stamp, there, log, mapping, key)
        needed.append(stamp)
    run = mapping.run or log.run_column
    if run is not None:
        _require_column(run, there, log, mapping, "run.column")
        needed.append(run)
    # texts are no numbers
    found = log.read(source.topic, list(dict.fromkeys(needed)), progress)
    for channel in channels:
        for column in channel.columns:
            _require_numbers(found[column], column, log)
    if stamp is not None and found[stamp].dtype.kind not in "iufM":
        raise BadFile(log.path, f"column {stamp!r}", "time stamps: numbers or dates", "texts")
    stamps = None if stamp is None else found[stamp]
    return _SourceTable(source, channels, found, stamps, None if run is None else found[run])


def _require_column(column: str, there: list[str], log: Log, mapping: Mapping, key: str) -> None:
    """Refuse the name of a column that a log has not."""
    if column not in there:
        expected = describe_options(f"a column of {log.path}", column, there)
        raise mapping.refusal(key, expected, describe_value(column))


def _require_numbers(values: NDArray[Any], column: str, log: Log) -> None:
    """Refuse a column of texts or dates."""
    kind = values.dtype.kind
    if kind not in "biuf":
        got = "texts" if kind in "US" else str(values.dtype)
        raise BadFile(log.path, f"column {column!r}", "numbers", got)


# Runs


def _run_names(table: _SourceTable, log: Log, mapping: Mapping) -> list[Any]:
    """The names of the runs to take, in the order of the log; None where a log is one run."""
    if table.run is None:
        if mapping.only:
            got = f"{log.path}, which is one (`run: {{column: ...}}` tells them apart)"
            raise mapping.refusal("run.only", "a log with several runs", got)
        return [None]
    _, first = np.unique(table.run, return_index=True)
    names = [table.run[i] for i in sorted(first)]
    if not mapping.only:
        return names
    wanted = []
    for name in names:
        if any(fnmatchcase(_format_name(name), pattern) for pattern in mapping.only):
            wanted.append(name)
    return wanted


def _format_name(name: Any) -> str:
    """The name of a run as text; a whole number has no decimals."""
    return f"{name:g}" if isinstance(name, float | np.floating) else str(name)


@dataclass(eq=False)
class _Stamping:
    """How stamps become seconds: rows a second without any, and the log's first one once known."""

    rate: float | None
    settings: LogReadingSettings
    origin: Any = None
    unit: str = "s"

    def origin_in(self, unit: str) -> Any:
        """The origin in a unit of time; dates have none."""
        if unit == self.unit or isinstance(self.origin, np.datetime64):
            return self.origin
        return self.origin * SECONDS[self.unit] / SECONDS[unit]


def _make_run(log: Log, name: Any, tables: list[_SourceTable], stamping: _Stamping) -> LogRun:
    """The rows of all sources that belong to a run."""
    series = []
    stamps = []
    read = 0
    without = 0
    word = log.path.stem if name is None else _format_name(name)
    place = f"{log.path}" if name is None else f"run {word!r} of {log.path}"
    for table in tables:
        # the rows of the run that have a stamp
        rows = _rows_of_run(table, name)
        time = _seconds(table, rows, stamping)
        timed = np.isfinite(time)
        read += len(rows)
        without += int((~timed).sum())
        rows = rows[timed]
        time = time[timed]
        numbers = rows - rows[:1] if log.separate_runs else rows
        stamps.append(Stamps(table.name, time, numbers))
        # of these, for each channel, those that have a value
        for channel in table.channels:
            values = _channel_values(table, channel, rows)
            there = np.isfinite(values).all(axis=1)
            if there.sum() < 2:
                column = f"column {channel.columns[0]!r}"
                got = f"{int(there.sum())}"
                raise BadFile(place, column, "at least two rows with a number", got)
            series.append(TimeSeries(channel, time[there], values[there], numbers[there]))
    return LogRun(word, log.path, tuple(series), tuple(stamps), read, without)


def _rows_of_run(table: _SourceTable, name: Any) -> Ints:
    """The rows of a run; all where the log is one."""
    if table.run is None or name is None:
        return np.arange(len(next(iter(table.columns.values()))))
    return np.flatnonzero(table.run == name)


def _channel_values(table: _SourceTable, channel: Channel, rows: Ints) -> Array:
    """The numbers (n, k) of a channel in SI units."""
    columns = [table.columns[column][rows] for column in channel.columns]
    logged = np.stack(columns, axis=1).astype(float)
    values = np.array(channel.factors) * (
        np.array(channel.signs) * logged + np.array(channel.offsets)
    )
    if channel.rotation is None:
        return np.asarray(values)
    return turned_columns(channel.rotation, values, rotation=len(channel.columns) == 4)


def _seconds(table: _SourceTable, rows: Ints, stamping: _Stamping) -> Array:
    """Stamps in seconds; NaN where there is none.

    Sources on the log's clock share their origin; another clock has its own.
    """
    if table.stamps is None:
        return np.arange(len(rows)) / float(stamping.rate or 1)
    stamps = table.stamps[rows]
    unit = table.source.clock.unit
    dates = stamps.dtype.kind == "M"
    missing = np.isnat(stamps) if dates else ~np.isfinite(stamps)
    if missing.all():
        return np.full(len(rows), np.nan)
    first = stamps[~missing][0]
    origin = None
    far = stamping.settings.far
    if dates or abs(float(seconds(np.asarray([first]), unit)[0])) > far:
        if stamping.origin is None and not table.source.own_clock:
            stamping.origin = first
            stamping.unit = unit
        origin = first if table.source.own_clock else stamping.origin_in(unit)
    return np.where(missing, np.nan, seconds(stamps, unit, origin))
