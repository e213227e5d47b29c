"""The pose of a free base that was not logged, estimated before logs become data."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dropo.core.records.trajectories import Ints
from dropo.core.services.validation import Array
from dropo.data.checks.findings import Finding
from dropo.logs.mapping import Channel
from dropo.logs.preparing import SignalNoise
from dropo.logs.recordings import LogRun, TimeSeries
from dropo.logs.signals.base_motion import (
    DEFAULTS,
    BaseMotion,
    BaseMotionSettings,
    estimate_base,
    imu_of,
)
from dropo.logs.signals.resampling import resample
from dropo.logs.signals.stamps import find_gaps
from dropo.mjmodel.joints import Joint, ModelJoints, reference_pose
from dropo.mjmodel.sensors import G, Sensor
from dropo.mjmodel.standing import floating_base, level_ground, site_of

MINIMUM_ROWS = 60
"""Rows of a stretch without gaps in which the motion of a base is estimated, at least."""
NOTE = (
    "The pose of {base} is not logged: it is estimated from {gyro}, {acc} and the joints' angles,"
    " feet standing at {standing:.0%} of the instants; velocity within {speed:.2g} m/s,"
    " inclination within {turn:.2g} rad."
)
NOT_STANDING = (
    "the pose of {base} is not logged, and cannot be estimated: by {gyro}, {acc} and the joints'"
    " angles, feet stand still on the ground at {standing:.0%} of the instants only."
)
ADVICE = (
    "See whether the IMU is mounted as its site says, in signs and units too, and whether the"
    " machine stands on the model's ground."
)
BIASED = (
    "{name} has a bias of {size:.2g} {unit} along {axis} of {base}, {times:.1f} times a usual one"
)
ASKEW = "; the feet on the ground say that it is mounted askew by {angle:.2g} rad"


@dataclass(frozen=True, eq=False)
class WithBase:
    """Runs with the estimated motion of their base, where it could be estimated.

    Attributes
    ----------
    runs : list of LogRun
        The runs.
    noise : dict
        `SignalNoise` of the base's signals; empty where it was not estimated.
    findings : list of Finding
        What is odd.
    notes : tuple of str
        What was estimated.
    """

    runs: list[LogRun]
    noise: dict[str, SignalNoise]
    findings: list[Finding]
    notes: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class _Sources:
    """The base, and the sensors that its motion is estimated from."""

    base: Joint
    gyro: Sensor
    accelerometer: Sensor


def lacks_base(robot: ModelJoints, positions: Sequence[str]) -> bool:
    """Tell whether a robot has a free base whose pose is not among the measured positions.

    Parameters
    ----------
    robot : ModelJoints
        The robot.
    positions : sequence of str
        The joints whose position was measured.

    Returns
    -------
    bool
    """
    base = floating_base(robot.model)
    return base is not None and base.name not in positions


def missing_for_base(
    robot: ModelJoints, positions: Sequence[str], sensors: Sequence[str]
) -> tuple[str, ...]:
    """Name what the pose of a base cannot be estimated without.

    Parameters
    ----------
    robot : ModelJoints
        With a floating base.
    positions, sensors : sequence of str
        The joints and the sensors that were measured.

    Returns
    -------
    tuple of str
        Empty where nothing is missing.
    """
    base = floating_base(robot.model)
    missing = []
    if level_ground(robot.model) is None:
        missing.append("a level plane as the model's only ground")
    for kind in ("gyro", "accelerometer"):
        if _on_base(robot, kind, sensors) is None:
            missing.append(f"the model's {kind} on a site of the base, in the log")
    others = [name for name in robot.joints if base is None or name != base.name]
    without = [name for name in others if name not in positions]
    if without:
        missing.append(f"the angle of {', '.join(without[:3])}")
    return tuple(missing)


def _on_base(robot: ModelJoints, kind: str, sensors: Sequence[str]) -> Sensor | None:
    """The first measured sensor of a kind on a site of the base."""
    for name in sensors:
        sensor = robot.sensors[name]
        if sensor.kind == kind and site_of(robot.model, sensor.id) is not None:
            return sensor
    return None


def add_base(
    runs: Sequence[LogRun],
    robot: ModelJoints,
    noise: dict[str, SignalNoise],
    settings: BaseMotionSettings = DEFAULTS,
) -> WithBase:
    """Estimate the motion of a base that was not logged, where an IMU and joints' angles were.

    Parameters
    ----------
    runs : sequence of LogRun
        With velocities of all joints that were logged.
    robot : ModelJoints
        The robot.
    noise : dict
        `SignalNoise` of every column.
    settings : BaseMotionSettings, optional
        How.

    Returns
    -------
    WithBase
        The same runs where nothing is missing, or too much.
    """
    as_they_are = WithBase(list(runs), {}, [], ())
    positions = [one.channel.name for one in runs[0].series if one.channel.field == "qpos"]
    sensors = [one.channel.name for one in runs[0].series if one.channel.field == "sensordata"]
    base = floating_base(robot.model)
    if base is None or not lacks_base(robot, positions):
        return as_they_are
    if missing_for_base(robot, positions, sensors):
        return as_they_are
    gyro = _on_base(robot, "gyro", sensors)
    accelerometer = _on_base(robot, "accelerometer", sensors)
    assert gyro is not None
    assert accelerometer is not None
    sources = _Sources(base, gyro, accelerometer)
    out = []
    motions: list[BaseMotion] = []
    for run in runs:
        series, own = _estimated(run, robot, sources, noise, settings)
        out.append(replace(run, series=(*run.series, *series)))
        motions += own
    if not motions:
        return as_they_are
    standing = float(np.mean([motion.standing for motion in motions]))
    names = {"base": base.name, "gyro": gyro.name, "acc": accelerometer.name}
    if standing < settings.least_standing:
        text = NOT_STANDING.format(standing=standing, **names)
        return replace(as_they_are, findings=[Finding("warning", base.name, text, ADVICE)])
    levels = _levels(sources, motions)
    speed = max(levels[f"qvel.{base.name}[{i}]"].sd or 0.0 for i in range(3))
    turn = levels[f"qpos.{base.name}.rx"].sd or 0.0
    note = NOTE.format(standing=standing, speed=speed, turn=turn, **names)
    return WithBase(out, levels, _biases(sources, motions, settings), (note,))


def _estimated(
    run: LogRun,
    robot: ModelJoints,
    sources: _Sources,
    noise: dict[str, SignalNoise],
    settings: BaseMotionSettings,
) -> tuple[tuple[TimeSeries, ...], list[BaseMotion]]:
    """Position and velocity of the base in a run, and the motions of its stretches."""
    gyro = run.of("sensordata", sources.gyro.name)
    accelerometer = run.of("sensordata", sources.accelerometer.name)
    assert gyro is not None
    assert accelerometer is not None
    joints = [one for one in run.series if one.channel.field in ("qpos", "qvel")]
    stretches = _stretches(gyro, [*joints, accelerometer])
    speeds = [one.sd or 0.0 for name, one in noise.items() if name.startswith("qvel.")]
    joint_noise = float(np.sqrt(np.mean(np.square(speeds)))) if speeds else 0.0
    motions = []
    for rows in stretches:
        time = gyro.time[rows]
        shown = resample(accelerometer.time, accelerometer.values, time)
        imu = imu_of(robot, sources.gyro, sources.accelerometer, gyro.values[rows], shown)
        assert imu is not None
        positions, velocities = _joints_at(time, joints, robot, noise)
        motions.append(
            estimate_base(robot, time, positions, velocities, joint_noise, imu, settings)
        )
    if not motions:
        return (), []
    rows = np.concatenate(stretches)
    own = []
    for field in ("qpos", "qvel"):
        parts = [one.positions if field == "qpos" else one.velocities for one in motions]
        channel = _channel(gyro.channel, sources.base, field)
        own.append(TimeSeries(channel, gyro.time[rows], np.concatenate(parts), gyro.rows[rows]))
    return (own[0], own[1].shift(robot.velocity_lag)), motions


def _channel(gyro: Channel, base: Joint, field: str) -> Channel:
    """The channel of the base's estimated positions or velocities."""
    units = base.units(field)
    return replace(
        gyro, field=field, name=base.name, columns=units, units=units, key="", rotation=None
    )


