"""Which stamps of a recording are late, by how much, and the same recording without the delays.

In reading order: `align_runs` first brings sources with clocks of their own to the log's clock
(`_estimate_source_clock`), then each velocity to its position (`_velocity_delay`), and each sensor
to what the model's own shows along the positions (`_sensor_delay`).
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from dropo.core.services.errors import BadArgument
from dropo.core.services.validation import Array
from dropo.data.checks.kinematics import rotation_vectors
from dropo.logs.mapping import Source
from dropo.logs.recordings import LogRun, TimeSeries
from dropo.logs.signals.delays import estimate_clock, estimate_delay
from dropo.logs.signals.joint_motion import ShownSensors, sensors_shown
from dropo.logs.signals.resampling import resample, resample_rotations
from dropo.logs.signals.velocities import estimate_velocities
from dropo.mjmodel.dynamics.forces import inverse_forces
from dropo.mjmodel.joints import Joint, ModelJoints
from dropo.mjmodel.sensors import Sensor


@dataclass(frozen=True)
class AlignmentSettings:
    """How delays are estimated, and when they are removed.

    Attributes
    ----------
    rows : int
        Largest number of rows that a delay is estimated from.
    sensor_rows : int
        Largest number of rows where what the model's sensor shows must be computed.
    minimum_rows : int
        Smallest number of rows that a delay is estimated from.
    largest_offset : float
        Two clocks are within this of each other, or else their first rows are [s].
    certain : float
        A delay of more standard errors than this is removed.
    smallest : float
        A delay of less than this is not removed, however certain [s].
    runs : int
        Largest number of runs that a constant delay is estimated from.
    disagreement : float
        Mean square of the runs' deviations, in standard errors, from which they have delays of
        their own.
    smallest_error : float
        Least standard error of a delay [s].
    window : float
        Length of the windows over which displacements are compared [s].
    explained : float
        Fraction of a signal's variance without which a delay means nothing.
    """

    rows: int = 20000
    sensor_rows: int = 4000
    minimum_rows: int = 50
    largest_offset: float = 0.5
    certain: float = 3.0
    smallest: float = 5e-5
    runs: int = 12
    disagreement: float = 9.0
    smallest_error: float = 1e-6
    window: float = 0.05
    explained: float = 0.25


DEFAULTS = AlignmentSettings()


@dataclass(frozen=True)
class SignalDelay:
    """By how much the stamps of a signal are late, against those of a reference.

    At t on the reference's clock they are late by seconds + skew (t - origin).

    Attributes
    ----------
    signal, reference : str
        Labels of the series.
    seconds : float
        The delay [s].
    se : float
        Its standard error [s].
    skew : float
        How much faster the signal's clock runs, as a fraction.
    skew_se : float
        Its standard error.
    origin : float
        The reference's first stamp [s].
    run : str or None
        The run; None where one delay was found for all.
    removed : bool
        Whether the delay stands out of its error, so that an import removes it.
    """

    signal: str
    reference: str
    seconds: float
    se: float
    skew: float = 0.0
    skew_se: float = 0.0
    origin: float = 0.0
    run: str | None = None
    removed: bool = False

    def __str__(self) -> str:
        where = f"{self.run}: " if self.run else ""
        skew = f", and its clock runs {1e6 * self.skew:+.4g} ppm fast" if self.skew else ""
        done = "taken off" if self.removed else "too little to tell, left"
        return (
            f"{where}{self.signal} is {1e3 * self.seconds:.4g} +- {1e3 * self.se:.2g} ms "
            f"behind {self.reference}{skew}: {done}."
        )

    def correct(self, series: TimeSeries) -> TimeSeries:
        """Give a series the stamps of the reference's clock.

        Parameters
        ----------
        series : TimeSeries
            With the signal's stamps.

        Returns
        -------
        TimeSeries
            The same where the delay is not removed.
        """
        if not self.removed:
            return series
        since = (series.time - self.origin - self.seconds) / (1 + self.skew)
        return replace(series, time=self.origin + since)


def align_runs(
    runs: Sequence[LogRun], robot: ModelJoints, settings: AlignmentSettings = DEFAULTS
) -> tuple[list[LogRun], list[SignalDelay]]:
    """Find delays and remove them.

    Parameters
    ----------
    runs : sequence of LogRun
        Cleaned.
    robot : ModelJoints
        The joints and actuators of the model.
    settings : AlignmentSettings, optional
        How delays are estimated.

    Returns
    -------
    runs : list of LogRun
        On the log's clock, without the delays that were removed.
    delays : list of SignalDelay
        All that were found.

    Notes
    -----
    A source with a clock of its own is brought to the log's by its velocities or positions, beside
    the same joint's on the log's clock, or by its commands, beside the forces that the motion
    needs. A velocity on the log's clock is brought to its position, as late behind it as the
    model's own velocities are (`ModelJoints.velocity_lag`), which is not counted as a delay. A
    sensor of orientations or velocities is brought to what the model's own one shows along the
    positions, and an accelerometer of the same mount and source goes with it: its own motion is too
    rough to tell.
    """
    found: list[SignalDelay] = []
    aligned = []
    for run in runs:
        for source in _sources_with_clocks(run):
            delay = _estimate_source_clock(run, source, robot, settings)
            if delay is not None:
                found.append(delay)
                labels = [one.label for one in run.series if one.channel.source == source]
                run = _correct(run, delay, labels)
        aligned.append(run)
    for name in robot.joints:
        delays = _common_delay(aligned, partial(_velocity_delay, name, robot, settings), settings)
        found += delays
        _take_off(aligned, delays)
    # sensors
    shown = _ShownOnce(robot, settings)
    for sensor in robot.sensors.values():
        if sensor.stage == "acceleration":
            continue
        delays = _common_delay(aligned, partial(_sensor_delay, sensor, shown), settings)
        companions = _companions(aligned, sensor, robot)
        found += delays
        _take_off(aligned, delays)
        for delay in delays:
            for label in companions:
                seconds = delay.seconds + _lag(sensor, robot)
                of_companion = replace(delay, signal=label, seconds=seconds)
                found.append(of_companion)
                _take_off(aligned, [of_companion])
    return aligned, found


def _take_off(runs: list[LogRun], delays: Sequence[SignalDelay]) -> None:
    """Remove delays of one signal from runs: one for all, or each run's own."""
    by_run = {delay.run: delay for delay in delays}
    for i, run in enumerate(runs):
        delay = by_run.get(run.name, by_run.get(None))
        if delay is not None:
            runs[i] = _correct(run, delay, [delay.signal])


