"""The checks of a raw log: its stamps, its columns, and whether motion fits its velocity."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from dropo.core.records.trajectories import Ints
from dropo.core.services.validation import Array
from dropo.data.checks.columns import (
    Column,
    ColumnSettings,
    check_column,
    check_marks,
    check_turns,
    unwrap,
)
from dropo.data.checks.findings import Finding, errors_first
from dropo.data.checks.kinematics import (
    Displacements,
    MotionSettings,
    check_fall,
    check_motions,
    displacement_noise,
    fall_accelerations,
    rotation_vectors,
)
from dropo.logs.recordings import LogRun, TimeSeries
from dropo.logs.signals.stamps import StampSettings, check_stamps, find_gaps, increasing
from dropo.mjmodel.joints import Joint, ModelJoints


@dataclass(frozen=True)
class LogCheckSettings:
    """What makes a raw log look odd.

    Attributes
    ----------
    quaternion_norm : float
        How far a quaternion's norm may be from 1.
    stamps : StampSettings
        Of time stamps.
    columns : ColumnSettings
        Of single columns.
    motion : MotionSettings
        Of velocities and free fall.
    """

    quaternion_norm: float = 0.05
    stamps: StampSettings = field(default_factory=StampSettings)
    columns: ColumnSettings = field(default_factory=ColumnSettings)
    motion: MotionSettings = field(default_factory=MotionSettings)


DEFAULTS = LogCheckSettings()


def check_runs(
    runs: Sequence[LogRun], robot: ModelJoints, settings: LogCheckSettings = DEFAULTS
) -> list[Finding]:
    """Find what looks odd in raw logs.

    Parameters
    ----------
    runs : sequence of LogRun
        The runs as they were read.
    robot : ModelJoints
        The joints and actuators of the model.
    settings : LogCheckSettings, optional
        What counts as odd.

    Returns
    -------
    list of Finding
        Errors first; each names its run where there are several.
    """
    found: list[Finding] = []
    motions: dict[str, list[Displacements]] = {}
    for run in runs:
        name = run.name if len(runs) > 1 else None
        for stamps in run.stamps:
            found += check_stamps(stamps.name, stamps.time, stamps.rows, name, settings.stamps)
        series = []
        for logged in run.series:
            ordered = logged.take(increasing(logged.time))
            if _is_angle(ordered, robot):
                found += check_turns(next(_columns(ordered, robot, name)))
                ordered = replace(ordered, values=unwrap(ordered.values[:, 0])[:, None])
            for column in _columns(ordered, robot, name):
                found += check_marks(column, settings.columns)
                found += check_column(column, settings.columns)
            series.append(ordered)
        for joint in robot.joints.values():
            found += _check_joint(joint, series, robot.gravity, name, settings)
            for motion in _displacements(joint, series, name):
                motions.setdefault(motion.velocity, []).append(motion)
    for of_all_runs in motions.values():
        found += check_motions(of_all_runs, settings.motion)
    return errors_first(found)


def _is_angle(series: TimeSeries, robot: ModelJoints) -> bool:
    """Whether these are the positions of a hinge."""
    channel = series.channel
    return channel.field == "qpos" and robot.joints[channel.name].kind == "hinge"


def _columns(series: TimeSeries, robot: ModelJoints, run: str | None) -> Iterator[Column]:
    """The columns of a series, with the limits of the joint or actuator."""
    channel = series.channel
    width = len(channel.columns)
    names = [f"{series.label}[{i}]" for i in range(width)] if width > 1 else [series.label]
    limits = None
    quaternion = None
    if channel.field == "ctrl":
        limits = robot.actuators[channel.name].range
    elif channel.field == "qpos":
        quaternion = robot.joints[channel.name].quaternion()
        limits = robot.joints[channel.name].range if width == 1 else None
    for i, name in enumerate(names):
        values = series.values[:, i]
        if quaternion is not None and i >= quaternion.start and np.ptp(values) == 0:
            continue  # a rotation about one axis leaves some of the four at rest
        yield Column(
            name=name,
            unit=channel.units[i],
            time=series.time,
            values=values,
            rows=series.rows,
            sensor=channel.field != "ctrl",
            limits=limits,
            breaks=find_gaps(series.time),
            run=run,
        )


def _check_joint(
    joint: Joint,
    series: list[TimeSeries],
    gravity: Array,
    run: str | None,
    settings: LogCheckSettings,
) -> Iterator[Finding]:
    """The norm of a joint's quaternion, and the free fall of a free joint."""
    positions = _find_series("qpos", joint, series)
    if positions is None:
        return
    quaternion = joint.quaternion()
    if quaternion is not None:
        norms = np.linalg.norm(positions.values[:, quaternion], axis=1)
        worst = int(np.argmax(np.abs(norms - 1)))
        if abs(norms[worst] - 1) > settings.quaternion_norm:
            row = int(positions.rows[worst])
            time = float(positions.time[worst])
            text = (
                f"a quaternion must have length 1, and one has {norms[worst]:.6g}, row {row} at "
                f"{time:.6g} s."
            )
            advice = "Map the four columns in the order w, x, y, z."
            yield Finding("error", positions.label, text, advice, run, row, time)
            return
    if joint.kind == "free":
        for piece in _pieces(positions):
            part = positions.take(piece)
            found, first = fall_accelerations(part.time, part.values[:, :3], settings.motion)
            rows = part.rows[first]
            times = part.time[first]
            yield from check_fall(
                positions.label, found, gravity, rows, times, run, settings.motion
            )


