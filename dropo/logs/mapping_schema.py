"""The schema of mapping files: every key with its type, its default and a sentence for editors."""

from typing import Annotated, Literal

from pydantic import AfterValidator, ConfigDict, Field, WithJsonSchema, model_validator

from dropo.core.services.files.file_schema import (
    BY_SHAPE,
    LIST,
    SINGLE,
    Entry,
    Expected,
    ExpectedName,
    Finite,
    Key,
    Number,
    Word,
    refuse,
)
from dropo.logs.units import TICKS, UNITS

COLUMNS = "a list of columns, or a slice such as 'pose[0:7]'"
UNIT = "a unit, or a list of one for each column"
ROTATION = "a quaternion [w, x, y, z], or three axes of the log such as [y, -x, z]"


def _check_sign(sign: float) -> float:
    """The sign, where it is one."""
    if abs(sign) != 1:
        refuse("1 or -1")
    return sign


Column = Annotated[Word, Expected("the name of a column")]
Text = Annotated[Word, Expected("a text")]
_UNITS = [{"enum": list(UNITS)}, {"type": "string", "pattern": f"^{TICKS}$"}]
Unit = Annotated[str, WithJsonSchema({"anyOf": _UNITS})]
Sign = Annotated[Number, AfterValidator(_check_sign), WithJsonSchema({"enum": [1, -1]})]


class ClockEntry(Entry):
    """The time stamps of rows."""

    column: Column | None = None
    """The column of the stamps; left out, the log's own clock, where its kind has one."""
    unit: Annotated[Literal["s", "ms", "us", "ns"], ExpectedName("a unit of time")] = "s"
    """The unit of the stamps."""


class OtherClockEntry(ClockEntry):
    """The time stamps of columns that do not stand beside the log's."""

    same: Annotated[bool, Expected("true, where these are stamps of the log's clock, or false")] = (
        False
    )
    """true: the log's own clock, in another column or unit; left out, another clock, whose delay
    and skew are found."""


class TimeEntry(ClockEntry):
    """The clock of a log, and where its columns stand."""

    file: Text | None = None
    """A file beside the log that holds the columns, such as '{stem}_imu.csv'."""
    topic: Text | None = None
    """The topic of the log that holds the columns."""


class ChannelEntry(Entry):
    """The columns of a joint or an actuator: value = unit (sign column + offset)."""

    column: Column | None = None
    """The column, for what has one number."""
    columns: (
        Annotated[Word | Annotated[list[Word], Field(min_length=1)], Expected(COLUMNS)] | None
    ) = None
    """The columns, for joints of several numbers: a list, or a slice such as 'pose[0:7]'."""
    unit: Annotated[Unit | list[Unit], Expected(UNIT)] | None = None
    """The unit of the columns, one for all or a list; left out, the SI unit."""
    sign: Annotated[
        Annotated[Sign, SINGLE] | Annotated[list[Sign], LIST], BY_SHAPE, Expected("a number")
    ] = 1.0
    """-1 where the column counts the other way round: one for all columns, or a list."""
    offset: Annotated[
        Annotated[Number, SINGLE] | Annotated[list[Number], LIST], BY_SHAPE, Expected("a number")
    ] = 0.0
    """What is added, in the column's own unit: one number for all columns, or a list."""
    file: Text | None = None
    """A file beside the log that holds the columns, such as '{stem}_imu.csv' or
    'commands_{number}.csv', with the last number of the log's name."""
    topic: Text | None = None
    """The topic of the log that holds the columns."""
    clock: (
        Annotated[OtherClockEntry, Expected("a mapping such as {column: t, unit: us}")] | None
    ) = None
    """The stamps of these columns, where they are others than the log's."""


class SensorEntry(ChannelEntry):
    """The columns of a sensor: value = rotation (unit (sign column + offset))."""

    rotation: Annotated[list[Number | Word], Expected(ROTATION)] | None = None
    """How a sensor that is mounted turned stands in the model's: a quaternion w, x, y, z that turns
    its axes into the model's, or the axis of the log that is the model's x, y and z."""


class RunEntry(Entry):
    """Which runs a log holds, and which of them to take."""

    column: Annotated[Word, Expected("the column that tells runs apart")] | None = None
    """The column whose value is another in every run."""
    only: (
        Annotated[
            Annotated[list[Word], Field(min_length=1)],
            Expected("names of runs, or patterns such as 'A0_*'"),
        ]
        | None
    ) = None
    """The runs to take, by name or pattern; left out, all of them."""


Joints = Annotated[
    dict[Key, Annotated[ChannelEntry, Expected("a mapping such as {column: q1, unit: rad}")]],
    Expected("a mapping from joint names to columns"),
]
Actuators = Annotated[
    dict[Key, Annotated[ChannelEntry, Expected("a mapping such as {column: tau1, unit: N m}")]],
    Expected("a mapping from actuator names to columns"),
]

Sensors = Annotated[
    dict[Key, Annotated[SensorEntry, Expected("a mapping such as {columns: [gx, gy, gz]}")]],
    Expected("a mapping from sensor names to columns"),
]


class MappingFile(Entry):
    """A mapping file of dropo: which column of a log is which joint or actuator of a model."""

    model_config = ConfigDict(
        json_schema_extra={"required": ["qpos"], "not": {"required": ["ctrl", "inputs"]}}
    )

    time: Annotated[TimeEntry, Expected("a mapping such as {column: t, unit: s}")] = TimeEntry()
    """The time stamps of the log's rows."""
    qpos: Annotated[Joints, Field(json_schema_extra={"minProperties": 1})] = {}
    """The positions, by joint; at least one."""
    qvel: Joints = {}
    """The velocities, by joint; left out, they are estimated from the positions."""
    ctrl: Actuators = {}
    """The commands, by actuator."""
    sensordata: Sensors = {}
    """What other sensors of the model show, by sensor: gyros, accelerometers, forces, ..."""
    inputs: Annotated[
        dict[Key, Actuators],
        Expected("a mapping from candidates to commands, each as under `ctrl`"),
    ] = {}
    """Several candidates for the commands, by names of your own; each has the same actuators."""
    run: Annotated[RunEntry, Expected("a mapping such as {column: run}")] = RunEntry()
    """How runs are told apart in one log."""
    rate: (
        Annotated[
            Annotated[Finite, Field(gt=0)],
            Expected("the control steps of a second [Hz], above 0"),
        ]
        | None
    ) = None
    """The control steps of a second [Hz]; left out, the model's, or the log's median."""

    @model_validator(mode="after")
    def _check_joints(self) -> "MappingFile":
        if not self.qpos:
            refuse("at least one joint by name", key="qpos", got="none")
        missing = sorted(set(self.qvel) - set(self.qpos))
        if missing:
            expected = "velocities of joints whose positions are mapped"
            refuse(expected, key="qvel", got=f"{', '.join(missing)} without one")
        return self

    @model_validator(mode="after")
    def _check_candidates(self) -> "MappingFile":
        if {"ctrl", "inputs"} <= self.model_fields_set:
            expected = "either `ctrl` or, for several candidates, `inputs`"
            refuse(expected, key="inputs", got="both")
        if len({frozenset(actuators) for actuators in self.inputs.values()}) > 1:
            each = (f"{name}: {', '.join(found)}" for name, found in self.inputs.items())
            refuse("the same actuators in every candidate", key="inputs", got="; ".join(each))
        return self