def _sources_with_clocks(run: LogRun) -> list[Source]:
    """The sources of a run whose stamps come from another clock than the log's."""
    sources = [series.channel.source for series in run.series]
    return list(dict.fromkeys(source for source in sources if source.own_clock))


def _correct(run: LogRun, delay: SignalDelay, labels: list[str]) -> LogRun:
    """The run with a delay removed from the series of these labels."""
    series = [delay.correct(one) if one.label in labels else one for one in run.series]
    return replace(run, series=tuple(series))


def _mark(delay: SignalDelay, settings: AlignmentSettings) -> SignalDelay:
    """The delay, with whether it is removed."""
    late = abs(delay.seconds) > max(settings.certain * delay.se, settings.smallest)
    fast = abs(delay.skew) > settings.certain * delay.skew_se > 0
    return replace(delay, removed=bool(late or fast))


# Signals on the log's clock


def _common_delay(
    runs: list[LogRun],
    delay_of: Callable[[LogRun], SignalDelay | None],
    settings: AlignmentSettings,
) -> list[SignalDelay]:
    """How late a signal is: one delay for all runs, or each its own where they disagree."""
    some = np.linspace(0, len(runs) - 1, min(settings.runs, len(runs))).astype(int)
    each = _delays_of_runs([runs[i] for i in some], delay_of)
    if not each:
        return []
    seconds = np.array([delay.seconds for delay in each])
    weights = np.array([max(delay.se, settings.smallest_error) ** -2 for delay in each])
    mean = float(np.sum(weights * seconds) / np.sum(weights))
    spread = float(np.sum(weights * (seconds - mean) ** 2)) / max(1, len(each) - 1)
    if spread > settings.disagreement:
        return _delays_of_runs(runs, delay_of)
    se = float(np.sqrt(max(1.0, spread) / np.sum(weights)))
    return [_mark(replace(each[0], seconds=mean, se=se, run=None), settings)]