def _stretches(gyro: TimeSeries, others: Sequence[TimeSeries]) -> list[Ints]:
    """The rows of the gyro between gaps in any of the series."""
    first = max(float(one.time[0]) for one in (gyro, *others))
    last = min(float(one.time[-1]) for one in (gyro, *others))
    cuts = [gyro.time[find_gaps(gyro.time)]]
    cuts += [one.time[find_gaps(one.time)] for one in others]
    rows = np.flatnonzero((gyro.time >= first) & (gyro.time <= last))
    places = np.searchsorted(gyro.time[rows], np.unique(np.concatenate(cuts)))
    return [part for part in np.split(rows, places) if len(part) >= MINIMUM_ROWS]


def _joints_at(
    time: Array, series: Sequence[TimeSeries], robot: ModelJoints, noise: dict[str, SignalNoise]
) -> tuple[Array, Array]:
    """Positions (n, nq) and velocities (n, nv) of the joints at some instants."""
    positions = np.tile(reference_pose(robot.model), (len(time), 1))
    velocities = np.zeros((len(time), robot.model.nv))
    for one in series:
        joint = robot.joints[one.channel.name]
        level = noise.get(one.label)
        # Estimated velocities are late as the model's own are.
        late = robot.velocity_lag if level is not None and level.estimated else 0.0
        at = np.clip(time + late, one.time[0], one.time[-1])
        values = resample(one.time, one.values, at)
        if one.channel.field == "qpos":
            positions[:, joint.qpos : joint.qpos + values.shape[1]] = values
        else:
            velocities[:, joint.qvel : joint.qvel + values.shape[1]] = values
    return positions, velocities


