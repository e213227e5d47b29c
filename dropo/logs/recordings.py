"""Runs of raw logs as series of numbers: read by a mapping, in SI units, each with its own time
stamps.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dropo.core.records.trajectories import Ints
from dropo.core.services.errors import BadFile
from dropo.core.services.file_content import describe_options, describe_value
from dropo.core.services.validation import Array
from dropo.logs.mapping import Channel, Mapping, Source
from dropo.logs.readers.reader import Arrays, Log, Progress, open_log
from dropo.logs.units import seconds

FAR = 1e6
"""Stamps beyond so many seconds, and dates, count from the log's first one."""


@dataclass(frozen=True, eq=False)
class Series:
    """The numbers of a channel in the order of the log: values (n, k) at `time` (n,) [s]; rows
    (n,): their places in the log.

    Rows without a value are left out.
    """

    channel: Channel
    time: Array
    values: Array
    rows: Ints

    @property
    def label(self) -> str:
        """ "qpos.elbow"."""
        return self.channel.label

    def take(self, keep: NDArray[Any]) -> "Series":
        """Some of the rows."""
        return replace(self, time=self.time[keep], values=self.values[keep], rows=self.rows[keep])

    def later(self, seconds: float | Array) -> "Series":
        """The same values at later stamps."""
        return replace(self, time=self.time + seconds)


@dataclass(frozen=True, eq=False)
class Stamps:
    """All time stamps of one source in a run, (n,) [s], with their rows in the log; `name` is what
    messages call them.
    """

    name: str
    time: Array
    rows: Ints


@dataclass(frozen=True, eq=False)
class Run:
    """One recording: its series, the stamps of every source, how many rows were read, and how many
    lacked a stamp.
    """

    name: str
    path: Path
    series: tuple[Series, ...]
    stamps: tuple[Stamps, ...]
    rows: int
    without_stamp: int = 0

    def of(self, field: str, name: str, candidate: str = "") -> Series | None:
        """The series of a joint or actuator, or None."""
        key = (field, name, candidate)
        return next(
            (
                s
                for s in self.series
                if (s.channel.field, s.channel.name, s.channel.candidate) == key
            ),
            None,
        )


def read_runs(logs: Sequence[str | Path], mapping: Mapping, progress: Progress) -> list[Run]:
    """The runs of all logs, in order, where the mapping says `only` those it names."""
    runs = []
    for i, path in enumerate(logs):
        runs += list(
            _runs(
                open_log(path),
                mapping,
                lambda share, text, i=i: progress((i + share) / len(logs), text),
            )
        )  # type: ignore[misc]
    if not runs:
        raise mapping.refusal("run.only", "runs of the logs", "patterns that fit none")
    return runs


@dataclass(frozen=True, eq=False)
class _Table:
    """What one source gave: channels' columns, stamps, and each row's run."""

    source: Source
    channels: list[Channel]
    columns: Arrays
    stamps: NDArray[Any] | None
    run: NDArray[Any] | None


def _runs(log: Log, mapping: Mapping, progress: Progress) -> Iterator[Run]:
    by_source: dict[Source, list[Channel]] = {}
    for channel in mapping.channels:
        by_source.setdefault(channel.source, []).append(channel)
    tables = [
        _table(log, source, channels, mapping, progress) for source, channels in by_source.items()
    ]
    names = _names(tables, log, mapping)
    origins: dict[bool, Any] = {}
    for name in names:
        yield _run(log, name, tables, mapping, origins)


def _names(tables: list[_Table], log: Log, mapping: Mapping) -> list[Any]:
    """The runs' names in the order of the log; None where a log is one run."""
    if tables[0].run is None:
        if mapping.only:
            raise mapping.refusal(
                "run.only",
                "a log with several runs",
                f"{log.path}, which is one (`run: {{column: ...}}` tells them apart)",
            )
        return [None]
    _, first = np.unique(tables[0].run, return_index=True)
    names = [tables[0].run[i] for i in sorted(first)]
    return [
        name
        for name in names
        if not mapping.only or any(fnmatchcase(_word(name), pattern) for pattern in mapping.only)
    ]


def _word(name: Any) -> str:
    return f"{name:g}" if isinstance(name, float | np.floating) else str(name)


