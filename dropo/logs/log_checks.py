"""The checks of a raw log: its stamps, its columns, and whether motion fits its velocity."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from dropo.core.records.trajectories import Ints
from dropo.core.services.validation import Array
from dropo.data.checks.columns import (
    Column,
    ColumnSettings,
    check_limits,
    check_marks,
    check_motion,
    check_turns,
    describe_coarse,
    describe_still,
    is_coarse,
    is_still,
    unwrap,
)
from dropo.data.checks.findings import Finding, errors_first
from dropo.data.checks.kinematics import (
    Displacements,
    KinematicsSettings,
    check_fall,
    check_motions,
    displacement_noise,
    fall_accelerations,
    rotation_vectors,
)
from dropo.logs.guessing.words import tokens
from dropo.logs.recordings import LogRun, TimeSeries
from dropo.logs.signals.stamps import (
    StampSettings,
    check_stamps,
    check_values,
    find_gaps,
    increasing,
)
from dropo.mjmodel.joints import Joint, ModelJoints


@dataclass(frozen=True)
class LogCheckSettings:
    """What makes a raw log look odd.

    Attributes
    ----------
    quaternion_norm : float
        How far a quaternion's norm may be from 1.
    quaternion_order : float
        Another order of a quaternion is the right one where the logged angular velocity then leaves
        less than this fraction of its turns unexplained.
    degrees : float
        Angles are in degrees where, as rad, they reach so many times as far as a joint's range.
    carries_on : float
        A clock has jumped where the moving joints went over a gap by what their speed makes of one
        usual step, within this fraction of it.
    stamps : StampSettings
        What makes time stamps look odd.
    columns : ColumnSettings
        What makes single columns look odd.
    motion : KinematicsSettings
        What makes velocities and free fall look odd.
    """

    quaternion_norm: float = 0.05
    quaternion_order: float = 0.5
    degrees: float = 3.0
    carries_on: float = 0.5
    stamps: StampSettings = field(default_factory=StampSettings)
    columns: ColumnSettings = field(default_factory=ColumnSettings)
    motion: KinematicsSettings = field(default_factory=KinematicsSettings)


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
    alike = _AlikeColumns()
    for run in runs:
        name = run.name if len(runs) > 1 else None
        for stamps in run.stamps:
            found += check_stamps(stamps.name, stamps.time, stamps.rows, name, settings.stamps)
        series = []
        lengths = {len(stamps.time) for stamps in run.stamps}
        for logged in run.series:
            ordered = logged.take(increasing(logged.time))
            is_sensor = logged.channel.field == "sensordata"
            if is_sensor and len(logged.time) not in lengths:  # some rows have no value
                found += check_values(
                    ordered.label, ordered.time, ordered.rows, name, settings.stamps
                )
            if _is_angle(ordered, robot):
                found += _check_degrees(ordered, robot, name, settings)
                found += check_turns(next(_columns(ordered, robot, name)))
                ordered = replace(ordered, values=unwrap(ordered.values[:, 0])[:, None])
            for column in _columns(ordered, robot, name):
                found += check_marks(column, settings.columns)
                found += alike.check(column, settings.columns)
            series.append(ordered)
        found += _check_clock(series, robot, name, settings)
        for joint in robot.joints.values():
            found += _check_joint(joint, series, robot.gravity, name, settings)
            for motion in _displacements(joint, series, name):
                motions.setdefault(motion.velocity, []).append(motion)
    for of_all_runs in motions.values():
        found += check_motions(of_all_runs, settings.motion)
    found += alike.describe()
    return errors_first(found)


class _AlikeColumns:
    """Columns of which one line for all says what is odd: those that are still, or coarse."""

    def __init__(self) -> None:
        self._still: dict[str, list[Column]] = {}
        self._coarse: dict[str, list[Column]] = {}

    def check(self, column: Column, settings: ColumnSettings) -> Iterator[Finding]:
        """Find what is odd in a column alone."""
        if is_still(column):
            self._still.setdefault(column.name, []).append(column)
            return
        yield from check_motion(column, settings)
        if column.sensor and is_coarse(column, settings):
            kind = f"{column.name.partition('.')[0]} {column.unit}"
            self._coarse.setdefault(kind, []).append(column)
        yield from check_limits(column, settings)

    def describe(self) -> Iterator[Finding]:
        """Say what is odd in several of them."""
        for columns in self._still.values():
            yield from describe_still(columns)
        for columns in self._coarse.values():
            yield from describe_coarse(columns)


def _is_angle(series: TimeSeries, robot: ModelJoints) -> bool:
    """Whether these are the positions of a hinge."""
    channel = series.channel
    return channel.field == "qpos" and robot.joints[channel.name].kind == "hinge"


def _check_degrees(
    series: TimeSeries, robot: ModelJoints, run: str | None, settings: LogCheckSettings
) -> Iterator[Finding]:
    """Angles that are within a joint's range in degrees, and far outside it in rad."""
    joint = robot.joints[series.channel.name]
    is_rad = series.channel.units == ("rad",) and series.channel.factors == (1.0,)
    if joint.range is None or not is_rad:
        return
    low, high = joint.range
    values = series.values[:, 0]
    reach = max(abs(low), abs(high))
    row = int(np.argmax(np.abs(values)))
    degrees = values * np.pi / 180
    slack = 0.1 * (high - low)
    fits = degrees.min() >= low - slack and degrees.max() <= high + slack
    if abs(values[row]) > settings.degrees * reach and fits:
        text = (
            f"it reaches {values[row]:.6g} rad, row {series.rows[row]} at {series.time[row]:.6g} "
            f"s, where the joint's range is [{low:.4g}, {high:.4g}] rad: these are degrees."
        )
        place = int(series.rows[row])
        yield Finding(
            "error", series.label, text, "Map `unit: deg`.", run, place, float(series.time[row])
        )


