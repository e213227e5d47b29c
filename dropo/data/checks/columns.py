"""Checks of one column of numbers: stuck, clipped, coarsely quantised, still, or out of limits."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from dropo.core.numerics.lattice import lattice_step
from dropo.core.records.trajectories import Ints
from dropo.core.services.validation import Array
from dropo.data.checks.findings import Finding, Level


@dataclass(frozen=True)
class ColumnSettings:
    """What makes a column look odd.

    Attributes
    ----------
    stuck_rows : int
        Number of rows of one value, between as many rows that move much faster, from which a sensor
        hangs.
    release : float
        A joint that breaks loose from dry friction jumps by less than this many times the largest
        of the next steps: it did not hang.
    release_rows : int
        Number of those next steps.
    clipped_rows : int
        Number of rows at one end of a signal's range from which a sensor is at the end of its
        range.
    plateau_rows : int
        How many of these rows must follow each other.
    approach_rows : int
        Rows before such a plateau from which the speed is taken at which a signal runs into it.
    coarse_step : float
        A step of the numbers above this fraction of their spread shows in velocities.
    saturated : float
        Fraction of the rows in which a command may stand at its limit.
    soft_stop : float
        How far a joint's stop may give way, as a fraction of the joint's range.
    far_code : float
        How far outside the other numbers, in multiples of their range and size, a code of loggers
        must be for a mark of what was not measured.
    far : float
        How far outside the other numbers any number must be for such a mark.
    jumps : int
        How often what moves must jump to a number that is no code.
    largest : float
        Largest size of a number: beyond it MuJoCo takes a state for diverged (mjMAXVAL).
    """

    stuck_rows: int = 10
    release: float = 3.0
    release_rows: int = 3
    clipped_rows: int = 10
    plateau_rows: int = 3
    approach_rows: int = 30
    coarse_step: float = 1 / 300
    saturated: float = 0.05
    soft_stop: float = 0.25
    far_code: float = 3.0
    far: float = 10.0
    jumps: int = 3
    largest: float = 1e10


DEFAULTS = ColumnSettings()
NINES = (999.0, 9999.0, 99999.0, 999999.0, 999.9, 9999.9, 999.99, 999.25)
INTEGERS = tuple(float(2**bits - less) for bits in (15, 16, 31, 32) for less in (0, 1))
CODES = (*NINES, *INTEGERS)
"""What loggers write where nothing was measured, without its sign."""
OTHER_UNITS = (180 / math.pi, 1e3)
"""Factors from a unit of the data to one in which a log may have been: from rad, m or s."""
MOVING = ("m", "rad", "m/s", "rad/s")
"""Units of what moves without jumps."""
MOST_RUNS = 6
"""Runs and signals that a message lists."""
TAKE_OUT = "Take such rows out, and end the trajectory before them."


@dataclass(frozen=True, eq=False)
class Column:
    """The numbers of one signal in time.

    Attributes
    ----------
    name : str
        The signal.
    unit : str
        Its unit.
    time : (n,) array
        Stamps [s].
    values : (n,) array
        The numbers, in the unit.
    rows : (n,) int array
        Their places in the log or the data.
    sensor : bool
        Whether they are measured, so that plateaus are odd; else a command.
    limits : pair of float or None
        Of the joint or the actuator.
    breaks : int array
        Places among the n before which the record is cut.
    run : str or None
        The run of a log, where there are several.
    """

    name: str
    unit: str
    time: Array
    values: Array
    rows: Ints
    sensor: bool = True
    limits: tuple[float, float] | None = None
    breaks: Ints = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    run: str | None = None

    def format_value(self, value: float) -> str:
        """Write a number of the column with its unit.

        Parameters
        ----------
        value : float
            The number.

        Returns
        -------
        str
            With six digits.
        """
        return f"{value:.6g} {self.unit}".strip()

    def format_place(self, i: int) -> str:
        """Say where one of the numbers stands.

        Parameters
        ----------
        i : int
            Index of the number in the column.

        Returns
        -------
        str
            Its row and time [s].
        """
        return f"row {self.rows[i]} at {self.time[i]:.6g} s"

    def make_finding(self, level: Level, i: int, sentence: str, advice: str) -> Finding:
        """Make a finding whose place is the i-th number.

        Parameters
        ----------
        level : "error", "warning" or "information"
            How bad it is.
        i : int
            The place among the n numbers.
        sentence, advice : str
            What was found, and what to do.

        Returns
        -------
        Finding
        """
        row = int(self.rows[i])
        return Finding(level, self.name, sentence, advice, self.run, row, float(self.time[i]))


def check_column(column: Column, settings: ColumnSettings = DEFAULTS) -> Iterator[Finding]:
    """Find what is odd in one column.

    Parameters
    ----------
    column : Column
        The column.
    settings : ColumnSettings, optional
        What counts as odd.

    Yields
    ------
    Finding
    """
    if is_still(column):
        yield from describe_still([column])
        return
    yield from check_motion(column, settings)
    if column.sensor and is_coarse(column, settings):
        yield from describe_coarse([column])
    yield from check_limits(column, settings)


def check_motion(column: Column, settings: ColumnSettings = DEFAULTS) -> Iterator[Finding]:
    """Find where a sensor hangs or is cut off.

    Parameters
    ----------
    column : Column
        The column.
    settings : ColumnSettings, optional
        What counts as odd.

    Yields
    ------
    Finding
    """
    if column.sensor and len(column.values) > 1:
        yield from _check_hangs(column, settings)
        if not is_coarse(column, settings):  # whose ends hold many rows
            yield from _check_clipping(column, settings)


def is_still(column: Column) -> bool:
    """Tell whether all of several numbers are the same.

    Parameters
    ----------
    column : Column
        The numbers.

    Returns
    -------
    bool
        False for a single number.
    """
    return len(column.values) > 1 and bool((column.values == column.values[0]).all())


def describe_still(columns: Sequence[Column]) -> Iterator[Finding]:
    """Say that a signal does not move, in one line for all of its runs.

    Parameters
    ----------
    columns : sequence of Column
        One of each run in which it does not.

    Yields
    ------
    Finding
    """
    for column in columns[:1]:
        values = column.values
        if len(columns) == 1:
            text = f"it does not move: all {len(values)} rows are {values[0]:g}."
            yield Finding("warning", column.name, text, run=column.run)
            return
        runs = ", ".join(str(one.run) for one in columns[:MOST_RUNS])
        more = f" and {len(columns) - MOST_RUNS} more" if len(columns) > MOST_RUNS else ""
        text = f"it does not move in {len(columns)} runs: {runs}{more}."
        yield Finding("warning", column.name, text)


# Marks of loggers


def check_marks(column: Column, settings: ColumnSettings = DEFAULTS) -> Iterator[Finding]:
    """Find numbers that no sensor gives: marks for what was not measured.

    These are numbers beyond all bounds, codes of loggers far outside the other numbers, and the
    position or velocity of a joint that jumps to exactly the same far number again and again.

    Parameters
    ----------
    column : Column
        The column.
    settings : ColumnSettings, optional
        What counts as far.

    Yields
    ------
    Finding
    """
    values = column.values
    beyond = np.flatnonzero(np.abs(values) > settings.largest)
    if len(beyond):
        value = column.format_value(values[beyond[0]])
        text = (
            f"a number beyond {settings.largest:g} is no measurement; of {len(beyond)} the first "
            f"is {value} in {column.format_place(int(beyond[0]))}."
        )
        yield column.make_finding("error", int(beyond[0]), text, TAKE_OUT)
    for mark in _find_marks(column, settings):
        rows = np.flatnonzero(values == mark)
        others = values[(values != mark) & (np.abs(values) <= settings.largest)]
        low, high = (column.format_value(value) for value in (others.min(), others.max()))
        text = (
            f"{column.format_value(mark)} is far outside the other numbers, {low} to {high}: a "
            f"mark for what was not measured; of {len(rows)} the first is in "
            f"{column.format_place(int(rows[0]))}."
        )
        yield column.make_finding("error", int(rows[0]), text, TAKE_OUT)


def _find_marks(column: Column, settings: ColumnSettings) -> list[float]:
    """The least and the largest number, where they are marks."""
    values = column.values[np.abs(column.values) <= settings.largest]
    if not len(values):
        return []
    ends = {float(values.min()), float(values.max())}
    # Both may be marks, or one; the others are then all that is between.
    for some in (ends, *({end} for end in sorted(ends))):
        others = values[~np.isin(values, list(some))]
        if len(others) and all(_is_mark(column, end, others, settings) for end in some):
            return sorted(some)
    return []


def _is_mark(column: Column, end: float, others: Array, settings: ColumnSettings) -> bool:
    """Whether a number at an end of the range stands for what was not measured."""
    if column.limits is not None and end in column.limits:
        return False
    low, high = float(others.min()), float(others.max())
    gap = max(low - end, end - high)
    size = max(high - low, abs(low), abs(high))
    if _is_code(end) and (column.sensor or high > low):
        return gap > settings.far_code * size
    if column.unit not in MOVING or low == high or gap <= settings.far * size:
        return False
    # Nothing that moves goes there at once, again and again.
    there = column.values == end
    jumps = np.flatnonzero(np.diff(there.astype(int)) == 1) + 1
    return int(np.sum(~np.isin(jumps, column.breaks))) >= settings.jumps


def _is_code(value: float) -> bool:
    """Whether a number is a code of loggers, perhaps in another unit by now."""
    sizes = [abs(value) * factor for factor in (1.0, *OTHER_UNITS)]
    return any(math.isclose(size, code, rel_tol=1e-9) for size in sizes for code in CODES)


# Angles


def whole_turns(angles: Array) -> Ints:
    """Count the whole turns by which angles jump: an encoder that starts anew.

    Parameters
    ----------
    angles : (n,) array
        In rad.

    Returns
    -------
    (n - 1,) int array
        Turns from each row to the next.
    """
    steps = np.diff(angles)
    jumps = np.abs(np.abs(steps) - 2 * np.pi) < np.pi / 2
    return np.where(jumps, np.rint(steps / (2 * np.pi)), 0.0).astype(np.int64)


def unwrap(angles: Array) -> Array:
    """Let angles go on beyond a turn.

    Parameters
    ----------
    angles : (n,) array
        In rad.

    Returns
    -------
    (n,) array
        Without jumps by a whole turn.
    """
    return angles - 2 * np.pi * np.concatenate([[0], np.cumsum(whole_turns(angles))])


def check_turns(column: Column) -> Iterator[Finding]:
    """Find where an angle starts anew after a whole turn.

    Parameters
    ----------
    column : Column
        Angles in rad.

    Yields
    ------
    Finding
    """
    jumps = np.flatnonzero(whole_turns(column.values)) + 1
    if len(jumps):
        first = int(jumps[0])
        place = column.format_place(first)
        text = f"it starts anew after a whole turn {len(jumps)} times, the first at {place}."
        yield column.make_finding("information", first, text, "An import lets the angle go on.")


# Plateaus


def _find_plateaus(column: Column) -> tuple[Ints, Ints]:
    """First place, and the place behind the last one, of every stretch of equal values."""
    changes = np.flatnonzero(np.diff(column.values) != 0) + 1
    cuts = np.union1d(changes, column.breaks)
    bounds = np.concatenate([[0], cuts, [len(column.values)]]).astype(np.int64)
    return bounds[:-1], bounds[1:]


def find_hangs(column: Column, settings: ColumnSettings = DEFAULTS) -> list[tuple[int, int]]:
    """Find stretches in which a sensor hangs.

    It moves before, and then jumps by as much as it would have moved.

    Parameters
    ----------
    column : Column
        The column.
    settings : ColumnSettings, optional
        What counts as a hang.

    Returns
    -------
    list of pairs of int
        First place, and the place behind the last one, of each stretch.
    """
    values = column.values
    count = settings.stuck_rows
    starts, stops = _find_plateaus(column)
    broken = np.zeros(len(values) + 1, dtype=bool)
    broken[column.breaks] = True
    # long enough, with enough rows on both sides, and not at a break or an end of the range
    possible = stops - starts >= count
    possible &= (starts >= count) & (stops + count <= len(values))
    possible &= ~broken[starts] & ~broken[stops]
    possible &= (values[starts] > values.min()) & (values[starts] < values.max())
    found = []
    for start, stop in zip(starts[possible], stops[possible], strict=True):
        before = np.diff(values[start - count : start + 1])
        behind = np.diff(values[stop : stop + count])
        around = np.abs(np.concatenate([before, behind]))
        moving = around[around > 0]
        if len(moving) < count:
            continue
        jump = abs(values[stop] - values[start])
        # a joint that dry friction held begins with steps like the next ones
        next_steps = np.abs(behind[: settings.release_rows])
        breaks_loose = jump <= settings.release * next_steps.max(initial=0.0)
        if jump > max(3.0, (stop - start) / 10) * np.median(moving) and not breaks_loose:
            found.append((int(start), int(stop)))
    return found


def _check_hangs(column: Column, settings: ColumnSettings) -> Iterator[Finding]:
    """Stretches in which a sensor hangs."""
    found = find_hangs(column, settings)
    if found:
        start, stop = found[0]
        times = "once" if len(found) == 1 else f"{len(found)} times"
        value = column.format_value(column.values[start])
        text = (
            f"it hangs {times}, the first time for {stop - start} rows from "
            f"{column.format_place(start)}, at {value}, and jumps behind."
        )
        advice = "The sensor or its bus did not answer: an import leaves that span out."
        yield column.make_finding("warning", start, text, advice)


def _check_clipping(column: Column, settings: ColumnSettings) -> Iterator[Finding]:
    """Plateaus at an end of the range, into which the signal runs at speed."""
    values = column.values
    starts, stops = _find_plateaus(column)
    step = _smallest_step(values)
    # the signal must be recorded in the two rows before
    whole = (starts > 1) & ~np.isin(starts, column.breaks) & ~np.isin(starts - 1, column.breaks)
    for end, word in ((values.min(), "least"), (values.max(), "largest")):
        at_end = values[starts] == end
        held = whole & at_end & (stops - starts >= settings.plateau_rows)
        for i in np.flatnonzero(held):
            first = max(0, starts[i] - settings.approach_rows)
            enters = _runs_into_end(values[first : starts[i] + 1], step)
            # a joint that dry friction holds there leaves slowly
            behind = values[stops[i] - 1 : stops[i] + settings.approach_rows][::-1]
            held[i] = enters and len(behind) > 2 and _runs_into_end(behind, step)
        count = int((stops - starts)[at_end].sum())
        if count >= settings.clipped_rows and held.any():
            first = int(starts[np.flatnonzero(held)[0]])
            text = (
                f"it is cut off at its {word} value, {column.format_value(float(end))}: {count} "
                f"rows are exactly there, the first {column.format_place(first)}."
            )
            advice = "The sensor's range is too small, or something clips: leave those spans out."
            yield column.make_finding("warning", first, text, advice)


def _runs_into_end(before: Array, step: float) -> bool:
    """Whether a signal runs into its last value as fast as it went before, without coming to rest.

    `step` is that of a quantised signal.
    """
    steps = np.abs(np.diff(before))
    creeps = np.mean(steps < 0.1 * steps.max()) > 0.1  # as quantised numbers do near rest
    usual = float(np.sqrt(np.mean(steps**2)))
    return bool(not creeps and steps[-2:].max() > max(2.5 * step, 0.5 * usual))


# Quantisation


def _smallest_step(values: Array) -> float:
    """The smallest difference of neighbours, apart from rounding: that of a quantised signal."""
    steps = np.abs(np.diff(values))
    rounding = 1e-9 * float(np.ptp(values))
    return float(np.min(steps[steps > rounding], initial=np.inf))


def is_coarse(column: Column, settings: ColumnSettings = DEFAULTS) -> bool:
    """Whether the steps of a column's numbers are large beside what the signal moves.

    Parameters
    ----------
    column : Column
        The column.
    settings : ColumnSettings, optional
        What counts as large.

    Returns
    -------
    bool
    """
    if len(column.values) < 2:
        return False
    step = lattice_step(column.values)
    return step is not None and step > settings.coarse_step * _spread(column.values)


def _spread(values: Array) -> float:
    """The range of nearly all numbers."""
    return float(np.ptp(np.quantile(values, [0.05, 0.95])))


def describe_coarse(columns: Sequence[Column]) -> Iterator[Finding]:
    """Say in which steps columns move, in one line for all.

    Parameters
    ----------
    columns : sequence of Column
        Columns of one unit that `is_coarse`.

    Yields
    ------
    Finding
    """
    steps = [step for one in columns if (step := lattice_step(one.values)) is not None]
    if not steps:
        return
    column = columns[0]
    if len(columns) == 1:
        values = column.values
        spread = _spread(values)
        first = int(np.flatnonzero(np.diff(values))[0]) + 1
        percent = 100 * steps[0] / spread if spread else 100
        text = (
            f"it moves in steps of {column.format_value(steps[0])}, {percent:.2g} % of its spread, "
            f"the first at {column.format_place(first)}."
        )
        advice = (
            f"Its noise is at least {column.format_value(steps[0] / np.sqrt(12))}; log it with "
            "more digits where that is possible."
        )
        yield column.make_finding("warning", first, text, advice)
        return
    names = list(dict.fromkeys(one.name for one in columns))
    low, high = min(steps), max(steps)
    size = column.format_value(float(np.median(steps)))
    if high > 1.05 * low:
        size = f"{low:.6g} to {column.format_value(high)}"
    signal = ", ".join(names[:MOST_RUNS]) + (", ..." if len(names) > MOST_RUNS else "")
    text = f"the resolution of {len(names)} signals is {size}, coarse beside what they move."
    advice = f"Their noise is at least {column.format_value(low / np.sqrt(12))}."
    yield Finding("warning", signal, text, advice)


# Limits


def check_limits(column: Column, settings: ColumnSettings = DEFAULTS) -> Iterator[Finding]:
    """Find numbers outside the limits, and commands that stand at them.

    Parameters
    ----------
    column : Column
        The column.
    settings : ColumnSettings, optional
        What counts as odd.

    Yields
    ------
    Finding
    """
    if column.limits is None:
        return
    low, high = column.limits
    outside: NDArray[np.bool_] = (column.values < low) | (column.values > high)
    if outside.any():
        yield from _describe_excess(column, column.limits, int(outside.sum()), settings)
    elif not column.sensor:
        yield from _check_saturation(column, column.limits, settings)


def _describe_excess(
    column: Column, limits: tuple[float, float], count: int, settings: ColumnSettings
) -> Iterator[Finding]:
    """Numbers outside the limits; a joint's stop may give way a little."""
    low, high = limits
    values = column.values
    excess = np.maximum(low - values, values - high)
    worst = int(np.argmax(excess))
    farthest = f"{values[worst]:.6g}, {column.format_place(worst)}."
    if column.sensor:
        if excess[worst] < settings.soft_stop * (high - low):
            return
        what = "positions are outside the joint's range"
        ending = ", the farthest is"
        advice = "Check unit, sign and offset."
    else:
        what = "actions are outside the control range"
        ending = " and are clipped; the farthest is"
        advice = "Check the unit, or widen ctrlrange if the machine follows them."
    text = f"{count} of {len(values)} {what} [{low:g}, {high:g}]{ending} {farthest}"
    yield column.make_finding("warning", worst, text, advice)


def _check_saturation(
    column: Column, limits: tuple[float, float], settings: ColumnSettings
) -> Iterator[Finding]:
    """Commands that often stand at a limit."""
    low, high = limits
    at_limit = (column.values <= low) | (column.values >= high)
    if at_limit.mean() > settings.saturated:
        first = int(np.argmax(at_limit))
        text = (
            f"{int(at_limit.sum())} of {len(at_limit)} commands stand at a limit of "
            f"[{low:g}, {high:g}], the first {column.format_place(first)}."
        )
        advice = "The machine may have been asked for more: gains follow from the others."
        yield column.make_finding("information", first, text, advice)