def _table(
    log: Log, source: Source, channels: list[Channel], mapping: Mapping, progress: Progress
) -> _Table:
    """Reads the columns of one source."""
    if source.file is not None:
        log = open_log(log.path.parent / source.file.replace("{stem}", log.path.stem))
    known = log.columns(source.topic)
    for channel in channels:
        for column in channel.columns:
            _known(column, known, log, mapping, f"{channel.key}.column")
    stamp = source.clock.column or _own_stamps(log, source)
    if stamp is None and mapping.rate is None:
        raise mapping.refusal(
            "rate", f"the rows of a second [Hz], since {log.path} has no time stamps", "nothing"
        )
    if stamp is not None:
        _known(
            stamp,
            known,
            log,
            mapping,
            f"{channels[0].key}.clock" if source.own_clock else "time.column",
        )
    run = mapping.run or log.run_column
    if run is not None:
        _known(run, known, log, mapping, "run.column")
    wanted = dict.fromkeys(
        [column for channel in channels for column in channel.columns]
        + [name for name in (stamp, run) if name]
    )
    found = log.read(source.topic, list(wanted), progress)
    for channel in channels:
        for column in channel.columns:
            if found[column].dtype.kind not in "biuf":
                raise BadFile(
                    log.path,
                    f"column {column!r}",
                    "numbers",
                    "texts" if found[column].dtype.kind in "US" else str(found[column].dtype),
                )
    if stamp is not None and found[stamp].dtype.kind not in "iufM":
        raise BadFile(log.path, f"column {stamp!r}", "time stamps: numbers or dates", "texts")
    return _Table(
        source,
        channels,
        found,
        None if stamp is None else found[stamp],
        None if run is None else found[run],
    )


def _own_stamps(log: Log, source: Source) -> str | None:
    """The log's own column of stamps."""
    stamps = getattr(log, "stamps", None)
    return stamps(source.topic) if stamps is not None else log.time_column


def _known(column: str, columns: list[str], log: Log, mapping: Mapping, key: str) -> None:
    if column not in columns:
        raise mapping.refusal(
            key,
            describe_options(f"a column of {log.path}", column, columns),
            describe_value(column),
        )


def _run(
    log: Log, name: Any, tables: list[_Table], mapping: Mapping, origins: dict[bool, Any]
) -> Run:
    series = []
    stamps = []
    read = 0
    without = 0
    for table in tables:
        length = len(next(iter(table.columns.values())))
        rows = (
            np.arange(length)
            if table.run is None or name is None
            else np.flatnonzero(table.run == name)
        )
        time = _time(table, rows, mapping, origins)
        timed = np.isfinite(time)
        read = read + len(rows)
        without = without + int((~timed).sum())
        rows = rows[timed]
        time = time[timed]
        numbers = rows - rows[:1] if log.separate_runs else rows
        stamps.append(Stamps(_stamp_name(table), time, numbers))
        for channel in table.channels:
            values = np.stack(
                [table.columns[column][rows] for column in channel.columns], axis=1
            ).astype(float)
            values = np.array(channel.factors) * (
                np.array(channel.signs) * values + np.array(channel.offsets)
            )
            there = np.isfinite(values).all(axis=1)
            if there.sum() < 2:
                where = f"{log.path}" if name is None else f"run {_word(name)!r} of {log.path}"
                raise BadFile(
                    where,
                    f"column {channel.columns[0]!r}",
                    "at least two rows with a number",
                    f"{int(there.sum())}",
                )
            series.append(Series(channel, time[there], values[there], numbers[there]))
    word = log.path.stem if name is None else _word(name)
    return Run(word, log.path, tuple(series), tuple(stamps), read, without)


def _stamp_name(table: _Table) -> str:
    column = table.source.clock.column or "time"
    where = ", ".join(part for part in (table.source.file, table.source.topic) if part)
    return f"{column} of {where}" if where else column


def _time(table: _Table, rows: Ints, mapping: Mapping, origins: dict[bool, Any]) -> Array:
    """Seconds; NaN where there is no stamp.

    Sources of one clock share their origin; another clock has its own.
    """
    if table.stamps is None:
        return np.arange(len(rows)) / float(mapping.rate or 1)
    stamps = table.stamps[rows]
    unit = table.source.clock.unit
    missing = np.isnat(stamps) if stamps.dtype.kind == "M" else ~np.isfinite(stamps)
    if missing.all():
        return np.full(len(rows), np.nan)
    first = stamps[~missing][0]
    far = stamps.dtype.kind == "M" or abs(float(seconds(np.asarray([first]), unit)[0])) > FAR
    origin = (
        (first if table.source.own_clock else origins.setdefault(False, first)) if far else None
    )
    return np.where(missing, np.nan, seconds(stamps, unit, origin))
