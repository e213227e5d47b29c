"""What looks odd in data: time, single columns, motion, copies and short trajectories.

In reading order: `check` and `find_error` run the checks, `_CheckedData` is what each of them is
given, and each yields findings.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from dropo.core.contracts.problem import Problem
from dropo.core.contracts.simulator import Simulator
from dropo.core.records.trajectories import Ints, Trajectories
from dropo.core.services.validation import Array
from dropo.data.checks.columns import (
    Column,
    ColumnSettings,
    check_column,
    check_limits,
    check_marks,
)
from dropo.data.checks.findings import Finding, Level, errors_first
from dropo.data.checks.kinematics import (
    Displacements,
    KinematicsSettings,
    check_fall,
    check_motions,
    displacement_noise,
    fall_accelerations,
    rotation_vectors,
)
from dropo.data.checks.sensors import SensorPair, check_sensors
from dropo.data.describe import columns, controls, simulator_of
from dropo.mjmodel.joints import Joint, actuators, all_joints, model_joints
from dropo.mjmodel.robot_simulator import RobotSimulator
from dropo.mjmodel.sensors import named_sensors, sensors_along

REIMPORT = "`dropo data import` resamples logs on the control step and ends trajectories at gaps."
MOST_NUMBERS = 8  # trajectories that a message lists
COMPARED = ("gyro", "accelerometer", "velocimeter")
"""Kinds of sensors that are compared with the model's own."""


@dataclass(frozen=True)
class CheckSettings:
    """What makes data look odd.

    Attributes
    ----------
    short : int
        A trajectory of fewer transitions says little.
    rounded_norm : float
        How far a quaternion's norm may be from 1 by the rounding of a log file.
    wrong_norm : float
        How far a quaternion's norm must be from 1 for an error.
    rate : float
        How far the rows' median distance may be from the control step, as a fraction of it.
    jitter : float
        How far the rows' distances may be from their median (rms), as a fraction of it.
    gap : float
        A distance of rows above this many medians is a gap.
    sensor_rows : int
        Largest number of rows in which sensors are compared.
    columns : ColumnSettings
        What makes single columns look odd.
    motion : KinematicsSettings
        What makes velocities and free fall look odd.
    """

    short: int = 5
    rounded_norm: float = 1e-3
    wrong_norm: float = 0.05
    rate: float = 0.02
    jitter: float = 0.05
    gap: float = 1.5
    sensor_rows: int = 1000
    columns: ColumnSettings = field(default_factory=ColumnSettings)
    motion: KinematicsSettings = field(default_factory=KinematicsSettings)


DEFAULTS = CheckSettings()


def check(
    trajectories: Trajectories,
    source: Problem | Simulator | None = None,
    settings: CheckSettings = DEFAULTS,
) -> list[Finding]:
    """Find what looks odd in data.

    Parameters
    ----------
    trajectories : Trajectories
        The data.
    source : Problem or Simulator, optional
        What they are for; without it less can be checked.
    settings : CheckSettings, optional
        What counts as odd.

    Returns
    -------
    list of Finding
        Errors first.
    """
    data = _CheckedData(trajectories, simulator_of(source), settings)
    found = [*_possible_errors(data), *_check_jitter(data)]
    for column in _columns(data):
        found += check_column(column, settings.columns)
    found += _check_copies(data)
    found += _check_lengths(data)
    if isinstance(source, Problem):
        found += shorter_than_lambda(source)
    found += _check_continuity(data)
    return errors_first(found)


def find_error(
    trajectories: Trajectories, simulator: Simulator | None, settings: CheckSettings = DEFAULTS
) -> Finding | None:
    """Find the first error, which keeps a fit from working.

    Parameters
    ----------
    trajectories : Trajectories
        The data.
    simulator : Simulator or None
        What they are for.
    settings : CheckSettings, optional
        What counts as odd.

    Returns
    -------
    Finding or None
        None where there is no error.
    """
    for finding in _possible_errors(_CheckedData(trajectories, simulator, settings)):
        if finding.level == "error":
            return finding
    return None


