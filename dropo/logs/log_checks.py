"""The checks of a raw log: its stamps, its columns, and whether motion, velocity and gravity fit
each other.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from dropo.core.records.trajectories import Ints
from dropo.data.checks.columns import Column, check_column, check_turns, unwrapped
from dropo.data.checks.findings import Finding, errors_first
from dropo.data.checks.kinematics import (
    Motion,
    check_fall,
    check_motions,
    falling,
    noise_of_steps,
    turned,
)
from dropo.logs.recordings import Run, Series
from dropo.logs.signals.stamps import check_stamps, gaps, going_on
from dropo.mjmodel.joints import Joint, ModelJoints


def check_runs(runs: Sequence[Run], machine: ModelJoints) -> list[Finding]:
    """What looks odd in raw logs, errors first; every finding names its run where there are
    several.
    """
    found: list[Finding] = []
    motions: dict[str, list[Motion]] = {}
    for run in runs:
        name = run.name if len(runs) > 1 else None
        for stamps in run.stamps:
            found += check_stamps(stamps.name, stamps.time, stamps.rows, name)
        clean = [series.take(going_on(series.time)) for series in run.series]
        for i, series in enumerate(clean):
            if (
                series.channel.field == "qpos"
                and machine.joints[series.channel.name].kind == "hinge"
            ):
                found += check_turns(next(_columns(series, machine, name)))
                clean[i] = replace(series, values=unwrapped(series.values[:, 0])[:, None])
            for column in _columns(clean[i], machine, name):
                found += check_column(column)
        for joint in machine.joints.values():
            found += _joint(joint, clean, machine, name)
            for motion in _motions(joint, clean, name):
                motions.setdefault(motion.velocity, []).append(motion)
    for same in motions.values():
        found += check_motions(same)
    return errors_first(found)


def _columns(series: Series, machine: ModelJoints, run: str | None) -> Iterator[Column]:
    channel = series.channel
    names = (
        [series.label]
        if len(channel.columns) == 1
        else [f"{series.label}[{i}]" for i in range(len(channel.columns))]
    )
    limits = None
    if channel.field == "ctrl":
        limits = machine.actuators[channel.name].range
    elif channel.field == "qpos" and len(names) == 1:
        limits = machine.joints[channel.name].range
    quaternion = machine.joints[channel.name].quaternion() if channel.field == "qpos" else None
    for i, name in enumerate(names):
        if quaternion is not None and i >= quaternion.start and np.ptp(series.values[:, i]) == 0:
            continue  # a rotation about one axis leaves some of the four at rest
        yield Column(
            name,
            channel.units[i],
            series.time,
            series.values[:, i],
            series.rows,
            channel.field != "ctrl",
            limits,
            gaps(series.time),
            run,
        )


def _joint(
    joint: Joint, series: list[Series], machine: ModelJoints, run: str | None
) -> Iterator[Finding]:
    positions = _of("qpos", joint, series)
    if positions is None:
        return
    quaternion = joint.quaternion()
    if quaternion is not None:
        norms = np.linalg.norm(positions.values[:, quaternion], axis=1)
        worst = int(np.argmax(np.abs(norms - 1)))
        if abs(norms[worst] - 1) > 0.05:
            where = f"row {positions.rows[worst]} at {positions.time[worst]:.6g} s"
            text = f"a quaternion must have length 1, and one has {norms[worst]:.6g}, {where}."
            advice = "Map the four columns in the order w, x, y, z."
            yield Finding(
                "error",
                positions.label,
                text,
                advice,
                run,
                int(positions.rows[worst]),
                float(positions.time[worst]),
            )
            return
    if joint.kind == "free":
        for piece in _pieces(positions):
            accelerations, first = falling(positions.time[piece], positions.values[piece, :3])
            yield from check_fall(
                positions.label,
                accelerations,
                machine.gravity,
                positions.rows[piece][first],
                positions.time[piece][first],
                run,
            )


def _of(field: str, joint: Joint, series: list[Series]) -> Series | None:
    return next(
        (s for s in series if s.channel.field == field and s.channel.name == joint.name), None
    )


def _pieces(series: Series) -> list[Ints]:
    """The rows between gaps."""
    return [
        piece
        for piece in np.split(np.arange(len(series.time)), gaps(series.time))
        if len(piece) > 1
    ]


def _motions(joint: Joint, series: list[Series], run: str | None) -> Iterator[Motion]:
    """Every number of a joint that has a velocity; a quaternion turns by three."""
    positions = _of("qpos", joint, series)
    velocities = _of("qvel", joint, series)
    if positions is None or velocities is None:
        return
    time = positions.time
    values = positions.values
    inside = (time >= velocities.time[0]) & (time <= velocities.time[-1])
    if inside.sum() < 3:
        return
    time = time[inside]
    values = values[inside]
    rows = positions.rows[inside]
    speeds = np.stack(
        [np.interp(time, velocities.time, column) for column in velocities.values.T], axis=1
    )
    steps = np.diff(time)
    integral = (speeds[1:] + speeds[:-1]) / 2 * steps[:, None]
    quaternion = joint.quaternion()
    linear = values if quaternion is None else values[:, : quaternion.start]
    moved = np.diff(linear, axis=0)
    if quaternion is not None:
        moved = np.hstack([moved, turned(values[:-1, quaternion], values[1:, quaternion])])
    cut = np.zeros(len(time), dtype=np.int64)
    cut[gaps(time)] = 1
    pieces = np.cumsum(cut)[:-1]
    for i in range(moved.shape[1]):
        suffix = f"[{i}]" if moved.shape[1] > 1 else ""
        yield Motion(
            f"{positions.label}{suffix}",
            f"{velocities.label}{suffix}",
            moved[:, i],
            integral[:, i],
            noise_of_steps(moved[:, i]),
            float(np.median(steps)),
            rows[:-1],
            time[:-1],
            pieces,
            run,
        )
