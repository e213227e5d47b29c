"""Time stamps: rows that do not go on, gaps and jitter; and the rows that can be kept."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dropo.core.records.trajectories import Ints
from dropo.core.services.validation import Array
from dropo.data.checks.findings import Finding, Level


@dataclass(frozen=True)
class StampSettings:
    """What makes time stamps look odd.

    Attributes
    ----------
    gap : float
        A step of more than this many median steps is a gap: what happened in it is not known.
    jitter : float
        Steps that vary by more than this fraction of the median (rms) are reported.
    lost : float
        Fraction of missing rows from which on lost packets are a warning.
    many_lost : float
        Fraction of missing rows from which on lost packets are an error.
    uneven : float
        Values that are within so many usual steps of even ones have a rate of their own.
    backward : float
        Where more than this fraction of the rows runs backward, the stamps cannot be trusted.
    """

    gap: float = 5.0
    jitter: float = 0.2
    lost: float = 0.01
    many_lost: float = 0.2
    uneven: float = 1.5
    backward: float = 0.01


DEFAULTS = StampSettings()


def increasing(time: Array) -> NDArray[np.bool_]:
    """Mark the rows that are later than every row before them.

    Parameters
    ----------
    time : (n,) array
        Stamps [s] in the order of the log.

    Returns
    -------
    (n,) bool array
    """
    before = np.concatenate([[-np.inf], np.maximum.accumulate(time)[:-1]])
    return time > before


def find_gaps(time: Array, settings: StampSettings = DEFAULTS) -> Ints:
    """Find the rows before which there is a gap.

    Parameters
    ----------
    time : (n,) array
        Increasing stamps [s].
    settings : StampSettings, optional
        How long a gap is.

    Returns
    -------
    int array
        Places among the n rows.
    """
    steps = np.diff(time)
    if not len(steps):
        return np.empty(0, dtype=np.int64)
    return np.flatnonzero(steps > settings.gap * np.median(steps)) + 1


def check_stamps(
    name: str,
    time: Array,
    rows: Ints,
    run: str | None = None,
    settings: StampSettings = DEFAULTS,
) -> Iterator[Finding]:
    """Find what is wrong with time stamps.

    Parameters
    ----------
    name : str
        What messages call them.
    time : (n,) array
        Stamps [s] in the order of the log.
    rows : (n,) int array
        Their places in the log.
    run : str, optional
        The run, where there are several.
    settings : StampSettings, optional
        What counts as odd.

    Yields
    ------
    Finding
    """
    if len(time) < 2:
        return
    stamps = _Stamps(name, time, rows, run)
    keep = increasing(time)
    yield from _check_order(stamps, float(np.mean(~keep)), settings)
    yield from _check_steps(_Stamps(name, time[keep], rows[keep], run), settings)


def check_values(
    name: str,
    time: Array,
    rows: Ints,
    run: str | None = None,
    settings: StampSettings = DEFAULTS,
) -> Iterator[Finding]:
    """Find values that are missing in some rows, as where packets of one sensor were lost.

    Parameters
    ----------
    name, time, rows, run, settings
        As of `check_stamps`, of the rows that have a value.

    Yields
    ------
    Finding
        None where the values are a rate of their own.
    """
    if len(time) < 5:
        return
    typical = float(np.median(np.diff(time)))
    even = np.linspace(time[0], time[-1], len(time))
    if np.abs(time - even).max() > settings.uneven * typical:
        stamps = _Stamps(name, time, rows, run)
        yield from _check_lost(stamps, np.diff(time), typical, settings)


@dataclass(frozen=True, eq=False)
class _Stamps:
    """Stamps (n,) [s] with their places (n,) in the log."""

    name: str
    time: Array
    rows: Ints
    run: str | None

    def place(self, i: int) -> str:
        """Where the i-th stands."""
        return f"row {self.rows[i]} at {self.time[i]:.6g} s"

    def finding(self, level: Level, i: int, text: str, advice: str) -> Finding:
        """A finding at the i-th."""
        row = int(self.rows[i])
        return Finding(level, self.name, text, advice, self.run, row, float(self.time[i]))


def _check_order(stamps: _Stamps, lost: float, settings: StampSettings) -> Iterator[Finding]:
    """Stamps that are written twice or run backward; `lost` is the fraction of both."""
    steps = np.diff(stamps.time)
    same = np.flatnonzero(steps == 0) + 1
    back = np.flatnonzero(steps < 0) + 1
    if len(same):
        rows = "1 row has" if len(same) == 1 else f"{len(same)} rows have"
        text = f"{rows} the time stamp of the row before, the first is {stamps.place(same[0])}."
        advice = "An import drops them; see why the logger writes rows twice."
        yield stamps.finding("warning", same[0], text, advice)
    if len(back):
        first = back[0]
        times = "once" if len(back) == 1 else f"{len(back)} times"
        text = (
            f"time runs backward {times}, first to {stamps.place(first)}, from "
            f"{stamps.time[first - 1]:.6g} s."
        )
        if lost - len(same) / len(stamps.time) > settings.backward:
            advice = "Cut the log there, or map a clock that does not restart."
            yield stamps.finding("error", first, text, advice)
        else:
            advice = "An import drops rows that are not later than all before."
            yield stamps.finding("warning", first, text, advice)


def _check_steps(stamps: _Stamps, settings: StampSettings) -> Iterator[Finding]:
    """Gaps and jitter of increasing stamps."""
    steps = np.diff(stamps.time)
    if len(steps) < 3:
        return
    typical = float(np.median(steps))
    gaps = find_gaps(stamps.time, settings)
    if len(gaps):
        count = "1 gap" if len(gaps) == 1 else f"{len(gaps)} gaps"
        text = (
            f"{count} of more than {settings.gap:g} steps of {1e3 * typical:.4g} ms, the longest "
            f"{1e3 * steps.max():.4g} ms, the first before {stamps.place(gaps[0])}."
        )
        yield stamps.finding("warning", gaps[0], text, "An import ends a trajectory there.")
    yield from _check_lost(stamps, steps, typical, settings)
    even = steps <= settings.gap * typical
    jitter = float(np.sqrt(np.mean((steps[even] / typical - 1) ** 2)))
    if jitter > settings.jitter:
        worst = int(np.argmax(np.where(even, np.abs(steps - typical), 0))) + 1
        text = (
            f"steps vary by {100 * jitter:.0f} % (rms) around {1e3 * typical:.4g} ms; the "
            f"farthest is {1e3 * steps[worst - 1]:.4g} ms, before {stamps.place(worst)}."
        )
        advice = (
            "An import resamples; stamps of the sensor itself jitter less than those of the logger."
        )
        yield stamps.finding("information", worst, text, advice)


def _check_lost(
    stamps: _Stamps, steps: Array, typical: float, settings: StampSettings
) -> Iterator[Finding]:
    """Rows that are missing between others: steps of two, three and more usual ones."""
    whole = np.rint(steps / typical)
    is_whole = np.abs(steps / typical - whole) < 0.25 * np.sqrt(np.maximum(whole, 1))
    missing = np.where(is_whole & (steps <= settings.gap * typical), whole - 1, 0)
    # where steps scatter, long ones are jitter
    usual = np.abs(steps / typical - 1) < 0.25
    count = int(np.maximum(missing, 0).sum())
    lost = count / (count + len(steps))
    if lost < settings.lost or np.mean(usual | (missing > 0)) < 0.95:
        return
    first = int(np.argmax(missing > 0)) + 1
    level: Level = "error" if lost > settings.many_lost else "warning"
    text = (
        f"{count} rows are missing, {100 * lost:.2g} % of them: packets were lost, the first "
        f"before {stamps.place(first)}."
    )
    advice = "An import fills them by splines; find what loses them."
    if level == "error":
        advice = "Log again, or map a `rate` that the log has."
    yield stamps.finding(level, first, text, advice)
