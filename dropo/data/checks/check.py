"""What looks odd in data: time, dead, stuck or clipped channels, copies, units and signs, actions
that no actuator can follow.
"""

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from dropo.core.contracts.problem import Problem
from dropo.core.contracts.simulator import Simulator
from dropo.core.records.trajectories import Ints, Signal, Trajectories
from dropo.core.services.validation import Array
from dropo.data.checks.columns import Column, beyond, check_column
from dropo.data.checks.findings import Finding, Level, errors_first
from dropo.data.checks.kinematics import (
    Motion,
    check_fall,
    check_motions,
    falling,
    noise_of_steps,
    turned,
)
from dropo.data.describe import columns, controls, simulator_of
from dropo.mjmodel.joints import Joint, actuators, all_joints, model_joints
from dropo.mjmodel.robot_simulator import RobotSimulator

SHORT = 5
"""A trajectory of fewer transitions says little."""
UNIT = 1e-3
NOT_UNIT = 0.05
"""How far a quaternion's norm may be from 1: within rounding of a log file; beyond, it is none."""
RATE = 0.02
UNEVEN = 0.05
GAP = 1.5
"""How far rows may be from the control step: all (a share of it), each (rms), and one (as a
factor).
"""
REIMPORT = "`dropo data import` resamples logs on the control step and ends trajectories at gaps."


def check(trajectories: Trajectories, source: Problem | Simulator | None = None) -> list[Finding]:
    """What looks odd in the data, errors first. source: the problem or simulator that they are for;
    None: less can be checked.
    """
    simulator = simulator_of(source)
    found = [
        *blocking(trajectories, simulator),
        *_uneven(trajectories),
        *(
            finding
            for column in _columns(trajectories, simulator)
            for finding in check_column(column)
        ),
        *_duplicates(trajectories),
        *_short(trajectories),
        *(shorter_than_lambda(source) if isinstance(source, Problem) else ()),
        *_gaps(trajectories, columns(simulator, trajectories.observations.shape[1])),
    ]
    return errors_first(found)


def blocking(trajectories: Trajectories, simulator: Simulator | None) -> Iterator[Finding]:
    """The findings among which are all errors: a fit of data with one cannot work."""
    yield from quaternion_norms(trajectories, simulator)
    yield from times(trajectories)
    yield from rates(trajectories, simulator)
    yield from motions(trajectories, simulator)
    yield from falls(trajectories, simulator)


def verdict(trajectories: Trajectories, simulator: Simulator | None) -> Finding | None:
    """The first error, which keeps a fit from working; None where nothing does."""
    return next(
        (finding for finding in blocking(trajectories, simulator) if finding.level == "error"), None
    )


# Time


def _inside(trajectories: Trajectories) -> NDArray[np.bool_]:
    """(N - 1,) steps that stay in a trajectory."""
    return ~trajectories.terminals[:-1]


def times(trajectories: Trajectories) -> Iterator[Finding]:
    """Rows that are not later than the row before them in their trajectory."""
    if trajectories.time is None:
        return
    back = np.flatnonzero(_inside(trajectories) & (np.diff(trajectories.time) <= 0))
    if len(back):
        row = int(back[0]) + 1
        sentence = (
            f"{len(back)} rows are not later than the row before them, the first is row {row}."
        )
        advice = "Take them out, or set `terminals` where the clock starts anew."
        yield Finding(
            "error", "time", sentence, advice, row=row, time=float(trajectories.time[row])
        )


def _control_step(simulator: Simulator | None) -> float | None:
    return None if simulator is None else simulator.control_step


def rates(trajectories: Trajectories, simulator: Simulator | None) -> Iterator[Finding]:
    """Rows that are not a control step apart."""
    step = _control_step(simulator)
    if trajectories.time is None or step is None or not _inside(trajectories).any():
        return
    typical = float(np.median(np.diff(trajectories.time)[_inside(trajectories)]))
    if typical > 0 and abs(typical / step - 1) > RATE:
        frame_skip = simulator.frame_skip if isinstance(simulator, RobotSimulator) else 1
        count = max(1, round(typical / step * frame_skip))
        sentence = (
            f"rows are {1e3 * typical:.6g} ms apart, and one control step of the model takes "
            f"{1e3 * step:.6g} ms."
        )
        advice = f"Set frame_skip to {count}, or resample the data; see also the unit of time."
        yield Finding("error", "time", sentence, advice, row=1, time=float(trajectories.time[1]))