def outside_control_range(
    trajectories: Trajectories, simulator: Simulator | None, settings: CheckSettings = DEFAULTS
) -> Iterator[Finding]:
    """Find actions that the model's actuators clip, so that the simulation does not apply them.

    Parameters
    ----------
    trajectories : Trajectories
        The data.
    simulator : Simulator or None
        What they are for.
    settings : CheckSettings, optional
        What counts as odd.

    Yields
    ------
    Finding
        One for each column of actions.
    """
    for column in _command_columns(_CheckedData(trajectories, simulator, settings)):
        if column.limits is None:
            continue
        low, high = column.limits
        if ((column.values < low) | (column.values > high)).any():
            yield from check_limits(column, settings.columns)


def shorter_than_lambda(problem: Problem) -> Iterator[Finding]:
    """Find trajectories that hold no segment, so that a fit does not use them.

    Parameters
    ----------
    problem : Problem
        The data, and the horizon that is compared.

    Yields
    ------
    Finding
        At most one.
    """
    lengths = [stop - start for start, stop in problem.trajectories.spans]
    short = sum(length < problem.horizon for length in lengths)
    if short and problem.reset == "transition":
        text = (
            f"{short} of {len(lengths)} trajectories are shorter than lambda = "
            f"{problem.horizon} and are left out."
        )
        yield Finding("warning", "", text)


@dataclass(frozen=True, eq=False)
class _CheckedData:
    """N transitions, the simulator that they are for, and what counts as odd."""

    trajectories: Trajectories
    simulator: Simulator | None
    settings: CheckSettings

    @property
    def control_step(self) -> float | None:
        """Seconds of a control step, where it is known."""
        return None if self.simulator is None else self.simulator.control_step

    @property
    def robot(self) -> RobotSimulator | None:
        """The simulator, where it has a model and its columns are as many as the data's."""
        if not isinstance(self.simulator, RobotSimulator):
            return None
        width = self.trajectories.observations.shape[1]
        return self.simulator if len(self.simulator.layout) == width else None

    @property
    def inside(self) -> NDArray[np.bool_]:
        """(N - 1,) whether the step from a row to the next stays in a trajectory."""
        return ~self.trajectories.terminals[:-1]

    @property
    def time(self) -> Array:
        """(N,) seconds of each row: the data's, else by the control step from the start on."""
        trajectories = self.trajectories
        if trajectories.time is not None:
            return trajectories.time
        starts = np.array([start for start, _ in trajectories.spans])
        count = np.arange(len(trajectories)) - starts[trajectories.trajectory]
        return count * float(self.control_step or 1.0)

    def joints(self) -> Iterator[tuple[Joint, list[int], list[int]]]:
        """Each observed joint, with the data's columns of its position and, if any, velocity."""
        robot = self.robot
        if robot is None:
            return
        where = {(column.field, column.place): i for i, column in enumerate(robot.layout.columns)}
        for joint in all_joints(robot.model):
            width = len(joint.units("qpos"))
            dofs = len(joint.units("qvel"))
            positions = [where.get(("qpos", joint.qpos + i), -1) for i in range(width)]
            velocities = [where.get(("qvel", joint.qvel + i), -1) for i in range(dofs)]
            if min(positions) >= 0:
                yield joint, positions, velocities if min(velocities) >= 0 else []


def _possible_errors(data: _CheckedData) -> Iterator[Finding]:
    """The findings of all checks that may find an error."""
    for column in (*_columns(data), *_following_columns(data)):
        yield from check_marks(column, data.settings.columns)
    yield from _check_quaternions(data)
    yield from _check_time(data)
    yield from _check_rate(data)
    yield from _check_velocities(data)
    yield from _check_falls(data)
    yield from _check_sensors(data)


# Time


