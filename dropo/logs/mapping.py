"""Mapping files: which column of a log is which joint or actuator, its unit, sign and clock."""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from dropo.core.services.errors import BadFile
from dropo.core.services.files.file_content import FileContent, describe_options, describe_value
from dropo.logs.units import known_unit, unit_named, units_of
from dropo.mjmodel.joints import Joint, ModelJoints
from dropo.mjmodel.sensors import Sensor

if TYPE_CHECKING:
    from dropo.logs.mapping_schema import ChannelEntry, ClockEntry, MappingFile, SensorEntry

KIND = "a mapping file"
"""What messages call such a file."""
TORQUE_LIKE = ("N m", "N", "A", "V", "rad", "m", "rad/s", "m/s", "")
"""SI units that a command may have: what an actuator takes is the model's own."""
COMMAND = "command"
"""The name of the only candidate where a mapping has `ctrl` and no `inputs`."""
AXES: dict[object, tuple[float, float, float]] = {
    "x": (1.0, 0.0, 0.0),
    "y": (0.0, 1.0, 0.0),
    "z": (0.0, 0.0, 1.0),
    "-x": (-1.0, 0.0, 0.0),
    "-y": (0.0, -1.0, 0.0),
    "-z": (0.0, 0.0, -1.0),
}
"""Axes as a mapping file names them."""
ROTATION = (
    "a quaternion w, x, y, z of length 1, or three axes of the log, turned and not mirrored, such "
    "as [y, -x, z]"
)
ONE_UNIT_EACH = "one unit for each column, of its kind"
_SLICE = re.compile(r"(?P<name>.+)\[(?P<start>\d{1,9}):(?P<stop>\d{1,9})\]")


@dataclass(frozen=True)
class MappingSettings:
    """What a mapping file may say.

    Attributes
    ----------
    rounded : float
        How far the length of a quaternion may be from 1.
    """

    rounded: float = 0.01


DEFAULTS = MappingSettings()


@dataclass(frozen=True)
class TimeColumn:
    """A column of time stamps.

    Attributes
    ----------
    column : str or None
        None: the log's own, where its kind has one.
    unit : str
        Of the stamps: "s", "ms", "us" or "ns".
    """

    column: str | None = None
    unit: str = "s"


@dataclass(frozen=True)
class Source:
    """Where a column stands.

    Attributes
    ----------
    file : str or None
        A file beside the log, such as "{stem}_imu.csv"; None: the log.
    topic : str or None
        A topic of the log.
    clock : TimeColumn
        The clock of the stamps.
    own_clock : bool
        Whether the stamps come from another clock than those of the log.
    """

    file: str | None = None
    topic: str | None = None
    clock: TimeColumn = TimeColumn()
    own_clock: bool = False


@dataclass(frozen=True)
class Channel:
    """One or more columns that are the numbers of a joint, an actuator or a sensor.

    A value is factor (sign column + offset), in the SI unit; of a sensor that is turned, these
    values turned.

    Attributes
    ----------
    field : str
        "qpos" or "qvel" of a joint, "ctrl" of an actuator, or "sensordata" of a sensor.
    name : str
        The joint, actuator or sensor.
    columns, units : tuple of str
        For each number the column and the SI unit.
    factors, signs, offsets : tuple of float
        For each number, how the column becomes a value.
    source : Source
        Where the columns stand.
    candidate : str
        Of the commands, where a log has several.
    key : str
        Where the channel stands in the mapping file.
    rotation : tuple of float or None
        Quaternion w, x, y, z that turns the axes of a sensor's columns into those of the model's.
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
    rotation: tuple[float, ...] | None = None

    @property
    def label(self) -> str:
        """Name in tables: "qpos.elbow"; a candidate's command is "inputs.current.motor"."""
        candidate = self.candidate not in ("", COMMAND)
        prefix = f"inputs.{self.candidate}" if candidate else self.field
        return f"{prefix}.{self.name}"


