"""One column of numbers: stuck, clipped, coarsely quantised, still, or beyond its limits."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dropo.core.records.trajectories import Ints
from dropo.core.services.validation import Array
from dropo.data.checks.findings import Finding

STUCK = 10
"""Rows of one value, between rows that move much faster, for a sensor that hangs."""
CLIPPED = 10
PLATEAU = 3
"""Rows at one end of a signal's range, and in a row, for a sensor at the end of its range."""
APPROACH = 30
"""Rows before a plateau that tell how fast a signal runs into it."""
COARSE = 1 / 300
"""A step of the numbers beyond this share of their spread shows in velocities."""
SATURATED = 0.05
"""A command that stands at its limit for more than this share of the rows."""

SOFT = 0.25
"""How far a joint's stop may give way, as a share of its range."""


@dataclass(frozen=True, eq=False)
class Column:
    """Numbers (n,) of a signal in time [s]; rows: places in the log or data; breaks: rows before
    which the record is cut.

    sensor: measured, so that plateaus are odd; limits: of the joint or the actuator.
    """

    name: str
    unit: str
    time: Array
    values: Array
    rows: Ints
    sensor: bool = True
    limits: tuple[float, float] | None = None
    breaks: Ints | None = None
    run: str | None = None

    def shown(self, value: float) -> str:
        """A number of it with its unit."""
        return f"{value:.6g} {self.unit}".strip()

    def finding(self, level: str, i: int, sentence: str, advice: str) -> Finding:
        """A finding whose place is the i-th number."""
        return Finding(
            level, self.name, sentence, advice, self.run, int(self.rows[i]), float(self.time[i])
        )  # type: ignore[arg-type]

    def at(self, i: int) -> str:
        """The place in words."""
        return f"row {self.rows[i]} at {self.time[i]:.6g} s"


def check_column(column: Column) -> Iterator[Finding]:
    """What is odd in one column."""
    if len(column.values) < 2:
        return
    if (column.values == column.values[0]).all():
        text = f"it does not move: all {len(column.values)} rows are {column.values[0]:g}."
        yield Finding("warning", column.name, text, run=column.run)
        return
    if column.sensor:
        yield from _stuck(column)
        yield from _clipped(column)
        yield from _coarse(column)
    yield from beyond(column)


def turns(angles: Array) -> Ints:
    """(n - 1,) whole turns by which angles (n,) [rad] jump from row to row: an encoder that starts
    anew.
    """
    steps = np.diff(angles)
    return np.where(
        np.abs(np.abs(steps) - 2 * np.pi) < np.pi / 2, np.rint(steps / (2 * np.pi)), 0.0
    ).astype(np.int64)


def unwrapped(angles: Array) -> Array:
    """Angles (n,) [rad] that go on beyond a turn."""
    return angles - 2 * np.pi * np.concatenate([[0], np.cumsum(turns(angles))])


def check_turns(column: Column) -> Iterator[Finding]:
    """Where an angle starts anew after a whole turn."""
    jumps = np.flatnonzero(turns(column.values)) + 1
    if len(jumps):
        text = (
            f"it starts anew after a whole turn {len(jumps)} times, the first at "
            f"{column.at(int(jumps[0]))}."
        )
        yield column.finding("information", int(jumps[0]), text, "An import lets the angle go on.")


def _plateaus(column: Column) -> tuple[Ints, Ints]:
    """First and behind-the-last place of every stretch of equal values."""
    change = np.flatnonzero(np.diff(column.values) != 0) + 1
    cuts = np.union1d(change, column.breaks) if column.breaks is not None else change
    bounds = np.concatenate([[0], cuts, [len(column.values)]]).astype(np.int64)
    return bounds[:-1], bounds[1:]


def hangs(column: Column) -> list[tuple[int, int]]:
    """[start, stop) of stretches in which a sensor hangs: it moves before, and jumps behind by what
    it moved meanwhile.
    """
    values = column.values
    (starts, stops) = _plateaus(column)
    broken = np.zeros(len(values) + 1, dtype=bool)
    broken[[] if column.breaks is None else column.breaks] = True
    whole = (
        (stops - starts >= STUCK)
        & (starts >= STUCK)
        & (stops + STUCK <= len(values))
        & ~broken[starts]
        & ~broken[stops]
    )
    whole &= (values[starts] > values.min()) & (values[starts] < values.max())
    found = []
    for start, stop in zip(starts[whole], stops[whole], strict=True):
        around = np.abs(
            np.concatenate(
                [np.diff(values[start - STUCK : start + 1]), np.diff(values[stop : stop + STUCK])]
            )
        )
        moving = around[around > 0]
        if len(moving) >= STUCK and abs(values[stop] - values[start]) > max(
            3.0, (stop - start) / 10
        ) * np.median(moving):
            found.append((int(start), int(stop)))
    return found