def _check_time(data: _CheckedData) -> Iterator[Finding]:
    """Rows that are not later than the row before them in their trajectory."""
    time = data.trajectories.time
    if time is None:
        return
    back = np.flatnonzero(data.inside & (np.diff(time) <= 0))
    if len(back):
        row = int(back[0]) + 1
        text = f"{len(back)} rows are not later than the row before them, the first is row {row}."
        advice = "Take them out, or set `terminals` where the clock starts anew."
        yield Finding("error", "time", text, advice, row=row, time=float(time[row]))


def _check_rate(data: _CheckedData) -> Iterator[Finding]:
    """Rows that are not a control step apart."""
    time = data.trajectories.time
    step = data.control_step
    if time is None or step is None or not data.inside.any():
        return
    typical = float(np.median(np.diff(time)[data.inside]))
    if typical > 0 and abs(typical / step - 1) > data.settings.rate:
        simulator = data.simulator
        frame_skip = simulator.frame_skip if isinstance(simulator, RobotSimulator) else 1
        count = max(1, round(typical / step * frame_skip))
        text = (
            f"rows are {1e3 * typical:.6g} ms apart, and one control step of the model takes "
            f"{1e3 * step:.6g} ms."
        )
        advice = f"Set frame_skip to {count}, or resample the data; see also the unit of time."
        yield Finding("error", "time", text, advice, row=1, time=float(time[1]))


def _check_jitter(data: _CheckedData) -> Iterator[Finding]:
    """Gaps and jitter inside trajectories."""
    time = data.trajectories.time
    if time is None:
        return
    steps = np.diff(time)
    inside = data.inside & (steps > 0)
    if inside.sum() < 3:
        return
    typical = float(np.median(steps[inside]))
    longest_even = data.settings.gap * typical
    gaps = np.flatnonzero(inside & (steps > longest_even))
    if len(gaps):
        row = int(gaps[0]) + 1
        longest = 1e3 * float(steps[gaps].max())
        text = (
            f"{len(gaps)} steps inside trajectories are longer than {data.settings.gap:g} of "
            f"{1e3 * typical:.4g} ms, up to {longest:.4g} ms, the first before row {row}."
        )
        yield Finding("warning", "time", text, REIMPORT, row=row, time=float(time[row]))
    even = inside & (steps <= longest_even)
    jitter = float(np.sqrt(np.mean((steps[even] / typical - 1) ** 2))) if even.any() else 0.0
    if jitter > data.settings.jitter:
        row = int(np.argmax(np.where(even, np.abs(steps - typical), 0.0))) + 1
        text = (
            f"steps vary by {100 * jitter:.0f} % (rms) around {1e3 * typical:.4g} ms, most "
            f"before row {row}."
        )
        yield Finding("warning", "time", text, REIMPORT, row=row, time=float(time[row]))


# Single columns


def _columns(data: _CheckedData) -> Iterator[Column]:
    """Every observation and action column."""
    trajectories = data.trajectories
    rows = np.arange(len(trajectories))
    breaks = np.array([start for start, _ in trajectories.spans[1:]], dtype=np.int64)
    limits = {}
    for joint, positions, _ in data.joints():
        if len(positions) == 1:
            limits[positions[0]] = joint.range
    named = columns(data.simulator, trajectories.observations.shape[1])
    for i, signal in enumerate(named):
        values = trajectories.observations[:, i]
        yield Column(signal.name, signal.unit, data.time, values, rows, True, limits.get(i), breaks)
    yield from _command_columns(data)


def _following_columns(data: _CheckedData) -> Iterator[Column]:
    """Every column of the observations that follow."""
    following = data.trajectories.next_observations.T
    for column, values in zip(_columns(data), following, strict=False):  # commands come last
        yield replace(column, values=values)


def _command_columns(data: _CheckedData) -> Iterator[Column]:
    """Every action column, with the range of its actuator."""
    actions = data.trajectories.actions
    simulator = data.simulator
    n, q = actions.shape
    ranges: list[tuple[float, float] | None] = [None] * q
    if isinstance(simulator, RobotSimulator) and len(simulator.controls) == q:
        every = actuators(simulator.model)
        ranges = [every[place].range for place in simulator.controls.tolist()]
    for i, signal in enumerate(controls(simulator, q)):
        rows = np.arange(n)
        yield Column(signal.name, signal.unit, data.time, actions[:, i], rows, False, ranges[i])