@dataclass(frozen=True)
class Mapping:
    """A mapping file, checked against a model.

    Attributes
    ----------
    path : Path
        The file.
    channels : tuple of Channel
        The columns of joints and actuators.
    run : str or None
        The column that tells runs apart.
    only : tuple of str
        Names or patterns of the runs to take.
    rate : float or None
        Of the control step [Hz].
    """

    path: Path
    channels: tuple[Channel, ...]
    run: str | None = None
    only: tuple[str, ...] = ()
    rate: float | None = None

    def of(self, field: str, candidate: str = "") -> tuple[Channel, ...]:
        """Select channels.

        Parameters
        ----------
        field : str
            "qpos", "qvel", "ctrl" or "sensordata".
        candidate : str
            Of the commands.

        Returns
        -------
        tuple of Channel
            In the order of the file.
        """
        wanted = (field, candidate)
        return tuple(one for one in self.channels if (one.field, one.candidate) == wanted)

    @property
    def candidates(self) -> tuple[str, ...]:
        """The commands that the log has: COMMAND alone, those under `inputs`, or none."""
        commands = [channel.candidate for channel in self.channels if channel.field == "ctrl"]
        return tuple(dict.fromkeys(commands))

    def refusal(self, key: str, expected: str, got: str) -> BadFile:
        """Make the error for an entry that does not fit the log.

        Parameters
        ----------
        key : str
            The entry's keys from the top of the file, joined by dots.
        expected, got : str
            What had to stand there, and what stands there.

        Returns
        -------
        BadFile
            To be raised by the caller.
        """
        return BadFile(self.path, key, expected, got)


def read_mapping(path: str | Path, robot: ModelJoints) -> Mapping:
    """Read a mapping file and check it against a model.

    Parameters
    ----------
    path : str or Path
        The YAML file.
    robot : ModelJoints
        The model's joints and actuators.

    Returns
    -------
    Mapping
        Its channels in SI units.

    Raises
    ------
    BadFile
        If keys, names, units or widths are not those of the model.
    """
    from dropo.core.services.files.file_schema import read_file
    from dropo.logs.mapping_schema import MappingFile

    return _make_mapping(read_file(Path(path), MappingFile, KIND), robot)


def check_mapping(path: str | Path, content: dict[str, Any], robot: ModelJoints) -> Mapping:
    """Check the content of a mapping file that is not written yet.

    Parameters
    ----------
    path : str or Path
        What messages call the file.
    content : dict
        What will stand in it.
    robot : ModelJoints
        The model's joints and actuators.

    Returns
    -------
    Mapping
        Its channels in SI units.

    Raises
    ------
    BadFile
        As of `read_mapping`.
    """
    from dropo.core.services.files.file_schema import validated
    from dropo.logs.mapping_schema import MappingFile

    return _make_mapping(validated(Path(path), content, MappingFile), robot)


def _make_mapping(file: "FileContent[MappingFile]", robot: ModelJoints) -> Mapping:
    """The channels of a mapping file."""
    content = file.content
    time = content.time
    source = Source(time.file, time.topic, _make_clock(time))
    channels = (
        *_read_joints(file, robot, source),
        *_read_sensors(file, robot, source),
        *_read_commands(file, robot, source),
    )
    only = tuple(content.run.only or ())
    return Mapping(file.path, channels, content.run.column, only, content.rate)


def _make_clock(entry: "ClockEntry") -> TimeColumn:
    """The clock that an entry describes."""
    return TimeColumn(entry.column, entry.unit)


def _read_joints(
    file: "FileContent[MappingFile]", robot: ModelJoints, source: Source
) -> Iterator[Channel]:
    """The channels of positions and velocities."""
    content = file.content
    for field, entries in (("qpos", content.qpos), ("qvel", content.qvel)):
        for name, entry in entries.items():
            key = f"{field}.{name}"
            file.require_known(key, name, robot.joints, "the name of a joint of the model")
            reader = _ChannelReader(file, key, entry, source)
            yield reader.read_joint(field, robot.joints[name])


