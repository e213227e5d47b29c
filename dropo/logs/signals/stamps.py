"""Time stamps: rows that do not go on, gaps and jitter; and the rows that can be kept."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from dropo.core.records.trajectories import Ints
from dropo.core.services.validation import Array
from dropo.data.checks.findings import Finding

GAP = 5.0
"""A step of more than so many median steps is a gap: what happened in it is not known."""
JITTER = 0.2
"""Steps that vary by more than this share of the median (rms) are worth a word."""
BACKWARD = 0.01
"""Where more than this share of the rows runs backward, the stamps cannot be trusted."""


def going_on(time: Array) -> NDArray[np.bool_]:
    """(n,) rows that are later than every row before them."""
    before = np.concatenate([[-np.inf], np.maximum.accumulate(time)[:-1]])
    return time > before


def gaps(time: Array) -> Ints:
    """The rows of increasing stamps before which there is a gap."""
    steps = np.diff(time)
    return (
        np.flatnonzero(steps > GAP * np.median(steps)) + 1
        if len(steps)
        else np.empty(0, dtype=np.int64)
    )


def check_stamps(name: str, time: Array, rows: Ints, run: str | None = None) -> Iterator[Finding]:
    """What is wrong with stamps (n,) [s] in the order of the log; rows: their places in it."""
    if len(time) < 2:
        return
    keep = going_on(time)
    steps = np.diff(time)
    same = np.flatnonzero(steps == 0) + 1
    back = np.flatnonzero(steps < 0) + 1
    if len(same):
        text = (
            f"{_rows(len(same))} the time stamp of the row before, the first is row "
            f"{rows[same[0]]} at {time[same[0]]:.6g} s."
        )
        yield Finding(
            "warning",
            name,
            text,
            "An import drops them; see why the logger writes rows twice.",
            run,
            *_place(rows, time, same[0]),
        )
    if len(back):
        lost = float(np.mean(~keep)) - len(same) / len(time)
        text = (
            f"time runs backward {_times(len(back))}, first to row {rows[back[0]]} at "
            f"{time[back[0]]:.6g} s, from "
            f"{time[back[0] - 1]:.6g} s."
        )
        if lost > BACKWARD:
            advice = "Cut the log there, or map a clock that does not restart."
            yield Finding("error", name, text, advice, run, *_place(rows, time, back[0]))
        else:
            yield Finding(
                "warning",
                name,
                text,
                "An import drops rows that are not later than all before.",
                run,
                *_place(rows, time, back[0]),
            )
    yield from _steps(name, time[keep], rows[keep], run)


def _steps(name: str, time: Array, rows: Ints, run: str | None) -> Iterator[Finding]:
    steps = np.diff(time)
    if len(steps) < 3:
        return
    typical = float(np.median(steps))
    cut = gaps(time)
    if len(cut):
        first = cut[0]
        text = (
            f"{len(cut)} {'gap' if len(cut) == 1 else 'gaps'} of more than {GAP:g} steps "
            f"of {1e3 * typical:.4g} ms, the longest "
            f"{1e3 * steps.max():.4g} ms, the first before row {rows[first]} at "
            f"{time[first]:.6g} s."
        )
        yield Finding(
            "warning",
            name,
            text,
            "An import ends a trajectory there.",
            run,
            *_place(rows, time, first),
        )
    inside = steps[steps <= GAP * typical]
    jitter = float(np.sqrt(np.mean((inside / typical - 1) ** 2)))
    if jitter > JITTER:
        worst = int(np.argmax(np.where(steps <= GAP * typical, np.abs(steps - typical), 0))) + 1
        text = (
            f"steps vary by {100 * jitter:.0f} % (rms) around {1e3 * typical:.4g} ms; the "
            f"farthest is {1e3 * steps[worst - 1]:.4g} ms, "
            f"before row {rows[worst]} at {time[worst]:.6g} s."
        )
        yield Finding(
            "information",
            name,
            text,
            (
                "An import resamples; stamps of the sensor itself jitter less than those of "
                "the logger."
            ),
            run,
            *_place(rows, time, worst),
        )


def _rows(count: int) -> str:
    return f"{count} row has" if count == 1 else f"{count} rows have"


def _times(count: int) -> str:
    return "once" if count == 1 else f"{count} times"


def _place(rows: Ints, time: Array, i: int) -> tuple[int, float]:
    return int(rows[i]), float(time[i])