def _uneven(trajectories: Trajectories) -> Iterator[Finding]:
    """Gaps and jitter inside trajectories."""
    if trajectories.time is None:
        return
    time = trajectories.time
    steps = np.diff(trajectories.time)
    inside = _inside(trajectories) & (steps > 0)
    if inside.sum() < 3:
        return
    typical = float(np.median(steps[inside]))
    gaps = np.flatnonzero(inside & (steps > GAP * typical))
    if len(gaps):
        row = int(gaps[0]) + 1
        longest = 1e3 * float(steps[gaps].max())
        sentence = (
            f"{len(gaps)} steps inside trajectories are longer than {GAP:g} of "
            f"{1e3 * typical:.4g} ms, up to {longest:.4g} ms, the "
            f"first before row {row}."
        )
        yield Finding("warning", "time", sentence, REIMPORT, row=row, time=float(time[row]))
    even = inside & (steps <= GAP * typical)
    jitter = float(np.sqrt(np.mean((steps[even] / typical - 1) ** 2))) if even.any() else 0.0
    if jitter > UNEVEN:
        row = int(np.argmax(np.where(even, np.abs(steps - typical), 0.0))) + 1
        sentence = (
            f"steps vary by {100 * jitter:.0f} % (rms) around {1e3 * typical:.4g} ms, most "
            f"before row {row}."
        )
        yield Finding("warning", "time", sentence, REIMPORT, row=row, time=float(time[row]))


# Single columns


def _clock(trajectories: Trajectories, simulator: Simulator | None) -> Array:
    """(N,) seconds of each row: the data's, else by the control step from each trajectory's start."""
    if trajectories.time is not None:
        return trajectories.time
    first = np.array([start for start, _ in trajectories.spans])[trajectories.trajectory]
    return (np.arange(len(trajectories)) - first) * float(_control_step(simulator) or 1.0)


def _columns(trajectories: Trajectories, simulator: Simulator | None) -> Iterator[Column]:
    """Every observation and action column."""
    n = len(trajectories)
    time = _clock(trajectories, simulator)
    breaks = np.array([start for start, _ in trajectories.spans[1:]], dtype=np.int64)
    limits = {
        positions[0]: joint.range
        for joint, positions, _ in _joints(trajectories, simulator)
        if len(positions) == 1
    }
    named = columns(simulator, trajectories.observations.shape[1])
    for i, (signal, values) in enumerate(zip(named, trajectories.observations.T, strict=True)):
        yield Column(
            signal.name, signal.unit, time, values, np.arange(n), True, limits.get(i), breaks
        )
    yield from _commands(trajectories, simulator)


def _commands(trajectories: Trajectories, simulator: Simulator | None) -> Iterator[Column]:
    n, q = trajectories.actions.shape
    ranges: list[tuple[float, float] | None] = [None] * q
    if isinstance(simulator, RobotSimulator) and len(simulator.controls) == q:
        every = actuators(simulator.model)
        ranges = [every[place].range for place in simulator.controls.tolist()]
    for i, (signal, values) in enumerate(
        zip(controls(simulator, q), trajectories.actions.T, strict=True)
    ):
        yield Column(
            signal.name,
            signal.unit,
            _clock(trajectories, simulator),
            values,
            np.arange(n),
            False,
            ranges[i],
        )


def outside_control_range(
    trajectories: Trajectories, simulator: Simulator | None
) -> Iterator[Finding]:
    """Actions that the model's actuators clip, so that the simulation does not apply what the data
    say.
    """
    for column in _commands(trajectories, simulator):
        if (
            column.limits is not None
            and ((column.values < column.limits[0]) | (column.values > column.limits[1])).any()
        ):
            yield from beyond(column)


def _robot(trajectories: Trajectories, simulator: Simulator | None) -> RobotSimulator | None:
    """The simulator, where it has a model and its columns are as many as the data's."""
    if not isinstance(simulator, RobotSimulator):
        return None
    return simulator if len(simulator.layout) == trajectories.observations.shape[1] else None


def quaternion_norms(trajectories: Trajectories, simulator: Simulator | None) -> Iterator[Finding]:
    """Quaternion columns that are not of unit length."""
    robot = _robot(trajectories, simulator)
    if robot is None:
        return
    for quaternion in robot.layout.quaternions:
        norms = np.linalg.norm(
            np.vstack(
                [
                    trajectories.observations[:, quaternion],
                    trajectories.next_observations[:, quaternion],
                ]
            ),
            axis=1,
        )
        place = int(np.argmax(np.abs(norms - 1)))
        worst = float(norms[place])
        row = place % len(trajectories)
        if abs(worst - 1) > UNIT:
            level: Level = "error" if abs(worst - 1) > NOT_UNIT else "warning"
            name = robot.layout.names[quaternion[0]].rsplit("[", 1)[0]
            sentence = f"a quaternion must have length 1, and one has {worst:.6g}, row {row}."
            yield Finding(level, name, sentence, "The order is w, x, y, z.", row=row)


# Motion


def _joints(
    trajectories: Trajectories, simulator: Simulator | None
) -> Iterator[tuple[Joint, list[int], list[int]]]:
    """Each joint that is observed, with the data's columns of its position and, where they are
    there, of its velocity.
    """
    robot = _robot(trajectories, simulator)
    if robot is None:
        return
    where = {(column.field, column.place): i for i, column in enumerate(robot.layout.columns)}
    for joint in all_joints(robot.model):
        positions = [
            where.get(("qpos", joint.qpos + i), -1) for i in range(len(joint.units("qpos")))
        ]
        velocities = [
            where.get(("qvel", joint.qvel + i), -1) for i in range(len(joint.units("qvel")))
        ]
        if min(positions) >= 0:
            yield joint, positions, velocities if min(velocities) >= 0 else []


