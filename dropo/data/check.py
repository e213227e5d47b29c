"""What is in the data, and what looks odd: gaps, dead channels, copies, actions that no actuator can follow."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from dropo.core.checks import Array, require
from dropo.core.data import Ints, Signal, Trajectories
from dropo.core.problem import Problem
from dropo.core.simulator import Simulator
from dropo.core.table import number, text_table

SHORT = 5
"""A trajectory of fewer transitions says little."""
UNIT, NOT_UNIT = 1e-3, 0.05
"""How far a quaternion's norm may be from 1: within rounding of a log file; beyond, it is none."""

Level = Literal["error", "warning", "information"]


@dataclass(frozen=True)
class Finding:
    """One thing that looks odd: an "error" makes the data useless, a "warning" may, "information" is only said."""

    level: Level
    signal: str
    sentence: str

    def __str__(self) -> str:
        return f"{self.level}: {self.signal}: {self.sentence}" if self.signal else f"{self.level}: {self.sentence}"


@dataclass(frozen=True)
class Description:
    """Numbers of the data: a table as text, and a dictionary."""

    transitions: int
    lengths: tuple[int, ...]
    groups: int | None
    duration: float | None
    signals: dict[str, dict[str, Any]]

    def to_json(self) -> dict[str, Any]:
        """The same numbers for JSON."""
        return {
            "transitions": self.transitions, "trajectories": len(self.lengths), "lengths": list(self.lengths), "groups": self.groups,
            "duration_s": self.duration, "signals": self.signals,
        }  # fmt: skip

    def __str__(self) -> str:
        shortest, longest = min(self.lengths), max(self.lengths)
        lengths = f"{shortest}" if shortest == longest else f"{shortest} to {longest}"
        first = f"{_count(self.transitions, 'transition')} in {_count(len(self.lengths), 'trajectory', 'trajectories')} of {lengths}"
        extra = [] if self.groups is None else [_count(self.groups, "group")]
        extra += [] if self.duration is None else [f"{self.duration:.6g} s"]
        rows = [[name, row["unit"], *(number(row[key]) for key in ("min", "mean", "max", "sd"))] for name, row in self.signals.items()]
        return ", ".join([first, *extra]) + "\n" + text_table(["signal", "unit", "min", "mean", "max", "sd"], rows)


def _count(number: int, one: str, many: str = "") -> str:
    return f"{number} {one if number == 1 else many or one + 's'}"


def describe(trajectories: Trajectories, signals: Sequence[Signal] | None = None, controls: Sequence[Signal] | None = None) -> Description:
    """Counts, lengths, and of every observation and action column the least, mean and largest value and the deviation.

    signals, controls: the columns' names and units (see `columns` and `controls`); by default "observation[0]" and so on.
    """
    p, q = trajectories.observations.shape[1], trajectories.actions.shape[1]
    named = [*(signals or _numbered("observation", p)), *(controls or _numbered("action", q))]
    require(len(named) == p + q, "signals, controls", f"{p} and {q} columns", f"{len(named)} in all", "describe")
    values = np.hstack([trajectories.observations, trajectories.actions])
    table = {signal.name: _statistics(column) | {"unit": signal.unit} for signal, column in zip(named, values.T, strict=True)}
    groups = None if trajectories.group is None else int(trajectories.group.max()) + 1
    return Description(len(trajectories), tuple(stop - start for start, stop in trajectories.spans), groups, _duration(trajectories), table)


def _statistics(column: Array) -> dict[str, Any]:
    return {"min": float(column.min()), "mean": float(column.mean()), "max": float(column.max()), "sd": float(column.std())}


def _duration(trajectories: Trajectories) -> float | None:
    """Seconds from each trajectory's first row to its last, in all."""
    if trajectories.time is None:
        return None
    return float(sum(trajectories.time[stop - 1] - trajectories.time[start] for start, stop in trajectories.spans))


def columns(source: Problem | Simulator | None, count: int) -> list[Signal]:
    """Names and units of the data's observation columns: the model's, else the simulator's signals, else numbered."""
    simulator = _simulator(source)
    layout = getattr(simulator, "layout", None)
    if layout is not None and len(layout) == count:
        units = [layout.model_units.get((column.field, column.place), "") for column in layout.columns]
        inside = {i for quaternion in layout.quaternions for i in quaternion}
        return [Signal(name, "" if i in inside else unit) for i, (name, unit) in enumerate(zip(layout.names, units, strict=True))]
    if simulator is not None and len(simulator.signals) == count:
        return list(simulator.signals)
    return _numbered("observation", count)


def controls(source: Problem | Simulator | None, count: int) -> list[Signal]:
    """Names of the data's action columns: the model's actuators ("ctrl.motor"), else numbered."""
    simulator = _simulator(source)
    model, places = getattr(simulator, "model", None), getattr(simulator, "controls", None)
    if model is None or places is None or len(places) != count:
        return _numbered("action", count)
    return [Signal(f"ctrl.{name}" if (name := model.actuator(int(i)).name) else f"ctrl[{i}]") for i in places]


def _numbered(word: str, count: int) -> list[Signal]:
    return [Signal(f"{word}[{i}]") for i in range(count)]


def _simulator(source: Problem | Simulator | None) -> Simulator | None:
    return source.simulator if isinstance(source, Problem) else source