def _find_series(field: str, joint: Joint, series: list[TimeSeries]) -> TimeSeries | None:
    """The series of a joint's positions or velocities."""
    for one in series:
        if one.channel.field == field and one.channel.name == joint.name:
            return one
    return None


def _pieces(series: TimeSeries) -> list[Ints]:
    """The rows between gaps."""
    pieces = np.split(np.arange(len(series.time)), find_gaps(series.time))
    return [piece for piece in pieces if len(piece) > 1]


def _displacements(
    joint: Joint, series: list[TimeSeries], run: str | None
) -> Iterator[Displacements]:
    """Every number of a joint whose velocity was logged; a quaternion turns by three."""
    positions = _find_series("qpos", joint, series)
    velocities = _find_series("qvel", joint, series)
    if positions is None or velocities is None:
        return
    # the rows of the position in which there is a velocity, too
    inside = (positions.time >= velocities.time[0]) & (positions.time <= velocities.time[-1])
    if inside.sum() < 3:
        return
    positions = positions.take(inside)
    time = positions.time
    # the velocity's integral from row to row, by the trapezoidal rule
    columns = [np.interp(time, velocities.time, column) for column in velocities.values.T]
    speeds = np.stack(columns, axis=1)
    steps = np.diff(time)
    integral = (speeds[1:] + speeds[:-1]) / 2 * steps[:, None]
    # what the position moves meanwhile
    quaternion = joint.quaternion()
    values = positions.values
    linear = values if quaternion is None else values[:, : quaternion.start]
    displacement = np.diff(linear, axis=0)
    if quaternion is not None:
        rotations = rotation_vectors(values[:-1, quaternion], values[1:, quaternion])
        displacement = np.hstack([displacement, rotations])
    breaks = np.zeros(len(time), dtype=np.int64)
    breaks[find_gaps(time)] = 1
    pieces = np.cumsum(breaks)[:-1]
    width = displacement.shape[1]
    for i in range(width):
        suffix = f"[{i}]" if width > 1 else ""
        yield Displacements(
            name=f"{positions.label}{suffix}",
            velocity=f"{velocities.label}{suffix}",
            displacement=displacement[:, i],
            integral=integral[:, i],
            noise=displacement_noise(displacement[:, i]),
            step=float(np.median(steps)),
            rows=positions.rows[:-1],
            time=time[:-1],
            pieces=pieces,
            run=run,
        )
