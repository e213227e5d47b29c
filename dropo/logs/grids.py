"""A recording on the grid of control steps: where it is whole, and what every signal is there."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dropo.core.records.trajectories import Ints
from dropo.core.services.validation import Array
from dropo.logs.recordings import Run, Series
from dropo.logs.signals.resampling import resample, resample_rotations
from dropo.logs.signals.stamps import gaps
from dropo.mjmodel.joints import Joint, ModelJoints

SHORT = 3
"""A trajectory of fewer rows holds no transition worth keeping."""
ON_GRID = 1e-3
"""Stamps within this share of a control step of the grid are taken to be on it: nothing is
resampled then.
"""
CLOSE = 0.05
"""How far a rate may be from the model's own, as a share."""


@dataclass(frozen=True)
class LeftOut:
    """A span of a run that is in no trajectory, and why."""

    run: str
    start: float
    stop: float
    why: str


@dataclass(frozen=True, eq=False)
class Span:
    """A whole piece of a run: the instants (n,) of its grid, and the labels of the series whose
    rows had to be resampled.
    """

    at: Array
    resampled: frozenset[str]


def steps_per_action(runs: Sequence[Run], timestep: float, rate: float | None) -> tuple[int, float]:
    """Physics steps in one control step, and how far the log's or the mapping's rate is from it, as
    a share of it.

    Without a rate, the median over the runs of the median step of the first position's stamps.
    """
    positions = [
        next(series for series in run.series if series.channel.field == "qpos") for run in runs
    ]
    wanted = (
        float(np.median([np.median(np.diff(series.time)) for series in positions]))
        if rate is None
        else 1 / rate
    )
    count = max(1, round(wanted / timestep))
    return count, wanted / (count * timestep) - 1


def whole_spans(
    run: Run, series: Sequence[Series], step: float
) -> tuple[list[Span], list[LeftOut]]:
    """The pieces of a run in which every series has rows, on a grid of `step` seconds, and the
    spans between them.
    """
    begin = max(one.time[0] for one in series)
    end = min(
        one.time[-1] + (np.median(np.diff(one.time)) if one.channel.field == "ctrl" else 0.0)
        for one in series
    )
    first = min(one.time[0] for one in series)
    last = max(one.time[-1] for one in series)
    out: list[LeftOut] = [
        LeftOut(run.name, a, b, "not every signal is there")
        for a, b in ((first, begin), (end, last))
        if b - a > step
    ]
    holes = _joined(hole for one in series for hole in _holes(run.name, one))
    spans = []
    for hole in (*holes, LeftOut(run.name, end, end, "")):
        if hole.start > begin or not hole.why:
            spans += _span(run.name, series, begin, min(hole.start, end), step, out)
        if hole.why:
            out.append(hole)
        begin = max(begin, hole.stop)
    return spans, out


def _joined(holes: Iterable[LeftOut]) -> list[LeftOut]:
    """Spans in order, those that overlap as one, whose reason is the first one's."""
    out: list[LeftOut] = []
    for hole in sorted(holes, key=lambda hole: hole.start):
        if out and hole.start < out[-1].stop:
            out[-1] = replace(out[-1], stop=max(out[-1].stop, hole.stop))
        else:
            out.append(hole)
    return out


def _holes(run: str, series: Series) -> list[LeftOut]:
    """Where there are no numbers for too long: nothing was logged, or nothing that can be used."""
    out = []
    for i in gaps(series.time):
        lost = int(series.rows[i] - series.rows[i - 1]) - 1
        why = (
            f"{lost} rows of {series.label} hang, or have no value"
            if lost
            else f"a gap in the stamps of {series.label}"
        )
        out.append(LeftOut(run, float(series.time[i - 1]), float(series.time[i]), why))
    return out


def _span(
    run: str, series: Sequence[Series], begin: float, end: float, step: float, out: list[LeftOut]
) -> list[Span]:
    """The grid begins on a position's stamp, so that the shift of estimated velocities does not
    move the commands.
    """
    stamps = next(one.time for one in series if one.channel.field == "qpos")
    begin = float(next(iter(stamps[stamps >= begin - ON_GRID * step]), begin))
    count = int((end - begin) / step * (1 + 1e-12) + ON_GRID) + 1 if end > begin else 0
    at: Array = begin + step * np.arange(count, dtype=np.float64)
    if len(at) < SHORT:
        if end > begin:
            out.append(LeftOut(run, begin, end, f"shorter than {SHORT} control steps"))
        return []
    return [Span(at, frozenset(one.label for one in series if not _on_grid(one.time, at, step)))]


def _nearest(time: Array, at: Array) -> Ints:
    after = np.clip(np.searchsorted(time, at), 1, len(time) - 1)
    return after - (at - time[after - 1] < time[after] - at)


def _on_grid(time: Array, at: Array, step: float) -> bool:
    """Whether every instant of the grid is a stamp; a command's last row may be missing."""
    off = np.abs(time[_nearest(time, at)] - at)
    return bool(
        (off[:-1] < ON_GRID * step).all() and (off[-1] < ON_GRID * step or at[-1] > time[-1])
    )


def measured(series: Series, span: Span, joint: Joint | None) -> Array:
    """A position's or velocity's numbers (n, k) on the grid: as they are where they are on it, else
    by Akima splines and great arcs.
    """
    if series.label not in span.resampled:
        return series.values[_nearest(series.time, span.at)]
    at = np.clip(span.at, series.time[0], series.time[-1])
    values = resample(series.time, series.values, at)
    quaternion = (
        joint.quaternion() if joint is not None and series.channel.field == "qpos" else None
    )
    if quaternion is not None:
        values[:, quaternion] = resample_rotations(series.time, series.values[:, quaternion], at)
    return values


def commanded(series: Series, span: Span, step: float) -> Array:
    """A command's numbers (n, 1) on the grid: each row is held until the next, and averaged over
    the control step.
    """
    row = np.searchsorted(series.time, span.at + ON_GRID * step, side="right") - 1
    alone = bool((np.diff(row) == 1).all())  # one row in each control step
    if series.label not in span.resampled and alone:
        return series.values[row]
    return held_means(series.time, series.values, span.at, step)


def held_means(time: Array, values: Array, at: Array, step: float) -> Array:
    """(m, q) the means over each [at, at + step] of values (n, q) that are held from their stamps
    (n,) to the next, the last for good.
    """
    held = np.concatenate(
        [np.zeros((1, values.shape[1])), np.cumsum(values[:-1] * np.diff(time)[:, None], axis=0)]
    )

    def integral(instants: Array) -> Array:
        row = np.clip(np.searchsorted(time, instants, side="right") - 1, 0, None)
        return np.asarray(held[row] + values[row] * (instants - time[row])[:, None])

    return (integral(at + step) - integral(at)) / step


def observed(
    machine: ModelJoints,
    names: Sequence[str],
    positions: Sequence[Array],
    velocities: Sequence[Array],
) -> tuple[list[str], Array]:
    """The items of an observation and its rows: qpos, then qvel, of the named joints, in the
    model's order.
    """
    order = sorted(range(len(names)), key=lambda i: machine.joints[names[i]].qpos)
    rows = np.hstack([*(positions[i] for i in order), *(velocities[i] for i in order)])
    if len(names) == len(machine.joints):
        return ["qpos", "qvel"], rows
    items = [f"{field}.{names[i]}" for field in ("qpos", "qvel") for i in order]
    return items, rows
