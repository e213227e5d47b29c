"""The checks of raw logs, and of what stands in them beside the mapping."""

from collections.abc import Iterator, Sequence
from pathlib import Path

from dropo.data.checks.findings import Finding, errors_first
from dropo.logs.guessing.base import moving_base
from dropo.logs.guessing.sensors import SensorColumns, find_sensor_columns, match_sensors
from dropo.logs.guessing.servos import CommandSize, command_sizes
from dropo.logs.guessing.words import read_names
from dropo.logs.log_checks import DEFAULTS, LogCheckSettings, check_runs
from dropo.logs.mapping import Mapping
from dropo.logs.readers.reader import Log, open_log
from dropo.logs.recordings import LogRun
from dropo.logs.sensor_pairs import sensor_findings
from dropo.mjmodel.dynamics.drives import command_kind
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
    found += _check_commands(mapping, robot)
    if not any(finding.level == "error" for finding in found):
        found += _say_sizes(runs, robot)
    if logs:
        found += _check_unused_sensors(open_log(logs[0]), mapping, robot)
    for path in logs:
        log = open_log(path)
        moves = moving_base(log, robot, _sensor_columns(log, mapping, robot))
        if moves is not None:
            found.append(moves)
            break  # one line for all logs
    return errors_first(found)


def _check_commands(mapping: Mapping, robot: ModelJoints) -> Iterator[Finding]:
    """Commands of forces, volts or amperes for servos, which take positions or speeds."""
    for channel in mapping.channels:
        if channel.field != "ctrl" or channel.units[0] not in ("N m", "N", "V", "A"):
            continue
        kind = command_kind(robot.model, robot.actuators[channel.name].id)
        if kind == "torque":
            continue
        unit = channel.units[0]
        text = f"its commands are in {unit}, and the model's actuator takes a {kind}."
        advice = "Map the commanded positions or speeds, or give the model a `<motor>` there."
        yield Finding("error", channel.label, text, advice)


def _say_sizes(runs: Sequence[LogRun], robot: ModelJoints) -> Iterator[Finding]:
    """What commands do that are no forces, where the model's motors take forces."""
    if not any(one.channel.field == "ctrl" for run in runs for one in run.series):
        return
    by_unit: dict[str, list[CommandSize]] = {}
    for size in command_sizes(runs, robot):
        by_unit.setdefault(size.unit, []).append(size)
    for unit, sizes in by_unit.items():
        if not unit and all(0.1 < size.factor < 10 for size in sizes):
            continue  # plain numbers, which may well be forces
        joints = [robot.actuators[size.actuator].joint for size in sizes]
        named = []
        for size, joint in zip(sizes, joints, strict=True):
            force = joint.force if joint is not None else "N m"
            damping = joint.damping if joint is not None else ""
            named.append(
                f"{size.actuator}: {size.force:.3g} {force}, with {size.damping:.3g} {damping}"
            )
        signal = ", ".join(f"ctrl.{size.actuator}" for size in sizes)
        what = f"in {unit}" if unit else "plain numbers"
        text = (
            f"commands are {what}, and the model's motors take forces: a command of 1 acts here "
            "about as "
            f"{'; '.join(named)} of viscous friction, back EMF included (by least squares)."
        )
        advice = (
            "Set the motors' `gear` to that, or let a diagnosis name the gain (actuator_gain) and "
            "the damping (joint_damping)."
        )
        yield Finding("warning", signal, text, advice)


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