def _check_quaternions(data: _CheckedData) -> Iterator[Finding]:
    """Quaternion columns that are not of unit length."""
    robot = data.robot
    if robot is None:
        return
    trajectories = data.trajectories
    states = np.vstack([trajectories.observations, trajectories.next_observations])
    for quaternion in robot.layout.quaternions:
        norms = np.linalg.norm(states[:, quaternion], axis=1)
        place = int(np.argmax(np.abs(norms - 1)))
        excess = abs(float(norms[place]) - 1)
        row = place % len(trajectories)
        if excess > data.settings.rounded_norm:
            level: Level = "error" if excess > data.settings.wrong_norm else "warning"
            name = robot.layout.names[quaternion[0]].rsplit("[", 1)[0]
            text = f"a quaternion must have length 1, and one has {norms[place]:.6g}, row {row}."
            yield Finding(level, name, text, "The order is w, x, y, z.", row=row)


# Motion


def _check_velocities(data: _CheckedData) -> Iterator[Finding]:
    """Velocities that are not those of the positions."""
    step = data.control_step
    if step is None:
        return
    trajectories = data.trajectories
    now = trajectories.observations
    following = trajectories.next_observations
    names = [signal.name for signal in columns(data.simulator, now.shape[1])]
    for joint, positions, velocities in data.joints():
        if not velocities:
            continue
        displacements = _displacements(joint, now[:, positions], following[:, positions])
        for i, place in enumerate(velocities):
            motion = Displacements(
                name=f"qpos.{joint.name}",
                velocity=names[place],
                displacement=displacements[:, i],
                integral=step * (now[:, place] + following[:, place]) / 2,
                noise=displacement_noise(displacements[:, i]),
                step=step,
                rows=np.arange(len(trajectories)),
                time=data.time,
                pieces=trajectories.trajectory,
            )
            yield from check_motions([motion], data.settings.motion)


def _displacements(joint: Joint, now: Array, following: Array) -> Array:
    """(n, nv) from positions to those that follow; a quaternion's as a rotation vector."""
    quaternion = joint.quaternion()
    if quaternion is None:
        return following - now
    linear = slice(0, quaternion.start)
    rotation = rotation_vectors(now[:, quaternion], following[:, quaternion])
    return np.hstack([following[:, linear] - now[:, linear], rotation])


def _check_falls(data: _CheckedData) -> Iterator[Finding]:
    """Free bodies that fall in another way than under the model's gravity."""
    step = data.control_step
    robot = data.robot
    if step is None or robot is None:
        return
    gravity = model_joints(robot.model).gravity
    settings = data.settings
    for joint, positions, _ in data.joints():
        if joint.kind != "free":
            continue
        accelerations = []
        rows = []
        for start, stop in data.trajectories.spans:
            if stop - start <= settings.short:
                continue
            time = step * np.arange(stop - start, dtype=np.float64)
            centre = data.trajectories.observations[start:stop, positions[:3]]
            found, first = fall_accelerations(time, centre, settings.motion)
            accelerations.append(found)
            rows.append(first + start)
        if accelerations:
            places = np.concatenate(rows)
            yield from check_fall(
                f"qpos.{joint.name}",
                np.concatenate(accelerations),
                gravity,
                places,
                data.time[places],
                settings=settings.motion,
            )


def _check_sensors(data: _CheckedData) -> Iterator[Finding]:
    """Gyros, accelerometers and orientations that the motion contradicts: unit, sign, mount."""
    for finding in check_sensors(_sensor_pairs(data)):
        advice = f"Change the data, or import their log with: {finding.advice}"
        yield replace(finding, advice=advice)


