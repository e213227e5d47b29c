"""A recording on the grid of control steps: where it is whole, and what every signal is there."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dropo.core.records.trajectories import Ints
from dropo.core.services.validation import Array
from dropo.logs.recordings import LogRun, TimeSeries
from dropo.logs.signals.resampling import resample, resample_rotations
from dropo.logs.signals.stamps import find_gaps
from dropo.mjmodel.joints import ModelJoints


@dataclass(frozen=True)
class GridSettings:
    """How a recording is put on the grid of control steps.

    Attributes
    ----------
    on_grid : float
        Stamps within this fraction of a control step of the grid are on it, and are not resampled.
    shortest : int
        Rows of the shortest trajectory that is kept: one of fewer holds no transition worth it.
    """

    on_grid: float = 1e-3
    shortest: int = 3


DEFAULTS = GridSettings()


@dataclass(frozen=True)
class UnusedSpan:
    """A span of a run that is in no trajectory.

    Attributes
    ----------
    run : str
        The run.
    start, stop : float
        From when to when [s].
    why : str
        The reason.
    """

    run: str
    start: float
    stop: float
    why: str


@dataclass(frozen=True, eq=False)
class GridSpan:
    """A whole piece of a run.

    Attributes
    ----------
    at : (n,) array
        The instants of its grid [s].
    resampled : frozenset of str
        The labels of the series whose rows are not on the grid.
    """

    at: Array
    resampled: frozenset[str]


def steps_per_action(
    runs: Sequence[LogRun], timestep: float, rate: float | None
) -> tuple[int, float]:
    """Find how many physics steps make a control step.

    Parameters
    ----------
    runs : sequence of LogRun
        With positions.
    timestep : float
        A physics step [s].
    rate : float or None
        Control steps in a second [Hz]; by default the median over the runs of the median step of
        the first position's stamps.

    Returns
    -------
    count : int
        Physics steps.
    error : float
        How much longer the wanted control step is than so many, as a fraction.
    """
    if rate is None:
        steps = [float(np.median(np.diff(_first_position(run.series).time))) for run in runs]
        wanted = float(np.median(steps))
    else:
        wanted = 1 / rate
    count = max(1, round(wanted / timestep))
    return count, wanted / (count * timestep) - 1


def _first_position(series: Sequence[TimeSeries]) -> TimeSeries:
    """The first series of positions."""
    return next(one for one in series if one.channel.field == "qpos")


# Where a run is whole


def whole_spans(
    run: LogRun, series: Sequence[TimeSeries], step: float, settings: GridSettings = DEFAULTS
) -> tuple[list[GridSpan], list[UnusedSpan]]:
    """Find the pieces of a run in which every series has rows.

    Parameters
    ----------
    run : LogRun
        The run.
    series : sequence of TimeSeries
        Those that must have rows.
    step : float
        A control step [s].
    settings : GridSettings, optional
        What is on the grid, and long enough.

    Returns
    -------
    spans : list of GridSpan
        The pieces, on a grid of control steps.
    excluded : list of UnusedSpan
        The spans between them.
    """
    begin = max(float(one.time[0]) for one in series)
    end = min(_end(one) for one in series)
    first = min(float(one.time[0]) for one in series)
    last = max(float(one.time[-1]) for one in series)
    excluded = []
    for start, stop in ((first, begin), (end, last)):
        if stop - start > step:
            excluded.append(UnusedSpan(run.name, start, stop, "not every signal is there"))
    holes: list[UnusedSpan] = []
    for one in series:
        holes += _find_holes(run.name, one)
    spans = []
    for hole in _merge(holes):
        if hole.start > begin:
            stop = min(hole.start, end)
            spans += _make_span(run.name, series, (begin, stop), step, excluded, settings)
        excluded.append(hole)
        begin = max(begin, hole.stop)
    spans += _make_span(run.name, series, (begin, end), step, excluded, settings)
    return spans, excluded


def _end(series: TimeSeries) -> float:
    """Until when a series holds: a command for a step behind its last row."""
    held = float(np.median(np.diff(series.time))) if series.channel.field == "ctrl" else 0.0
    return float(series.time[-1]) + held


def _merge(holes: Iterable[UnusedSpan]) -> list[UnusedSpan]:
    """Spans in order, those that overlap as one, whose reason is the first one's."""
    out: list[UnusedSpan] = []
    for hole in sorted(holes, key=lambda hole: hole.start):
        if out and hole.start < out[-1].stop:
            out[-1] = replace(out[-1], stop=max(out[-1].stop, hole.stop))
        else:
            out.append(hole)
    return out


def _find_holes(run: str, series: TimeSeries) -> list[UnusedSpan]:
    """Where there are no numbers for too long: nothing was logged, or nothing that can be used."""
    out = []
    for i in find_gaps(series.time):
        lost = int(series.rows[i] - series.rows[i - 1]) - 1
        why = f"a gap in the stamps of {series.label}"
        if lost:
            why = f"{lost} rows of {series.label} hang, or have no value"
        out.append(UnusedSpan(run, float(series.time[i - 1]), float(series.time[i]), why))
    return out