def check(trajectories: Trajectories, source: Problem | Simulator | None = None) -> list[Finding]:
    """What looks odd in the data, given the problem or simulator that they are for (None: less can be checked); errors first."""
    simulator = _simulator(source)
    seen = columns(simulator, trajectories.observations.shape[1])
    moved = controls(simulator, trajectories.actions.shape[1])
    found = [
        *quaternion_norms(trajectories, simulator), *times(trajectories), *outside_control_range(trajectories, simulator),
        *_still(trajectories.observations, seen), *_still(trajectories.actions, moved), *_duplicates(trajectories),
        *_short(trajectories), *(shorter_than_lambda(source) if isinstance(source, Problem) else ()), *_gaps(trajectories, seen),
    ]  # fmt: skip
    order = ("error", "warning", "information")
    return sorted(found, key=lambda finding: order.index(finding.level))


def outside_control_range(trajectories: Trajectories, simulator: Simulator | None) -> Iterator[Finding]:
    """Actions that the model's actuators clip, so that the simulation does not apply what the data say."""
    for signal, (low, high), column in _ranges(trajectories, simulator):
        outside = (column < low) | (column > high)
        if outside.any():
            farthest = column[np.argmax(np.maximum(low - column, column - high))]
            count = f"{int(outside.sum())} of {len(column)} actions are outside the control range [{low:g}, {high:g}]"
            yield Finding("warning", signal.name, f"{count} and are clipped; the farthest is {farthest:.6g}.")


def _ranges(trajectories: Trajectories, simulator: Simulator | None) -> Iterator[tuple[Signal, Array, Array]]:
    """Each action column with a limited actuator, with its range."""
    model, places = getattr(simulator, "model", None), getattr(simulator, "controls", None)
    if model is None or places is None or len(places) != trajectories.actions.shape[1]:
        return
    for signal, place, column in zip(controls(simulator, len(places)), places, trajectories.actions.T, strict=True):
        if model.actuator_ctrllimited[place]:
            yield signal, model.actuator_ctrlrange[place], column


def quaternion_norms(trajectories: Trajectories, simulator: Simulator | None) -> Iterator[Finding]:
    """Quaternion columns that are not of unit length."""
    layout = getattr(simulator, "layout", None)
    if layout is None or len(layout) != trajectories.observations.shape[1]:
        return
    for quaternion in layout.quaternions:
        rows = np.vstack([trajectories.observations[:, quaternion], trajectories.next_observations[:, quaternion]])
        norms = np.linalg.norm(rows, axis=1)
        worst = float(norms[np.argmax(np.abs(norms - 1))])
        if abs(worst - 1) > UNIT:
            level: Level = "error" if abs(worst - 1) > NOT_UNIT else "warning"
            name = layout.names[quaternion[0]].rsplit("[", 1)[0]
            yield Finding(level, name, f"a quaternion must have length 1, and one has {worst:.6g}.")


def times(trajectories: Trajectories) -> Iterator[Finding]:
    """Rows that are not later than the row before them in their trajectory."""
    if trajectories.time is None:
        return
    steps, inside = np.diff(trajectories.time), ~trajectories.terminals[:-1]
    back = int((inside & (steps <= 0)).sum())
    if back:
        row = int(np.flatnonzero(inside & (steps <= 0))[0]) + 1
        yield Finding("error", "time", f"{back} rows are not later than the row before them, the first is row {row}.")


def _still(values: Array, signals: Sequence[Signal]) -> Iterator[Finding]:
    if len(values) > 1:
        for signal, column in zip(signals, values.T, strict=True):
            if (column == column[0]).all():
                yield Finding("warning", signal.name, f"it does not move: all {len(column)} rows are {column[0]:g}.")


def _duplicates(trajectories: Trajectories) -> Iterator[Finding]:
    everything = np.hstack([trajectories.observations, trajectories.actions, trajectories.next_observations])
    copies = len(everything) - len(np.unique(everything, axis=0))
    if copies:
        yield Finding("warning", "", f"{copies} of {len(everything)} transitions are exact copies of others.")


def _short(trajectories: Trajectories) -> Iterator[Finding]:
    lengths = [stop - start for start, stop in trajectories.spans]
    short = [i for i, length in enumerate(lengths) if length < SHORT]
    if short:
        named = ", ".join(map(str, short[:8])) + (", ..." if len(short) > 8 else "")
        yield Finding("warning", "", f"{len(short)} of {len(lengths)} trajectories have fewer than {SHORT} transitions: {named}.")


def shorter_than_lambda(problem: Problem) -> Iterator[Finding]:
    """Trajectories that hold no segment, so that a fit does not see them."""
    lengths = [stop - start for start, stop in problem.trajectories.spans]
    short = sum(length < problem.length for length in lengths)
    if short and problem.reset == "transition":
        yield Finding("warning", "", f"{short} of {len(lengths)} trajectories are shorter than lambda = {problem.length} and are left out.")


def _gaps(trajectories: Trajectories, signals: Sequence[Signal]) -> Iterator[Finding]:
    """Where the next observation is not the following row's observation: noise drawn twice, or rows left out."""
    rows: Ints = np.flatnonzero(~trajectories.terminals)
    if not len(rows):
        return
    differences: NDArray[np.float64] = trajectories.next_observations[rows] - trajectories.observations[rows + 1]
    for signal, column in zip(signals, differences.T, strict=True):
        rms = float(np.sqrt(np.mean(column**2)))
        if rms > 0:
            unit = f" {signal.unit}" if signal.unit else ""
            text = f"next_observations differ from the following observations by {rms:.4g}{unit} (rms): noise, or a gap."
            yield Finding("information", signal.name, text)