def _check_clock(
    series: Sequence[TimeSeries], robot: ModelJoints, run: str | None, settings: LogCheckSettings
) -> Iterator[Finding]:
    """A clock that jumps forward while the joints go on as if no time had passed."""
    seen: set[int] = set()
    angles = [one for one in series if one.channel.field == "qpos" and one.values.shape[1] == 1]
    for one in angles:
        gaps = [gap for gap in find_gaps(one.time).tolist() if one.rows[gap] not in seen]
        for gap in gaps:
            is_whole = int(one.rows[gap] - one.rows[gap - 1]) == 1  # no row without a value
            if not is_whole or not _clock_jumps(angles, one, gap, settings):
                continue
            seen.add(int(one.rows[gap]))
            jump = float(one.time[gap] - one.time[gap - 1])
            text = (
                f"the clock jumps by {jump:.4g} s, row {one.rows[gap]} at {one.time[gap]:.6g} s: "
                "the joints go on as if no time had passed."
            )
            advice = "Cut the log there, or map a clock that does not jump."
            signal = "time"
            yield Finding(
                "error", signal, text, advice, run, int(one.rows[gap]), float(one.time[gap])
            )
            return


def _clock_jumps(
    angles: Sequence[TimeSeries], first: TimeSeries, gap: int, settings: LogCheckSettings
) -> bool:
    """Whether the moving joints went on over a gap by a usual step, and not by what time passed."""
    moving = 0
    for one in angles:
        if len(one.time) != len(first.time) or gap < 6 or gap + 6 > len(one.time):
            continue
        values = one.values[:, 0]
        step = float(np.median(np.diff(one.time[gap - 6 : gap])))
        before = float(values[gap - 1] - values[gap - 6]) / (5 * step)
        after = float(values[gap + 5] - values[gap]) / (5 * step)
        speed = 0.5 * (before + after)
        noise = float(np.abs(np.diff(values[gap - 6 : gap], n=2)).max())
        is_moving = before * after > 0 and abs(speed) * step > 3 * noise
        if not is_moving:
            continue
        moving += 1
        moved = float(values[gap] - values[gap - 1])
        if abs(moved - speed * step) > settings.carries_on * abs(speed) * step + noise:
            return False
    return moving > 0


def _columns(series: TimeSeries, robot: ModelJoints, run: str | None) -> Iterator[Column]:
    """The columns of a series, with the limits of the joint or actuator."""
    channel = series.channel
    width = len(channel.columns)
    names = [f"{series.label}[{i}]" for i in range(width)] if width > 1 else [series.label]
    limits = None
    quaternion = None
    whole = channel.field == "sensordata" and width > 1 and np.ptp(series.values, axis=0).any()
    if channel.field == "ctrl":
        limits = robot.actuators[channel.name].range
    elif channel.field == "qpos":
        quaternion = robot.joints[channel.name].quaternion()
        limits = robot.joints[channel.name].range if width == 1 else None
    for i, name in enumerate(names):
        values = series.values[:, i]
        if quaternion is not None and i >= quaternion.start and np.ptp(values) == 0:
            continue  # a rotation about one axis leaves some of the four at rest
        if whole and np.ptp(values) == 0:
            continue  # as does a sensor of several axes that moves in a plane
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
        order = _other_order(joint, positions, _find_series("qvel", joint, series), settings)
        if order is not None:
            text = f"its quaternion is in the order {order}."
            advice = "Map the four columns in the order w, x, y, z."
            yield Finding("error", positions.label, text, advice, run)
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


def _other_order(
    joint: Joint,
    positions: TimeSeries,
    velocities: TimeSeries | None,
    settings: LogCheckSettings,
) -> str | None:
    """The order of a quaternion that is not w, x, y, z, by its columns' names or its turns."""
    place = joint.quaternion() or slice(0, 0)
    letters = [tokens(column)[-1:] for column in positions.channel.columns[place]]
    named = [word[0][-1] if word else "" for word in letters]
    if sorted(named) == ["w", "x", "y", "z"] and named != ["w", "x", "y", "z"]:
        return ", ".join(named)
    if (
        velocities is None
        or len(velocities.time) != len(positions.time)
        or len(velocities.time) < 5
    ):
        return None
    quaternions = positions.values[:, place]
    steps = np.diff(positions.time)[:, None]
    turns = velocities.values[:, -3:]
    integral = (turns[1:] + turns[:-1]) / 2 * steps
    near = np.ones(len(steps), dtype=bool)
    near[find_gaps(positions.time) - 1] = False

    def unexplained(order: list[int]) -> float:
        ordered = quaternions[:, order]
        change = rotation_vectors(ordered[:-1], ordered[1:]) - integral
        return float(np.sum(change[near] ** 2) / max(np.sum(integral[near] ** 2), 1e-300))

    if unexplained([0, 1, 2, 3]) > 0.5 and unexplained([3, 0, 1, 2]) < settings.quaternion_order**2:
        return "x, y, z, w"
    return None


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