def _sensor_pairs(data: _CheckedData) -> list[SensorPair]:
    """Sensors beside the model's own along the first rows, where whole states are observed."""
    robot = data.robot
    step = data.control_step
    if robot is None or step is None or not robot.layout.needs_sensors:
        return []
    if any(column.field != "act" for column in robot.layout.missing_state(robot.model)):
        return []
    where = {(column.field, column.place): i for i, column in enumerate(robot.layout.columns)}
    compared = []
    for sensor in named_sensors(robot.model).values():
        columns = [where.get(("sensordata", sensor.place + i), -1) for i in range(3)]
        if sensor.kind in COMPARED and min(columns) >= 0:
            compared.append((sensor, columns))
    shown = []
    measured = []
    count = 0
    for start, stop in data.trajectories.spans:
        if not compared or count >= data.settings.sensor_rows:
            break
        if stop - start <= data.settings.short:
            continue
        rows = data.trajectories.observations[start:stop][: data.settings.sensor_rows]
        states = robot.layout.full_states(rows, robot.model)[:, 1:]
        positions, velocities, _ = np.split(
            states, [robot.model.nq, robot.model.nq + robot.model.nv], axis=1
        )
        accelerations = np.gradient(velocities, step, axis=0)
        shown.append(sensors_along(robot.model, positions, velocities, accelerations))
        measured.append(rows)
        count += len(rows)
    pairs = []
    for sensor, columns in compared if shown else []:
        own = np.concatenate(shown)[:, sensor.place : sensor.place + 3]
        logged = np.concatenate(measured)[:, columns]
        name = f"sensordata.{sensor.name}"
        pairs.append(SensorPair(name, sensor.mount, sensor.units[0], logged, own))
    return pairs


# Rows and trajectories


def _check_copies(data: _CheckedData) -> Iterator[Finding]:
    """Transitions that are exact copies of others."""
    trajectories = data.trajectories
    rows = np.hstack(
        [trajectories.observations, trajectories.actions, trajectories.next_observations]
    )
    _, first = np.unique(rows, axis=0, return_index=True)
    copies = np.setdiff1d(np.arange(len(rows)), first)
    if len(copies):
        row = int(copies[0])
        text = (
            f"{len(copies)} of {len(rows)} transitions are exact copies of others, the first "
            f"is row {row}."
        )
        advice = "A machine at rest, or a log read twice: copies count as evidence and are none."
        yield Finding("warning", "", text, advice, row=row)


def _check_lengths(data: _CheckedData) -> Iterator[Finding]:
    """Trajectories that are too short to say much."""
    spans = data.trajectories.spans
    shortest = data.settings.short
    short = [i for i, (start, stop) in enumerate(spans) if stop - start < shortest]
    if short:
        named = ", ".join(map(str, short[:MOST_NUMBERS]))
        more = ", ..." if len(short) > MOST_NUMBERS else ""
        text = (
            f"{len(short)} of {len(spans)} trajectories have fewer than {shortest} "
            f"transitions: {named}{more}."
        )
        yield Finding("warning", "", text, row=spans[short[0]][0])


def _check_continuity(data: _CheckedData) -> Iterator[Finding]:
    """Next observations that are not the following row's: noise drawn twice, or rows left out."""
    trajectories = data.trajectories
    rows: Ints = np.flatnonzero(~trajectories.terminals)
    if not len(rows):
        return
    differences = trajectories.next_observations[rows] - trajectories.observations[rows + 1]
    signals = columns(data.simulator, differences.shape[1])
    for signal, column in zip(signals, differences.T, strict=True):
        rms = float(np.sqrt(np.mean(column**2)))
        if rms > 0:
            unit = f" {signal.unit}" if signal.unit else ""
            row = int(rows[np.argmax(np.abs(column))])
            text = (
                f"next_observations differ from the following observations by {rms:.4g}{unit} "
                f"(rms), most at row {row}: noise, or a gap."
            )
            yield Finding("information", signal.name, text, row=row)
