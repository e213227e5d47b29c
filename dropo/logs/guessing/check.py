"""The checks of raw logs, and of what stands in them beside the mapping."""

from collections.abc import Iterator, Sequence
from pathlib import Path

from dropo.data.checks.findings import Finding, errors_first
from dropo.logs.guessing.base import moving_base
from dropo.logs.guessing.sensors import SensorColumns, find_sensor_columns, match_sensors
from dropo.logs.guessing.words import read_names
from dropo.logs.log_checks import DEFAULTS, LogCheckSettings, check_runs
from dropo.logs.mapping import Mapping
from dropo.logs.readers.reader import Log, open_log
from dropo.logs.recordings import LogRun
from dropo.logs.sensor_pairs import sensor_findings
from dropo.mjmodel.joints import ModelJoints

_ELEMENTS = {
    "gyro": '`<gyro name="imu_gyro" site="imu"/>`',
    "accelerometer": '`<accelerometer name="imu_acc" site="imu"/>`',
    "framequat": '`<framequat name="imu_quat" objtype="site" objname="imu"/>`',
}
"""What to write into a model, by kind of sensor."""


def check_logs(
    logs: Sequence[str | Path],
    runs: Sequence[LogRun],
    mapping: Mapping,
    robot: ModelJoints,
    settings: LogCheckSettings = DEFAULTS,
) -> list[Finding]:
    """Find what looks odd in raw logs, and where they and the model do not belong together.

    Parameters
    ----------
    logs : sequence of str or Path
        The logs.
    runs : sequence of LogRun
        Their runs as they were read.
    mapping : Mapping
        Which columns are what.
    robot : ModelJoints
        The robot.
    settings : LogCheckSettings, optional
        What counts as odd.

    Returns
    -------
    list of Finding
        Errors first.
    """
    found = check_runs(runs, robot, settings)
    if not any(finding.level == "error" for finding in found):
        found += sensor_findings(runs, robot)
    found += _check_joints(mapping, robot)
    if logs:
        found += _check_unused_sensors(open_log(logs[0]), mapping, robot)
    for path in logs:
        log = open_log(path)
        moves = moving_base(log, robot, _sensor_columns(log, mapping, robot))
        if moves is not None:
            found.append(moves)
            break  # one line for all logs
    return errors_first(found)


def _mapped_columns(mapping: Mapping) -> set[tuple[str | None, str]]:
    """Topic and name of the columns of the log that are mapped as sensors."""
    found = set()
    for channel in mapping.of("sensordata"):
        if channel.source.file is None:
            found |= {(channel.source.topic, column) for column in channel.columns}
    return found


def _groups(log: Log, robot: ModelJoints) -> list[SensorColumns]:
    """The columns of a log that are called as those of an IMU are."""
    return find_sensor_columns(read_names(log, [*robot.joints, *robot.actuators]))


def _sensor_columns(log: Log, mapping: Mapping, robot: ModelJoints) -> set[tuple[str | None, str]]:
    """Topic and name of the columns of sensors of the model, which are not its base's."""
    found = _mapped_columns(mapping)
    matched, _ = match_sensors(_groups(log, robot), robot)
    for group in matched.values():
        found |= {(one.topic, one.column) for one in group.columns}
    return found


def _check_unused_sensors(log: Log, mapping: Mapping, robot: ModelJoints) -> Iterator[Finding]:
    """Columns of IMUs that are not mapped, with or without such a sensor in the model."""
    mapped = _mapped_columns(mapping)
    mapped |= {
        (channel.source.topic, column)
        for channel in mapping.channels
        if channel.source.file is None
        for column in channel.columns
    }
    taken = {channel.name for channel in mapping.of("sensordata")}
    groups = []
    for group in _groups(log, robot):
        if not any((one.topic, one.column) in mapped for one in group.columns):
            groups.append(group)
    matched, left = match_sensors(groups, robot)
    for name, group in matched.items():
        if name in taken:
            continue
        signal = f"sensordata.{name}"
        text = f"the model has this {group.kind}, and the log's {_named(group)} are not mapped."
        advice = f"Map them under `sensordata: {{{name}: {{columns: [...]}}}}` to use them."
        yield Finding("information", signal, text, advice)
    kinds = {sensor.kind for sensor in robot.sensors.values()}
    for group in left:
        if group.kind not in kinds:
            text = f"the log has {_named(group)}, and the model no {group.kind} that has a name."
            advice = f"Add one to the model's `<sensor>` to use them: {_ELEMENTS[group.kind]}."
            yield Finding("information", "sensordata", text, advice)


def _named(group: SensorColumns) -> str:
    """The columns of a sensor, for a message."""
    return ", ".join(repr(one.column) for one in group.columns)


def _check_joints(mapping: Mapping, robot: ModelJoints) -> Iterator[Finding]:
    """Joints that are commanded and whose position is not in the log."""
    measured = {channel.name for channel in mapping.of("qpos")}
    commanded = [channel.name for channel in mapping.channels if channel.field == "ctrl"]
    blind = []
    for name in dict.fromkeys(commanded):
        joint = robot.actuators[name].joint
        if joint is not None and joint.name not in measured:
            blind.append(joint.name)
    if blind:
        text = f"commanded, and without a position in the log: {', '.join(blind)}."
        advice = "Such joints start where the model has them, at rest."
        yield Finding("warning", "qpos", text, advice)