def _read_sensors(
    file: "FileContent[MappingFile]", robot: ModelJoints, source: Source
) -> Iterator[Channel]:
    """The channels of the sensors."""
    for name, entry in file.content.sensordata.items():
        key = f"sensordata.{name}"
        file.require_known(key, name, robot.sensors, "the name of a sensor of the model")
        yield _ChannelReader(file, key, entry, source).read_sensor(robot.sensors[name], entry)


def _read_commands(
    file: "FileContent[MappingFile]", robot: ModelJoints, source: Source
) -> Iterator[Channel]:
    """The channels of the commands, candidate by candidate."""
    content = file.content
    candidates = content.inputs or {COMMAND: content.ctrl}
    for candidate, entries in candidates.items():
        prefix = f"inputs.{candidate}" if content.inputs else "ctrl"
        for name, entry in entries.items():
            key = f"{prefix}.{name}"
            file.require_known(key, name, robot.actuators, "the name of an actuator of the model")
            yield _ChannelReader(file, key, entry, source).read_command(name, candidate)


@dataclass(frozen=True)
class _ChannelReader:
    """An entry of a joint, actuator or sensor, on its way to a channel."""

    file: "FileContent[MappingFile]"
    key: str
    entry: "ChannelEntry"
    main: Source

    def read_joint(self, field: str, joint: Joint) -> Channel:
        """The channel of a joint's positions or velocities."""
        si = joint.units(field)
        columns = self._read_columns(len(si))
        allowed = tuple(unit for unit in dict.fromkeys(si) if unit)
        units, factors = self._read_units(si, allowed)
        return self._make_channel(field, joint.name, columns, units, factors, "")

    def read_command(self, name: str, candidate: str) -> Channel:
        """The channel of an actuator's command."""
        columns = self._read_columns(1)
        units, factors = self._read_units(("",), TORQUE_LIKE)
        return self._make_channel("ctrl", name, columns, units, factors, candidate)

    def read_sensor(self, sensor: Sensor, entry: "SensorEntry") -> Channel:
        """The channel of a sensor."""
        columns = self._read_columns(len(sensor.units))
        allowed = tuple(unit for unit in dict.fromkeys(sensor.units) if unit)
        units, factors = self._read_units(sensor.units, allowed or ("",))
        channel = self._make_channel("sensordata", sensor.name, columns, units, factors, "")
        if entry.rotation is None:
            return channel
        if not sensor.may_be_turned:
            got = f"one of a {sensor.kind}"
            raise self._refusal("rotation", "a sensor that turns with its mount", got)
        turn = read_rotation(entry.rotation)
        if turn is None:
            raise self._refusal("rotation", ROTATION, describe_value(entry.rotation))
        return replace(channel, rotation=turn)

    def _make_channel(
        self,
        field: str,
        name: str,
        columns: tuple[str, ...],
        units: tuple[str, ...],
        factors: tuple[float, ...],
        candidate: str,
    ) -> Channel:
        """The channel, with a sign and an offset for every column."""
        signs = self._repeat("sign", self.entry.sign, len(columns))
        offsets = self._repeat("offset", self.entry.offset, len(columns))
        source = self._make_source()
        return Channel(
            field, name, columns, units, factors, signs, offsets, source, candidate, self.key
        )

    def _make_source(self) -> Source:
        """Where the columns stand: as the log's others, unless the entry says otherwise."""
        entry = self.entry
        own = entry.clock is not None and not entry.clock.same
        clock = self.main.clock if entry.clock is None else _make_clock(entry.clock)
        return Source(entry.file or self.main.file, entry.topic or self.main.topic, clock, own)

    def _read_columns(self, width: int) -> tuple[str, ...]:
        """The names of the columns, of which there must be `width`; a slice stands for several."""
        if width == 1:
            if self.entry.column is None:
                raise self._refusal("column", "the name of a column", describe_value(None))
            return (self.entry.column,)
        given = self.entry.columns
        if given is None:
            expected = f"a list of {width} columns, or a slice such as 'pose[0:{width}]'"
            raise self._refusal("columns", expected, describe_value(None))
        listed = [given] if isinstance(given, str) else given
        count = sum(_count_columns(name) for name in listed)
        if count != width:
            raise self._refusal("columns", f"{width} columns", f"{count}")
        return tuple(column for name in listed for column in _expand_slice(name))

    def _read_units(
        self, si: tuple[str, ...], allowed: tuple[str, ...]
    ) -> tuple[tuple[str, ...], tuple[float, ...]]:
        """SI unit and factor of every column; one unit alone stands for all columns of its kind."""
        given = self.entry.unit
        if given is None:
            return si, (1.0,) * len(si)
        listed = [given] if isinstance(given, str) else given
        self._check_units(listed, (*allowed, *si) if len(si) > 1 else allowed, allowed)
        if len(listed) == len(si):
            return self._pair_units(si, listed)
        if len(si) == 1:
            raise self._refusal("unit", ONE_UNIT_EACH, describe_value(given))
        factors = dict(known_unit(unit) for unit in reversed(listed))
        return si, tuple(factors.get(unit, 1.0) for unit in si)

    def _check_units(
        self, listed: Sequence[str], bases: tuple[str, ...], shown: tuple[str, ...]
    ) -> None:
        """Refuse units of other kinds than `bases`; messages name those of the kinds `shown`."""
        for unit in listed:
            found = unit_named(unit)
            if found is None or found[0] not in bases:
                expected = describe_options("a unit", unit, units_of(shown))
                raise self._refusal("unit", expected, describe_value(unit))

    def _pair_units(
        self, si: tuple[str, ...], listed: Sequence[str]
    ) -> tuple[tuple[str, ...], tuple[float, ...]]:
        """SI unit and factor of every column, each with a unit of its own."""
        units = tuple(known_unit(unit)[0] for unit in listed)
        if len(si) > 1 and units != si:
            raise self._refusal("unit", ONE_UNIT_EACH, describe_value(self.entry.unit))
        return units, tuple(known_unit(unit)[1] for unit in listed)

    def _repeat(self, key: str, given: float | list[float], width: int) -> tuple[float, ...]:
        """A number for every column: one for all, or a list."""
        if not isinstance(given, list):
            return (given,) * width
        if len(given) != width:
            expected = f"a number, or a list of {width}" if width > 1 else "a number"
            raise self._refusal(key, expected, describe_value(given))
        return tuple(given)

    def _refusal(self, key: str, expected: str, got: str) -> BadFile:
        """The error for a key of the entry."""
        return self.file.refusal(f"{self.key}.{key}", expected, got)