def _make_span(
    run: str,
    series: Sequence[TimeSeries],
    within: tuple[float, float],
    step: float,
    excluded: list[UnusedSpan],
    settings: GridSettings,
) -> list[GridSpan]:
    """The piece within two instants, or none, noted in `excluded`, where it is too short.

    The grid begins on a position's stamp, so that the shift of estimated velocities does not move
    the commands.
    """
    begin, end = within
    stamps = _first_position(series).time
    later = stamps[stamps >= begin - settings.on_grid * step]
    begin = float(later[0]) if len(later) else begin
    if end <= begin:
        return []
    count = int((end - begin) / step * (1 + 1e-12) + settings.on_grid) + 1
    at: Array = begin + step * np.arange(count, dtype=np.float64)
    if count < settings.shortest:
        why = f"shorter than {settings.shortest} control steps"
        excluded.append(UnusedSpan(run, begin, end, why))
        return []
    resampled = [
        one.label for one in series if not _is_on_grid(one.time, at, settings.on_grid * step)
    ]
    return [GridSpan(at, frozenset(resampled))]


def _nearest(time: Array, at: Array) -> Ints:
    """The row whose stamp is nearest to each instant."""
    after = np.clip(np.searchsorted(time, at), 1, len(time) - 1)
    return after - (at - time[after - 1] < time[after] - at)


def _is_on_grid(time: Array, at: Array, within: float) -> bool:
    """Whether every instant of the grid is a stamp; a command's last row may be missing."""
    distance = np.abs(time[_nearest(time, at)] - at)
    near = distance < within
    return bool(near[:-1].all() and (near[-1] or at[-1] > time[-1]))


# What the signals are there


def sample_state(series: TimeSeries, span: GridSpan, rotation: slice | None) -> Array:
    """Take a position, a velocity or a sensor's numbers on the grid.

    Parameters
    ----------
    series : TimeSeries
        k numbers.
    span : GridSpan
        n instants.
    rotation : slice or None
        The places of a quaternion among the numbers.

    Returns
    -------
    (n, k) array
        As they were logged where the stamps are on the grid; else by Akima splines, and by great
        arcs for rotations.
    """
    if series.label not in span.resampled:
        return series.values[_nearest(series.time, span.at)]
    at = np.clip(span.at, series.time[0], series.time[-1])
    values = resample(series.time, series.values, at)
    if rotation is not None:
        measured = series.values[:, rotation]
        values[:, rotation] = resample_rotations(series.time, measured, at)
    return values


def sample_command(
    series: TimeSeries, span: GridSpan, step: float, settings: GridSettings = DEFAULTS
) -> Array:
    """Take a command on the grid.

    Parameters
    ----------
    series : TimeSeries
        The command.
    span : GridSpan
        n instants.
    step : float
        A control step [s].
    settings : GridSettings, optional
        What is on the grid.

    Returns
    -------
    (n, 1) array
        Each row is held until the next, and averaged over the control step.
    """
    row = np.searchsorted(series.time, span.at + settings.on_grid * step, side="right") - 1
    one_each = bool((np.diff(row) == 1).all())  # row in each control step
    if series.label not in span.resampled and one_each:
        return series.values[row]
    return held_means(series.time, series.values, span.at, step)


def held_means(time: Array, values: Array, at: Array, step: float) -> Array:
    """Average values that are held from their stamps to the next, the last for good.

    Parameters
    ----------
    time : (n,) array
        Increasing stamps [s].
    values : (n, q) array
        What is held.
    at : (m,) array
        Where the means begin [s].
    step : float
        Over how long they are [s].

    Returns
    -------
    (m, q) array
        The means over each [at, at + step].
    """
    areas = np.cumsum(values[:-1] * np.diff(time)[:, None], axis=0)
    held = np.concatenate([np.zeros((1, values.shape[1])), areas])

    def integrate(instants: Array) -> Array:
        row = np.clip(np.searchsorted(time, instants, side="right") - 1, 0, None)
        return np.asarray(held[row] + values[row] * (instants - time[row])[:, None])

    return (integrate(at + step) - integrate(at)) / step


def observation_items(
    robot: ModelJoints, names: Sequence[str], sensors: Sequence[str] = ()
) -> list[str]:
    """Name the items of an observation, as a problem file does.

    Parameters
    ----------
    robot : ModelJoints
        All joints of the model.
    names : sequence of str
        The joints that were measured.
    sensors : sequence of str
        The sensors.

    Returns
    -------
    list of str
        Positions, then velocities, in the model's order, and the sensors in theirs.
    """
    others = [f"sensordata.{name}" for name in sensors]
    if len(names) == len(robot.joints):
        return ["qpos", "qvel", *others]
    ordered = [names[i] for i in _model_order(robot, names)]
    states = [*(f"qpos.{name}" for name in ordered), *(f"qvel.{name}" for name in ordered)]
    return states + others


def join_observations(
    robot: ModelJoints,
    names: Sequence[str],
    positions: Sequence[Array],
    velocities: Sequence[Array],
) -> Array:
    """Join positions and velocities of joints into observations.

    Parameters
    ----------
    robot : ModelJoints
        All joints of the model.
    names : sequence of str
        The joints that were measured.
    positions, velocities : sequences of (n, k) arrays
        Of each of them.

    Returns
    -------
    (n, p) array
        In the order of `observation_items`.
    """
    order = _model_order(robot, names)
    return np.hstack([*(positions[i] for i in order), *(velocities[i] for i in order)])


def _model_order(robot: ModelJoints, names: Sequence[str]) -> list[int]:
    """Places of the joints in the order of the model."""
    return sorted(range(len(names)), key=lambda i: robot.joints[names[i]].qpos)