def _stuck(column: Column) -> Iterator[Finding]:
    found = hangs(column)
    if found:
        start, stop = found[0]
        text = (
            f"it hangs {'once' if len(found) == 1 else f'{len(found)} times'}, the first "
            f"time for {stop - start} rows from "
            f"{column.at(start)}, at {column.shown(column.values[start])}, and jumps behind."
        )
        yield column.finding(
            "warning",
            start,
            text,
            "The sensor or its bus did not answer: an import leaves that span out.",
        )


def _clipped(column: Column) -> Iterator[Finding]:
    """Plateaus at an end of the range, into which the signal runs at speed."""
    values = column.values
    (starts, stops) = _plateaus(column)
    step = _step(values)
    cut = np.empty(0, dtype=np.int64) if column.breaks is None else column.breaks
    for end, word in ((values.min(), "least"), (values.max(), "largest")):
        held = (
            (values[starts] == end)
            & (stops - starts >= PLATEAU)
            & (starts > 1)
            & ~np.isin(starts, cut)
            & ~np.isin(starts - 1, cut)
        )
        held[held] = [
            _fast(values[max(0, start - APPROACH) : start + 1], step) for start in starts[held]
        ]
        count = int((stops - starts)[values[starts] == end].sum())
        if count >= CLIPPED and held.any():
            first = int(starts[np.flatnonzero(held)[0]])
            text = (
                f"it is cut off at its {word} value, {column.shown(float(end))}: {count} "
                "rows are exactly there, the first "
                f"{column.at(first)}."
            )
            yield column.finding(
                "warning",
                first,
                text,
                "The sensor's range is too small, or something clips: leave those spans out.",
            )


def _fast(before: Array, step: float) -> bool:
    """Whether a signal runs into its last value as fast as it moved before, rather than come to
    rest there.
    """
    steps = np.abs(np.diff(before))
    creeps = np.mean(steps < 0.1 * steps.max()) > 0.1  # as quantised numbers do near rest
    return bool(
        not creeps and steps[-2:].max() > max(2.5 * step, 0.5 * float(np.sqrt(np.mean(steps**2))))
    )


def _step(values: Array) -> float:
    """The least difference of neighbouring different values, apart from rounding: the step of a
    quantised signal.
    """
    steps = np.abs(np.diff(values))
    floor = 1e-9 * float(np.ptp(values))
    return float(np.min(steps[steps > floor], initial=np.inf))


def lattice(values: Array) -> float | None:
    """The step of numbers that all lie on a lattice, with several rows on each point; None where
    they do not.
    """
    points = np.unique(values)
    if len(points) < 3 or len(points) > len(values) / 2:
        return None
    steps = np.diff(points)
    step = float(np.min(steps[steps > 1e-9 * (points[-1] - points[0])], initial=np.inf))
    counts = steps / step
    return step if np.mean(np.abs(counts - np.rint(counts)) < 0.05) > 0.95 else None


def _coarse(column: Column) -> Iterator[Finding]:
    step = lattice(column.values)
    spread = float(np.ptp(np.quantile(column.values, [0.05, 0.95])))
    if step is not None and step > COARSE * spread:
        first = int(np.flatnonzero(np.diff(column.values))[0]) + 1
        text = (
            f"it moves in steps of {column.shown(step)}, "
            f"{100 * step / spread if spread else 100:.2g} % of its spread, the first at "
            f"{column.at(first)}."
        )
        advice = (
            f"Its noise is at least {column.shown(step / np.sqrt(12))}; log it with more "
            "digits where that is possible."
        )
        yield column.finding("warning", first, text, advice)


def beyond(column: Column) -> Iterator[Finding]:
    """Numbers outside the limits, and commands that stand at them."""
    if column.limits is None:
        return
    low, high = column.limits
    values = column.values
    outside: NDArray[np.bool_] = (values < low) | (values > high)
    if outside.any():
        excess = np.maximum(low - values, values - high)
        worst = int(np.argmax(excess))
        count = int(outside.sum())
        if column.sensor and excess[worst] < SOFT * (high - low):
            return
        what = (
            "positions are outside the joint's range"
            if column.sensor
            else "actions are outside the control range"
        )
        ending = ", the farthest is" if column.sensor else " and are clipped; the farthest is"
        text = (
            f"{count} of {len(values)} {what} [{low:g}, {high:g}]{ending} {values[worst]:.6g}, "
            f"{column.at(worst)}."
        )
        advice = (
            "Check unit, sign and offset."
            if column.sensor
            else "Check the unit, or widen ctrlrange if the machine follows them."
        )
        yield column.finding("warning", worst, text, advice)
    elif not column.sensor:
        at_limit = (values <= low) | (values >= high)
        if at_limit.mean() > SATURATED:
            first = int(np.argmax(at_limit))
            text = (
                f"{int(at_limit.sum())} of {len(values)} commands stand at a limit of "
                f"[{low:g}, {high:g}], the first {column.at(first)}."
            )
            yield column.finding(
                "information",
                first,
                text,
                "The machine may have been asked for more: gains are told by the others.",
            )
