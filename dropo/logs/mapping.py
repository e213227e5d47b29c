"""The mapping file of an import: which column of a log is which joint or actuator, in which unit,
with which sign and clock.
"""

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from dropo.core.services.errors import BadFile
from dropo.core.services.strict_yaml import Entries, named, read_yaml, shown
from dropo.logs.units import SECONDS, UNITS, units_of
from dropo.mjmodel.joints import Joint, ModelJoints

KEYS = ("time", "qpos", "qvel", "ctrl", "inputs", "run", "rate")
COLUMN_KEYS = ("column", "columns", "unit", "sign", "offset", "file", "topic", "clock")
CLOCK_KEYS = ("column", "unit")
TORQUE_LIKE = ("N m", "N", "A", "V", "rad", "m", "rad/s", "m/s", "")
"""SI units that a command may have: what an actuator takes is the model's own."""
COMMAND = "command"
"""The name of the only candidate where a mapping has `ctrl` and no `inputs`."""
_SLICE = re.compile(r"^(?P<name>.+)\[(?P<start>\d+):(?P<stop>\d+)\]$")


@dataclass(frozen=True)
class Clock:
    """A column of time stamps; column None: the log's own, where its kind has one."""

    column: str | None = None
    unit: str = "s"


@dataclass(frozen=True)
class Source:
    """Where a column stands: a file beside the log ("{stem}_imu.csv"), a topic of it, and the clock
    of its stamps.

    own_clock: its stamps come from another clock than those of the log.
    """

    file: str | None = None
    topic: str | None = None
    clock: Clock = Clock()
    own_clock: bool = False


@dataclass(frozen=True)
class Channel:
    """One or more columns that are the numbers of a joint's "qpos" or "qvel", or of an actuator's
    "ctrl".

    value = factor (sign column + offset), in the SI unit; candidate: of the commands, where a log
    has several.
    """

    field: str
    name: str
    columns: tuple[str, ...]
    units: tuple[str, ...]
    factors: tuple[float, ...]
    signs: tuple[float, ...]
    offsets: tuple[float, ...]
    source: Source
    candidate: str = ""
    key: str = ""

    @property
    def label(self) -> str:
        """ "qpos.elbow"; a candidate's command is "inputs.current.motor"."""
        prefix = f"inputs.{self.candidate}" if self.candidate not in ("", COMMAND) else self.field
        return f"{prefix}.{self.name}"


@dataclass(frozen=True)
class Mapping:
    """A mapping file, checked against a model.

    run: the column that tells runs apart; only: names or patterns of the runs to take; rate: of the
    control step [Hz].
    """

    path: Path
    channels: tuple[Channel, ...]
    run: str | None = None
    only: tuple[str, ...] = ()
    rate: float | None = None

    def of(self, field: str, candidate: str = "") -> tuple[Channel, ...]:
        """The channels of "qpos", "qvel" or, by candidate, "ctrl"."""
        return tuple(
            channel
            for channel in self.channels
            if (channel.field, channel.candidate) == (field, candidate)
        )

    @property
    def candidates(self) -> tuple[str, ...]:
        """The commands that the log has: COMMAND alone, those under `inputs`, or none."""
        return tuple(
            dict.fromkeys(channel.candidate for channel in self.channels if channel.field == "ctrl")
        )

    def refusal(self, key: str, expected: str, got: str) -> BadFile:
        """What is raised where the log does not fit the mapping."""
        return BadFile(self.path, key, expected, got)


def read_mapping(path: str | Path, machine: ModelJoints) -> Mapping:
    """The mapping in a YAML file; names, units, widths and keys are checked against the model."""
    entries = read_yaml(Path(path), KEYS, "a mapping file")
    source = _main_source(entries)
    channels = tuple(_channels(entries, machine, source))
    if not any(channel.field == "qpos" for channel in channels):
        raise BadFile(entries.path, "qpos", "at least one joint by name", "none")
    run = entries.level("run", ("column", "only"))
    rate = entries.number("rate") if "rate" in entries else None
    if rate is not None and rate <= 0:
        raise entries.bad("rate", "the control steps of a second [Hz], above 0")
    column = run.text("column", "the column that tells runs apart") if "column" in run else None
    return Mapping(
        entries.path,
        channels,
        column,
        run.texts("only", (), "names of runs, or patterns such as 'A0_*'") if "only" in run else (),
        rate,
    )


def _main_source(entries: Entries) -> Source:
    time = entries.level(
        "time", (*CLOCK_KEYS, "file", "topic"), "a mapping such as {column: t, unit: s}"
    )
    return Source(_optional(time, "file"), _optional(time, "topic"), _clock(time))


def _optional(entry: Entries, key: str) -> str | None:
    return entry.text(key, "a text") if key in entry else None


def _clock(entry: Entries) -> Clock:
    unit = entry.choice("unit", tuple(SECONDS), "a unit of time")
    return Clock(_optional(entry, "column"), unit)