def _delays_of_runs(
    runs: Sequence[LogRun], delay_of: Callable[[LogRun], SignalDelay | None]
) -> list[SignalDelay]:
    """The delays of the runs in which one can be estimated."""
    delays = [delay_of(run) for run in runs]
    return [delay for delay in delays if delay is not None]


def _velocity_delay(
    name: str, robot: ModelJoints, settings: AlignmentSettings, run: LogRun
) -> SignalDelay | None:
    """How much later a measured velocity is than the position of the same joint, on one clock."""
    position = run.of("qpos", name)
    velocity = run.of("qvel", name)
    if position is None or velocity is None or robot.joints[name].kind == "ball":
        return None
    reference = _Curve(position.label, *_displacements(position, robot, settings))
    signal = _Curve(velocity.label, *_displacements(velocity, robot, settings))
    return _delay_between(reference, signal, run.name, settings)


def _delay_between(
    reference: "_Curve", signal: "_Curve", run: str, settings: AlignmentSettings
) -> SignalDelay | None:
    """How much later a signal is than a reference on the same clock."""
    time = reference.time
    stamps = signal.time
    if not len(stamps):
        return None
    # both at the reference's stamps
    both = (time >= stamps[0]) & (time <= stamps[-1])
    if both.sum() < settings.minimum_rows:
        return None
    time = time[both]
    known = reference.values[both]
    late = resample(stamps, signal.values, time)
    moving = (np.ptp(known, axis=0) > 0) & (np.ptp(late, axis=0) > 0)
    if not moving.any():
        return None
    found = estimate_delay(time, known[:, moving], late[:, moving])
    if not (np.isfinite(found.se) and found.se > 0 and found.explained > settings.explained):
        return None
    delay = SignalDelay(signal.name, reference.name, found.seconds, found.se, run=run)
    return _mark(delay, settings)


def _displacements(
    series: TimeSeries, robot: ModelJoints, settings: AlignmentSettings
) -> tuple[Array, Array]:
    """Stamps (n,), and displacements (n, k) of a joint in the window around each of them.

    They come from its position or velocity, of a part of a long log. A velocity is integrated
    rather than a position differentiated: impacts leave no trace in it.
    """
    time = series.time[: settings.rows]
    values = _linear_part(series, robot.joints[series.channel.name])[: settings.rows]
    if series.channel.field == "qpos":
        return _changes(time, values, settings)
    return _integrals(time - robot.velocity_lag, values, settings)


def _half_window(time: Array, settings: AlignmentSettings) -> tuple[float, Array]:
    """Half of the window, and the stamps around which it has rows."""
    half = max(settings.window, 5 * float(np.median(np.diff(time)))) / 2
    return half, time[(time >= time[0] + half) & (time <= time[-1] - half)]


def _changes(
    time: Array, values: Array, settings: AlignmentSettings, *, rotation: bool = False
) -> tuple[Array, Array]:
    """Stamps (n,), and by how much values (n, k) change in the window around each of them."""
    half, inside = _half_window(time, settings)
    ends = [np.clip(inside + shift, time[0], time[-1]) for shift in (-half, half)]
    if rotation and len(inside):
        earlier, later = (resample_rotations(time, values, end) for end in ends)
        return inside, rotation_vectors(earlier, later)
    earlier, later = (resample(time, values, end) for end in ends)
    return inside, later - earlier


def _integrals(time: Array, values: Array, settings: AlignmentSettings) -> tuple[Array, Array]:
    """Stamps (n,), and the integrals of values (n, k) over the window around each of them."""
    half, inside = _half_window(time, settings)
    steps = np.diff(time)[:, None] * (values[1:] + values[:-1]) / 2
    total = np.concatenate([np.zeros_like(values[:1]), np.cumsum(steps, axis=0)])
    integral = CubicHermiteSpline(time, total, values)
    return inside, integral(inside + half) - integral(inside - half)


