"""Series of a raw log made fit for a simulator: cleaned, unwrapped, and with all velocities."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dropo.core.records.trajectories import Ints
from dropo.core.services.validation import Array
from dropo.data.checks.columns import Column, find_hangs, unwrap
from dropo.logs.mapping import Channel
from dropo.logs.recordings import LogRun, TimeSeries
from dropo.logs.signals.joint_motion import continuous, joint_velocities
from dropo.logs.signals.resampling import align_signs
from dropo.logs.signals.stamps import find_gaps, increasing
from dropo.logs.signals.velocities import estimate_velocities
from dropo.mjmodel.joints import Joint, ModelJoints

ZIGZAG = 0.6745 * np.sqrt(6)
"""The median size of second differences of white noise, in its standard deviations."""


@dataclass(frozen=True)
class LoggedNoiseSettings:
    """From how much of a log noise levels and velocities are estimated.

    Attributes
    ----------
    rows : int
        Rows of a run that a noise level is estimated from at most.
    runs : int
        Runs that a noise level is estimated from at most.
    minimum_rows : int
        Rows of a stretch that a velocity is estimated from at least.
    """

    rows: int = 4000
    runs: int = 20
    minimum_rows: int = 20


DEFAULTS = LoggedNoiseSettings()


@dataclass(frozen=True)
class SignalNoise:
    """The noise level of a signal.

    Attributes
    ----------
    sd : float or None
        Standard deviation, in the unit, of the measurement, or of the estimate where there is none;
        None for commands, which are taken as they are, and where there are too few rows.
    unit : str
        Of the signal.
    estimated : bool
        Whether the signal was estimated rather than logged.
    smoothed : float or None
        Of a logged velocity, the noise that one smoothed from its positions would have.
    """

    sd: float | None
    unit: str
    estimated: bool = False
    smoothed: float | None = None


def clean_run(run: LogRun, robot: ModelJoints) -> LogRun:
    """Leave out rows that cannot be used, and let hinge angles go on beyond a turn.

    Parameters
    ----------
    run : LogRun
        As it was read.
    robot : ModelJoints
        The joints and actuators of the model.

    Returns
    -------
    LogRun
        Without rows whose stamps do not go on, or in which a sensor hangs.
    """
    return replace(run, series=tuple(_clean(series, robot) for series in run.series))


def _clean(series: TimeSeries, robot: ModelJoints) -> TimeSeries:
    """The series without rows that cannot be used."""
    series = series.take(increasing(series.time))
    if series.channel.field == "ctrl":
        return series
    if series.channel.field == "sensordata":
        sensor = robot.sensors[series.channel.name]
        if sensor.is_rotation:
            return replace(series, values=align_signs(series.values, series.values[0]))
        if not sensor.follows_motion or sensor.stage == "acceleration":
            return series  # forces and accelerations rest, and jump
    # of a stretch in which a sensor hangs only the first row was measured
    keep = np.ones(len(series.time), dtype=bool)
    gaps = find_gaps(series.time)
    for values in series.values.T:
        column = Column(series.label, "", series.time, values, series.rows, breaks=gaps)
        for start, stop in find_hangs(column):
            keep[start + 1 : stop] = False
    series = series.take(keep)
    if series.channel.field == "qpos" and robot.joints[series.channel.name].kind == "hinge":
        return replace(series, values=unwrap(series.values[:, 0])[:, None])
    return series


def add_velocities(
    runs: Sequence[LogRun], robot: ModelJoints, settings: LoggedNoiseSettings = DEFAULTS
) -> tuple[list[LogRun], dict[str, SignalNoise]]:
    """Estimate the velocities that were not logged, and the noise level of every signal.

    Velocities come from a smoother (not causal) of each stretch between gaps, as late behind the
    positions as the model's own are.

    Parameters
    ----------
    runs : sequence of LogRun
        Cleaned and aligned.
    robot : ModelJoints
        The joints and actuators of the model.
    settings : LoggedNoiseSettings, optional
        From how much of the log noise levels are estimated.

    Returns
    -------
    runs : list of LogRun
        With a velocity for every position.
    noise : dict
        `SignalNoise` of every column by its name.
    """
    levels = _NoiseLevels()
    evaluated = set(np.linspace(0, len(runs) - 1, min(settings.runs, len(runs))).astype(int))
    out = []
    for i, run in enumerate(runs):
        velocities = []
        for series in run.series:
            channel = series.channel
            if channel.field == "qpos" and run.of("qvel", channel.name) is None:
                joint = robot.joints[channel.name]
                velocity, noise = _estimate_velocity(series, joint, settings)
                velocities.append(velocity.shift(robot.velocity_lag))
                levels.add(velocity.channel, noise, len(velocity.time), estimated=True)
            if i in evaluated:
                noise, smoothed = _measurement_noise(series, settings)
                levels.add(channel, noise, len(series.time), estimated=False)
                logged = run.of("qvel", channel.name)
                if channel.field == "qpos" and logged is not None and len(channel.units) == 1:
                    levels.add_smoothed(logged.label, smoothed, len(series.time))
        out.append(replace(run, series=(*run.series, *velocities)))
    return out, levels.pool()


def compare_velocities(
    run: LogRun, settings: LoggedNoiseSettings = DEFAULTS
) -> dict[str, SignalNoise]:
    """Compare the noise of logged velocities with that of smoothed ones.

    Parameters
    ----------
    run : LogRun
        Cleaned.
    settings : LoggedNoiseSettings, optional
        From how much of the run.

    Returns
    -------
    dict
        `SignalNoise` of every logged velocity of a hinge or slide, by its name.
    """
    levels = _NoiseLevels()
    for series in run.series:
        position = run.of("qpos", series.channel.name)
        if series.channel.field != "qvel" or position is None or series.values.shape[1] != 1:
            continue
        noise, _ = _measurement_noise(series, settings)
        _, smoothed = _measurement_noise(position, settings)
        levels.add(series.channel, noise, len(series.time), estimated=False)
        levels.add_smoothed(series.label, smoothed, len(series.time))
    return levels.pool()


class _NoiseLevels:
    """The noise levels of every column in several runs."""

    def __init__(self) -> None:
        self._levels: dict[str, list[tuple[float, int]]] = {}
        self._signals: dict[str, tuple[str, bool]] = {}
        self._smoothed: dict[str, list[tuple[float, int]]] = {}

    def add_smoothed(self, name: str, noise: Array, rows: int) -> None:
        """Add the noise (1,) that a velocity from so many rows of a position would have."""
        self._smoothed.setdefault(name, []).append((float(noise[0]), rows))

    def add(self, channel: Channel, noise: Array, rows: int, *, estimated: bool) -> None:
        """Add the noise (k,) of so many rows of a channel."""
        for i, (unit, sd) in enumerate(zip(channel.units, noise, strict=True)):
            name = channel.label if len(channel.units) == 1 else f"{channel.label}[{i}]"
            self._levels.setdefault(name, []).append((float(sd), rows))
            self._signals[name] = (unit, estimated)

    def pool(self) -> dict[str, SignalNoise]:
        """The noise of each column, from the mean variance of all rows."""
        pooled = {}
        for name, levels in self._levels.items():
            unit, estimated = self._signals[name]
            smoothed = _pool(self._smoothed.get(name, []))
            pooled[name] = SignalNoise(_pool(levels), unit, estimated, smoothed)
        return pooled


def _pool(levels: Sequence[tuple[float, int]]) -> float | None:
    """The noise of the mean variance of all rows; None where none is known."""
    known = [level for level in levels if np.isfinite(level[0])]
    if not known:
        return None
    sds, rows = np.array(known).T
    return float(np.sqrt(np.sum(rows * sds**2) / np.sum(rows)))


def _measurement_noise(series: TimeSeries, settings: LoggedNoiseSettings) -> tuple[Array, Array]:
    """(k,) of the logged numbers, and (k,) of the slope of a smoother, from the longest stretch.

    NaN for commands and short ones.
    """
    pieces = _pieces(series, settings) if series.channel.field != "ctrl" else []
    unknown = np.full(series.values.shape[1], np.nan)
    if not pieces:
        return unknown, unknown
    rows = max(pieces, key=len)[: settings.rows]
    if np.ptp(series.values[rows], axis=0).max() == 0:
        return unknown, unknown
    found = estimate_velocities(series.time[rows], series.values[rows])
    noise = found.position_noise
    if series.channel.field == "sensordata":
        # accelerations jump with the commands, which no smoother follows
        zigzag = np.median(np.abs(np.diff(series.values[rows], n=2, axis=0)), axis=0)
        noise = np.minimum(noise, zigzag / ZIGZAG)
    return noise, found.velocity_noise


def _pieces(series: TimeSeries, settings: LoggedNoiseSettings) -> list[Ints]:
    """The rows of the stretches between gaps that are long enough."""
    pieces = np.split(np.arange(len(series.time)), find_gaps(series.time))
    return [piece for piece in pieces if len(piece) >= settings.minimum_rows]


def _estimate_velocity(
    position: TimeSeries, joint: Joint, settings: LoggedNoiseSettings
) -> tuple[TimeSeries, Array]:
    """The velocity of a position in stretches that are long enough, and its noise (k,)."""
    units = joint.units("qvel")
    channel = replace(position.channel, field="qvel", units=units, columns=units)
    pieces = _pieces(position, settings)
    if not pieces:
        still = np.zeros((len(position.time), len(units)))
        empty = TimeSeries(channel, position.time, still, position.rows)
        return empty, np.full(len(units), np.nan)
    velocities = []
    variances = []
    for rows in pieces:
        values = continuous(position.values[rows], joint)
        found, noise = joint_velocities(estimate_velocities(position.time[rows], values), joint)
        velocities.append(found)
        variances.append(len(rows) * noise**2)
    rows = np.concatenate(pieces)
    found = np.concatenate(velocities)
    series = TimeSeries(channel, position.time[rows], found, position.rows[rows])
    return series, np.sqrt(sum(variances) / len(rows))