def read_rotation(
    given: Sequence[object], settings: MappingSettings = DEFAULTS
) -> tuple[float, ...] | None:
    """Read how a sensor is turned in its mount.

    Parameters
    ----------
    given : sequence
        Four numbers w, x, y, z, or three axes such as "-y": those of the log that are the model's
        x, y and z.
    settings : MappingSettings, optional
        How exact a quaternion must be.

    Returns
    -------
    tuple of float or None
        A unit quaternion w, x, y, z; None where it is neither, or a mirror image.
    """
    from scipy.spatial.transform import Rotation  # slow to import

    if len(given) == 4 and all(isinstance(one, int | float) for one in given):
        quaternion = np.array(given, dtype=float)
        length = float(np.linalg.norm(quaternion))
        is_unit = abs(length - 1) < settings.rounded
        return tuple((quaternion / length).tolist()) if is_unit else None
    if len(given) != 3 or not all(one in AXES for one in given):
        return None
    matrix = np.array([AXES[str(one)] for one in given])
    if round(float(np.linalg.det(matrix))) != 1:
        return None
    return tuple(Rotation.from_matrix(matrix).as_quat(scalar_first=True).tolist())


def _count_columns(name: str) -> int:
    """How many columns a name or a slice stands for."""
    found = _SLICE.fullmatch(name)
    return max(int(found["stop"]) - int(found["start"]), 0) if found else 1


def _expand_slice(name: str) -> list[str]:
    """The columns of a slice such as "pose[0:7]"; any other name is one column."""
    found = _SLICE.fullmatch(name)
    if not found:
        return [name]
    return [f"{found['name']}[{i}]" for i in range(int(found["start"]), int(found["stop"]))]