def _channels(entries: Entries, machine: ModelJoints, source: Source) -> Iterator[Channel]:
    for field in ("qpos", "qvel"):
        level = entries.level(field, what="a mapping from joint names to columns")
        for name in level.content:
            level.known(name, name, machine.joints, "the name of a joint of the model")
            yield _joint_channel(
                level.level(name, COLUMN_KEYS, "a mapping such as {column: q1, unit: rad}"),
                field,
                machine.joints[name],
                source,
            )
    without = sorted(set(entries.level("qvel").content) - set(entries.level("qpos").content))
    if without:
        raise entries.bad(
            "qvel",
            "velocities of joints whose positions are mapped",
            f"{', '.join(without)} without one",
        )
    if "ctrl" in entries and "inputs" in entries:
        raise entries.bad("inputs", "either `ctrl` or, for several candidates, `inputs`", "both")
    candidates = entries.level(
        "inputs", what="a mapping from candidates to commands, each as under `ctrl`"
    )
    levels = {
        name: candidates.level(name, what="a mapping from actuator names to columns")
        for name in candidates.content
    }
    for candidate, level in (
        levels.items()
        if levels
        else [(COMMAND, entries.level("ctrl", what="a mapping from actuator names to columns"))]
    ):
        yield from _commands(level, machine, source, candidate)
    if len({frozenset(level.content) for level in levels.values()}) > 1:
        raise entries.bad(
            "inputs",
            "the same actuators in every candidate",
            "; ".join(f"{k}: {', '.join(v.content)}" for k, v in levels.items()),
        )


def _commands(
    level: Entries, machine: ModelJoints, source: Source, candidate: str
) -> Iterator[Channel]:
    for name in level.content:
        level.known(name, name, machine.actuators, "the name of an actuator of the model")
        entry = level.level(name, COLUMN_KEYS, "a mapping such as {column: tau1, unit: N m}")
        columns = _columns(entry, 1)
        si, factors = _units(entry, ("",), TORQUE_LIKE)
        yield _channel(entry, "ctrl", name, columns, si, factors, source, candidate)


def _joint_channel(entry: Entries, field: str, joint: Joint, source: Source) -> Channel:
    si = joint.units(field)
    columns = _columns(entry, len(si))
    found, factors = _units(entry, si, tuple(unit for unit in dict.fromkeys(si) if unit))
    return _channel(entry, field, joint.name, columns, found, factors, source, "")


def _channel(
    entry: Entries,
    field: str,
    name: str,
    columns: tuple[str, ...],
    si: tuple[str, ...],
    factors: tuple[float, ...],
    source: Source,
    candidate: str,
) -> Channel:
    signs = _numbers(entry, "sign", len(columns), 1.0)
    offsets = _numbers(entry, "offset", len(columns), 0.0)
    if any(abs(sign) != 1 for sign in signs):
        raise entry.bad("sign", "1 or -1")
    own = "clock" in entry
    clock = (
        _clock(entry.level("clock", CLOCK_KEYS, "a mapping such as {column: t, unit: us}"))
        if own
        else source.clock
    )
    place = Source(
        _optional(entry, "file") or source.file,
        _optional(entry, "topic") or source.topic,
        clock,
        own,
    )
    return Channel(
        field,
        name,
        columns,
        si,
        factors,
        signs,
        offsets,
        place,
        candidate,
        entry.prefix.removesuffix("."),
    )


def _columns(entry: Entries, width: int) -> tuple[str, ...]:
    """The names of the columns, of which there must be `width`; "pose[0:7]" stands for seven."""
    if width == 1:
        return (entry.text("column", "the name of a column"),)
    given = entry.content.get("columns")
    listed = [given] if isinstance(given, str) else given
    if not isinstance(listed, list) or not all(isinstance(name, str) and name for name in listed):
        raise entry.bad(
            "columns", f"a list of {width} columns, or a slice such as 'pose[0:{width}]'"
        )
    names = tuple(column for name in listed for column in _expanded(name))
    if len(names) != width:
        raise entry.bad("columns", f"{width} columns", f"{len(names)}")
    return names


def _expanded(name: str) -> list[str]:
    found = _SLICE.match(name)
    return (
        [f"{found['name']}[{i}]" for i in range(int(found["start"]), int(found["stop"]))]
        if found
        else [name]
    )


def _units(
    entry: Entries, si: tuple[str, ...], allowed: tuple[str, ...]
) -> tuple[tuple[str, ...], tuple[float, ...]]:
    """SI unit and factor of every column; one unit alone stands for the leading columns of its
    kind.
    """
    given = entry.content.get("unit")
    if given is None:
        return si, (1.0,) * len(si)
    listed = given if isinstance(given, list) else [given]
    for unit in listed:
        if (
            not isinstance(unit, str)
            or unit not in UNITS
            or UNITS[unit][0] not in (*allowed, *(si if len(si) > 1 else ()))
        ):
            raise entry.bad("unit", named("a unit", unit, units_of(allowed)), shown(unit))
    if len(si) == 1 or len(listed) == len(si):
        found = [UNITS[unit] for unit in listed[: len(si)]]
        wrong = next(
            (i for i, (base, _) in enumerate(found) if len(si) > 1 and base != si[i]), None
        )
        if wrong is not None or len(listed) != len(si):
            raise entry.bad("unit", "one unit for each column, of its kind")
        return tuple(base for base, _ in found), tuple(factor for _, factor in found)
    return si, tuple(
        next((UNITS[unit][1] for unit in listed if UNITS[unit][0] == base), 1.0) for base in si
    )


def _numbers(entry: Entries, key: str, width: int, default: float) -> tuple[float, ...]:
    """A number for every column: one for all, or a list."""
    given = entry.content.get(key, default)
    listed = given if isinstance(given, list) else [given] * width
    if len(listed) != width or any(
        isinstance(x, bool) or not isinstance(x, int | float) or not math.isfinite(x)
        for x in listed
    ):
        raise entry.bad(key, f"a number, or a list of {width}" if width > 1 else "a number")
    return tuple(float(x) for x in listed)