def motions(trajectories: Trajectories, simulator: Simulator | None) -> Iterator[Finding]:
    """Velocities that are not those of the positions."""
    step = _control_step(simulator)
    if step is None:
        return
    names = [signal.name for signal in columns(simulator, trajectories.observations.shape[1])]
    time = _clock(trajectories, simulator)
    rows = np.arange(len(trajectories))
    now = trajectories.observations
    following = trajectories.next_observations
    for joint, positions, velocities in _joints(trajectories, simulator):
        if not velocities:
            continue
        moved = _displacements(joint, now[:, positions], following[:, positions])
        what = f"qpos.{joint.name}"
        for i, place in enumerate(velocities):
            integral = step * (now[:, place] + following[:, place]) / 2
            noise = noise_of_steps(moved[:, i])
            yield from check_motions(
                [
                    Motion(
                        what,
                        names[place],
                        moved[:, i],
                        integral,
                        noise,
                        step,
                        rows,
                        time,
                        trajectories.trajectory,
                    )
                ]
            )


def _displacements(joint: Joint, now: Array, following: Array) -> Array:
    """(n, nv) from positions to those that follow; a quaternion turns by three angles in the body's
    frame.
    """
    quaternion = joint.quaternion()
    if quaternion is None:
        return following - now
    linear = slice(0, quaternion.start)
    return np.hstack(
        [
            following[:, linear] - now[:, linear],
            turned(now[:, quaternion], following[:, quaternion]),
        ]
    )


def falls(trajectories: Trajectories, simulator: Simulator | None) -> Iterator[Finding]:
    """Free bodies that fall in another way than under the model's gravity."""
    step = _control_step(simulator)
    robot = _robot(trajectories, simulator)
    if step is None or robot is None:
        return
    gravity = model_joints(robot.model).gravity
    clock = _clock(trajectories, simulator)
    for joint, positions, _ in _joints(trajectories, simulator):
        if joint.kind != "free":
            continue
        spans = [(start, stop) for start, stop in trajectories.spans if stop - start > SHORT]
        parts = [
            falling(
                step * np.arange(stop - start, dtype=np.float64),
                trajectories.observations[start:stop, positions[:3]],
            )
            for start, stop in spans
        ]
        if parts:
            rows = np.concatenate(
                [first + start for (_, first), (start, _) in zip(parts, spans, strict=True)]
            )
            accelerations = np.concatenate([found for found, _ in parts])
            yield from check_fall(f"qpos.{joint.name}", accelerations, gravity, rows, clock[rows])


# Rows and trajectories


def _duplicates(trajectories: Trajectories) -> Iterator[Finding]:
    everything = np.hstack(
        [trajectories.observations, trajectories.actions, trajectories.next_observations]
    )
    _, first = np.unique(everything, axis=0, return_index=True)
    copies = len(everything) - len(first)
    if copies:
        row = int(np.setdiff1d(np.arange(len(everything)), first)[0])
        sentence = (
            f"{copies} of {len(everything)} transitions are exact copies of others, the first "
            f"is row {row}."
        )
        yield Finding(
            "warning",
            "",
            sentence,
            "A machine at rest, or a log read twice: copies count as evidence and are none.",
            row=row,
        )


def _short(trajectories: Trajectories) -> Iterator[Finding]:
    lengths = [stop - start for start, stop in trajectories.spans]
    short = [i for i, length in enumerate(lengths) if length < SHORT]
    if short:
        named = ", ".join(map(str, short[:8])) + (", ..." if len(short) > 8 else "")
        row = trajectories.spans[short[0]][0]
        yield Finding(
            "warning",
            "",
            (
                f"{len(short)} of {len(lengths)} trajectories have fewer than {SHORT} "
                f"transitions: {named}."
            ),
            row=row,
        )


def shorter_than_lambda(problem: Problem) -> Iterator[Finding]:
    """Trajectories that hold no segment, so that a fit does not see them."""
    lengths = [stop - start for start, stop in problem.trajectories.spans]
    short = sum(length < problem.length for length in lengths)
    if short and problem.reset == "transition":
        yield Finding(
            "warning",
            "",
            (
                f"{short} of {len(lengths)} trajectories are shorter than lambda = "
                f"{problem.length} and are left out."
            ),
        )


def _gaps(trajectories: Trajectories, signals: Sequence[Signal]) -> Iterator[Finding]:
    """Where the next observation is not the following row's observation: noise drawn twice, or rows
    left out.
    """
    rows: Ints = np.flatnonzero(~trajectories.terminals)
    if not len(rows):
        return
    differences: NDArray[np.float64] = (
        trajectories.next_observations[rows] - trajectories.observations[rows + 1]
    )
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