def _levels(sources: _Sources, motions: Sequence[BaseMotion]) -> dict[str, SignalNoise]:
    """The errors of the base's signals."""
    name = sources.base.name
    position = np.sqrt(np.mean([one.position_sd**2 for one in motions], axis=0))
    velocity = np.sqrt(np.mean([one.velocity_sd**2 for one in motions], axis=0))
    levels = {}
    for i in range(3):
        levels[f"qpos.{name}[{i}]"] = SignalNoise(float(position[i]), "m", estimated=True)
    for i, axis in enumerate("xyz"):
        level = SignalNoise(float(position[3 + i]), "rad", estimated=True)
        levels[f"qpos.{name}.r{axis}"] = level
    for i, unit in enumerate(sources.base.units("qvel")):
        levels[f"qvel.{name}[{i}]"] = SignalNoise(float(velocity[i]), unit, estimated=True)
    return levels


def _biases(
    sources: _Sources, motions: Sequence[BaseMotion], settings: BaseMotionSettings
) -> list[Finding]:
    """Biases that are so large that the IMU is rather turned in its mount."""
    bias = np.median([one.bias for one in motions], axis=0)
    usual = np.repeat([settings.turning_bias, settings.acceleration_bias], 3)
    worst = int(np.argmax(np.abs(bias) / usual))
    times = float(abs(bias[worst]) / usual[worst])
    if times < settings.largest_bias:
        return []
    sensor = sources.gyro if worst < 3 else sources.accelerometer
    text = BIASED.format(
        name=sensor.name,
        size=bias[worst],
        unit=sensor.units[0],
        axis="xyz"[worst % 3],
        base=sources.base.name,
        times=times,
    )
    if worst in (3, 4):  # gravity where the feet say that there is none
        text += ASKEW.format(angle=abs(bias[worst]) / G)
    advice = "See whether it is mounted as its site says; `rotation` in the mapping turns it."
    return [Finding("warning", sensor.name, f"{text}.", advice)]
