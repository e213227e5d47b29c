"""What the sensors of logs showed, beside what the model's own show along the positions."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from dropo.core.services.validation import Array
from dropo.data.checks.findings import Finding
from dropo.data.checks.kinematics import rotation_vectors
from dropo.data.checks.sensors import SensorPair, check_gravity, check_sensors
from dropo.logs.preparing import clean_run
from dropo.logs.recordings import LogRun, TimeSeries
from dropo.logs.signals.clocks import align_runs
from dropo.logs.signals.joint_motion import sensors_shown
from dropo.logs.signals.resampling import resample, resample_rotations
from dropo.mjmodel.joints import ModelJoints
from dropo.mjmodel.observation import logarithm, multiply
from dropo.mjmodel.sensors import Sensor

KINDS = ("gyro", "accelerometer", "velocimeter", "framequat")
"""Kinds of sensors that are compared."""


@dataclass(frozen=True)
class PairSettings:
    """How much of the logs is compared.

    Attributes
    ----------
    runs : int
        Largest number of runs that are compared.
    rows : int
        Largest number of instants of each run.
    minimum_rows : int
        A run with fewer is left out.
    turn : float
        Length of the windows over which an orientation turns [s].
    """

    runs: int = 4
    rows: int = 1000
    minimum_rows: int = 20
    turn: float = 0.1


DEFAULTS = PairSettings()


def sensor_findings(runs: Sequence[LogRun], robot: ModelJoints) -> list[Finding]:
    """Find sensors that do not show what the model's own show along the positions.

    Parameters
    ----------
    runs : sequence of LogRun
        As they were read.
    robot : ModelJoints
        The robot.

    Returns
    -------
    list of Finding
    """
    pairs = sensor_pairs(runs, robot)
    found = list(check_sensors(pairs))
    compared = {pair.name for pair in pairs}
    gravity = float(np.linalg.norm(robot.gravity))
    for series in runs[0].series if runs else ():
        if series.channel.field != "sensordata" or series.label in compared:
            continue
        if robot.sensors[series.channel.name].kind == "accelerometer":
            lengths = np.linalg.norm(series.values, axis=1)
            found += check_gravity(series.label, lengths, series.channel.factors[0], gravity)
    return found


def sensor_pairs(
    runs: Sequence[LogRun], robot: ModelJoints, settings: PairSettings = DEFAULTS
) -> list[SensorPair]:
    """Pair what sensors showed with what the model's own show, of some runs together.

    Parameters
    ----------
    runs : sequence of LogRun
        As they were read.
    robot : ModelJoints
        The robot.
    settings : PairSettings, optional
        How much is compared.

    Returns
    -------
    list of SensorPair
        Of the gyros, accelerometers, velocimeters and orientations whose motion is known.
    """
    if not any(series.channel.field == "sensordata" for run in runs for series in run.series):
        return []
    some = np.linspace(0, len(runs) - 1, min(settings.runs, len(runs))).astype(int)
    clean = [clean_run(runs[i], robot) for i in some]
    if any(_has_own_clock(run) for run in clean):
        clean, _ = align_runs(clean, robot)
    parts: dict[str, list[SensorPair]] = {}
    for run in clean:
        for pair in _pairs_of_run(run, robot, settings):
            parts.setdefault(pair.name, []).append(pair)
    return [_together(of_runs) for of_runs in parts.values()]


def _has_own_clock(run: LogRun) -> bool:
    """Whether a sensor has stamps of its own clock."""
    channels = [series.channel for series in run.series]
    return any(one.field == "sensordata" and one.source.own_clock for one in channels)


def _pairs_of_run(run: LogRun, robot: ModelJoints, settings: PairSettings) -> list[SensorPair]:
    """The pairs of one run."""
    logged = [one for one in run.series if one.channel.field == "sensordata"]
    sensors = [robot.sensors[one.channel.name] for one in logged]
    wanted = [sensor for sensor in sensors if sensor.kind in KINDS]
    shown = sensors_shown(run, robot, wanted, settings.rows, settings.minimum_rows)
    if shown is None:
        return []
    found = []
    for series, sensor in zip(logged, sensors, strict=True):
        modelled = shown.by_name.get(sensor.name)
        inside = (shown.time >= series.time[0]) & (shown.time <= series.time[-1])
        if modelled is None or inside.sum() < settings.minimum_rows:
            continue
        found.append(_pair(series, sensor, shown.time[inside], modelled[inside], settings))
    return found


def _pair(
    series: TimeSeries, sensor: Sensor, time: Array, modelled: Array, settings: PairSettings
) -> SensorPair:
    """One sensor beside the model's own at some instants."""
    channel = series.channel
    negative = all(sign < 0 for sign in channel.signs)
    facts = (channel.factors[0], channel.rotation, negative)
    if not sensor.is_rotation:
        measured = resample(series.time, series.values, time)
        return SensorPair(series.label, sensor.mount, sensor.units[0], measured, modelled, *facts)
    steps = max(1, round(settings.turn / float(np.median(np.diff(time)))))

    def turns(quaternions: Array) -> Array:
        """By how much orientations turn in so many rows."""
        return rotation_vectors(quaternions[:-steps], quaternions[steps:])

    lengths = np.linalg.norm(series.values, axis=1)
    real = series.take(lengths > 0)
    whole = resample_rotations(real.time, real.values, time)
    other = resample_rotations(real.time, real.values[:, [3, 0, 1, 2]], time)
    back = modelled * np.array([1.0, -1.0, -1.0, -1.0])
    return SensorPair(
        series.label,
        sensor.mount,
        "",
        turns(whole),
        turns(modelled),
        *facts,
        reordered=turns(other),
        away=logarithm(multiply(whole, back)),
        reordered_away=logarithm(multiply(other, back)),
    )


def _together(pairs: Sequence[SensorPair]) -> SensorPair:
    """The pairs of one sensor in several runs as one."""

    def joined(name: str) -> Array | None:
        """What all have under a name."""
        parts = [getattr(one, name) for one in pairs]
        return None if parts[0] is None else np.concatenate(parts)

    names = ("measured", "modelled", "reordered", "away", "reordered_away")
    arrays: dict[str, Any] = {name: joined(name) for name in names}
    return replace(pairs[0], **arrays)