def _linear_part(series: TimeSeries, joint: Joint) -> Array:
    """The numbers (n, k) of a position or velocity that are no rotations in space."""
    width = {"free": 3, "ball": 0}.get(joint.kind)
    return series.values[:, :width]


# Sensors behind the model's own


class _ShownOnce:
    """What the model's sensors show along the positions of runs, computed once for each run."""

    def __init__(self, robot: ModelJoints, settings: AlignmentSettings):
        self.robot = robot
        self.settings = settings
        self._by_run: dict[int, tuple[LogRun, ShownSensors | None]] = {}

    def curves(self, run: LogRun, sensor: Sensor) -> "tuple[_Curve, _Curve] | None":
        """What the model's sensor shows, and what was logged, in windows; None where unknown."""
        series = run.of("sensordata", sensor.name)
        shown = None if series is None else self._along(run)
        if series is None or shown is None or sensor.name not in shown.by_name:
            return None
        modelled = _Curve(
            f"the model's {sensor.name} along the positions",
            *_windows(sensor, shown.time, shown.by_name[sensor.name], self.settings),
        )
        time = series.time[: self.settings.rows] - _lag(sensor, self.robot)
        values = series.values[: self.settings.rows]
        return modelled, _Curve(series.label, *_windows(sensor, time, values, self.settings))

    def _along(self, run: LogRun) -> ShownSensors | None:
        """What all sensors that were logged show along the positions, which no delay moves."""
        position = next(one for one in run.series if one.channel.field == "qpos")
        key = id(position)
        if key not in self._by_run:
            names = [one.channel.name for one in run.series if one.channel.field == "sensordata"]
            sensors = [self.robot.sensors[name] for name in names]
            rows = self.settings.sensor_rows
            shown = sensors_shown(run, self.robot, sensors, rows, self.settings.minimum_rows)
            self._by_run[key] = run, shown
        return self._by_run[key][1]


def _windows(
    sensor: Sensor, time: Array, values: Array, settings: AlignmentSettings
) -> tuple[Array, Array]:
    """Changes of a position, or integrals of anything else, in windows."""
    if sensor.stage == "position":
        return _changes(time, values, settings, rotation=sensor.is_rotation)
    return _integrals(time, values, settings)


def _lag(sensor: Sensor, robot: ModelJoints) -> float:
    """By how much the model's own sensor is behind its positions [s]."""
    return robot.velocity_lag if sensor.stage == "velocity" else 0.0


def _sensor_delay(sensor: Sensor, shown: _ShownOnce, run: LogRun) -> SignalDelay | None:
    """How much later a sensor is than the model's own along the positions, on one clock."""
    curves = shown.curves(run, sensor)
    return None if curves is None else _delay_between(*curves, run.name, shown.settings)


def _companions(runs: Sequence[LogRun], sensor: Sensor, robot: ModelJoints) -> list[str]:
    """The labels of accelerometers of the mount and source of a gyro."""
    series = runs[0].of("sensordata", sensor.name)
    if series is None or sensor.kind != "gyro":
        return []
    found = []
    for other in runs[0].series:
        if other.channel.field != "sensordata" or other.channel.source != series.channel.source:
            continue
        own = robot.sensors[other.channel.name]
        if own.stage == "acceleration" and own.mount == sensor.mount:
            found.append(other.label)
    return found


# Sources with a clock of their own


@dataclass(frozen=True, eq=False)
class _Curve:
    """Numbers (n, k) at stamps (n,) [s]."""

    name: str
    time: Array
    values: Array


def _estimate_source_clock(
    run: LogRun, source: Source, robot: ModelJoints, settings: AlignmentSettings
) -> SignalDelay | None:
    """How late and how fast a source's clock is, by the first pair of curves that agree."""
    for reference, signal in _pairs(run, source, robot, settings):
        if len(signal.time) < settings.minimum_rows or not len(reference.time):
            continue
        # clocks that are far apart are compared from their first rows on
        start = float(signal.time[0] - reference.time[0])
        if abs(start) < settings.largest_offset:
            start = 0.0
        moving = (np.ptp(reference.values, axis=0) > 0) & (np.ptp(signal.values, axis=0) > 0)
        if not moving.any():
            continue
        try:
            found = estimate_clock(
                reference.time,
                reference.values[:, moving],
                signal.time - start,
                signal.values[:, moving],
                max_delay=settings.largest_offset,
            )
        except BadArgument:
            continue
        if found.explained > settings.explained:
            delay = SignalDelay(
                signal=signal.name,
                reference=reference.name,
                seconds=found.seconds + start,
                se=found.se,
                skew=found.skew,
                skew_se=found.skew_se,
                origin=found.origin,
                run=run.name,
            )
            return _mark(delay, settings)
    return None


def _pairs(
    run: LogRun, source: Source, robot: ModelJoints, settings: AlignmentSettings
) -> Iterator[tuple[_Curve, _Curve]]:
    """What the log's clock and the source's both saw.

    These are displacements of joints, then the forces that the motion needs and commands.
    """
    for name, joint in robot.joints.items():
        own = _first_series(run, name, ("qvel", "qpos"), source)
        main = _first_series(run, name, ("qpos", "qvel"), None)
        if own is not None and main is not None and joint.kind != "ball":
            reference = _Curve(main.label, *_displacements(main, robot, settings))
            yield reference, _Curve(own.label, *_displacements(own, robot, settings))
    shown = _ShownOnce(robot, settings)
    of_source = [series for series in run.series if series.channel.source == source]
    logged = [one.channel.name for one in of_source if one.channel.field == "sensordata"]
    # what is rough comes last
    for sensor in sorted((robot.sensors[name] for name in logged), key=_is_rough):
        curves = shown.curves(run, sensor)
        if curves is not None:
            yield curves
            if sensor.may_be_turned:  # lengths, which a turned mount does not change
                reference, signal = (replace(one, values=_lengths(one.values)) for one in curves)
                yield reference, signal
    for series in of_source:
        if series.channel.field != "ctrl":
            continue
        driven = robot.actuators[series.channel.name].joint
        forces = None if driven is None else _needed_forces(run, robot, driven.qvel, settings)
        if forces is not None:
            # from a row to the middle of its effect
            held = float(np.median(np.diff(series.time))) / 2 - robot.velocity_lag
            yield forces, _Curve(series.label, series.time + held, series.values)


def _lengths(values: Array) -> Array:
    """The length (n, 1) of each row."""
    return np.asarray(np.linalg.norm(values, axis=1, keepdims=True))


def _is_rough(sensor: Sensor) -> bool:
    """Whether a sensor shows accelerations."""
    return sensor.stage == "acceleration"


def _first_series(
    run: LogRun, name: str, fields: Sequence[str], source: Source | None
) -> TimeSeries | None:
    """The first series of a joint that a source has, or, for None, that is on the log's clock."""
    for field in fields:
        series = run.of(field, name)
        if series is None:
            continue
        there = series.channel.source
        fits = there == source if source is not None else not there.own_clock
        if fits:
            return series
    return None


def _needed_forces(
    run: LogRun, robot: ModelJoints, dof: int, settings: AlignmentSettings
) -> _Curve | None:
    """The generalised force (n, 1) at a degree of freedom that the motion needs (mj_inverse).

    None where a position is missing.
    """
    positions = []
    for name, joint in robot.joints.items():
        series = run.of("qpos", name)
        if series is None or series.channel.source.own_clock or joint.quaternion() is not None:
            return None
        positions.append(series)
    time = positions[0].time[: settings.rows]
    first = max(series.time[0] for series in positions)
    last = min(series.time[-1] for series in positions)
    time = time[(time >= first) & (time <= last)]
    if len(time) < settings.minimum_rows:
        return None
    qpos = np.hstack([resample(series.time, series.values, time) for series in positions])
    motion = estimate_velocities(time, qpos)
    accelerations = np.gradient(motion.velocities, time, axis=0)
    forces = inverse_forces(robot.model, motion.positions, motion.velocities, accelerations)
    return _Curve("the forces that the motion needs", time, forces[:, [dof]])
