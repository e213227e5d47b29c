"""What is in the data: counts, lengths, and the range of every signal, by name and unit."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from dropo.core.contracts.problem import Problem
from dropo.core.contracts.simulator import Simulator
from dropo.core.records.trajectories import Signal, Trajectories
from dropo.core.services.tables import Report, Table, number
from dropo.core.services.validation import Array, require
from dropo.mjmodel.robot_simulator import RobotSimulator


@dataclass(frozen=True, repr=False)
class Description(Report):
    """Numbers of the data: a table as text, and a dictionary."""

    transitions: int
    lengths: tuple[int, ...]
    groups: int | None
    duration: float | None
    signals: dict[str, dict[str, Any]]

    def to_json(self) -> dict[str, Any]:
        """The same numbers for JSON."""
        return {
            "transitions": self.transitions,
            "trajectories": len(self.lengths),
            "lengths": list(self.lengths),
            "groups": self.groups,
            "duration_s": self.duration,
            "signals": self.signals,
        }

    def parts(self) -> list[str | Table]:
        """Counts, and a table of the signals."""
        shortest = min(self.lengths)
        longest = max(self.lengths)
        lengths = f"{shortest}" if shortest == longest else f"{shortest} to {longest}"
        first = (
            f"{_count(self.transitions, 'transition')} in "
            f"{_count(len(self.lengths), 'trajectory', 'trajectories')} of {lengths}"
        )
        extra = [] if self.groups is None else [_count(self.groups, "group")]
        extra += [] if self.duration is None else [f"{self.duration:.6g} s"]
        shown = ("min", "mean", "max", "sd")
        rows = tuple(
            (name, row["unit"], *(number(row[key]) for key in shown))
            for name, row in self.signals.items()
        )
        return [", ".join([first, *extra]), Table("", ("signal", "unit", *shown), rows)]


def _count(number: int, one: str, many: str = "") -> str:
    return f"{number} {one if number == 1 else many or one + 's'}"


def describe(
    trajectories: Trajectories,
    signals: Sequence[Signal] | None = None,
    controls: Sequence[Signal] | None = None,
) -> Description:
    """Counts, lengths, and of every observation and action column the least, mean and largest value
    and the deviation.

    signals, controls: the columns' names and units (see `columns` and `controls`); by default
    "observation[0]" and so on.
    """
    p = trajectories.observations.shape[1]
    q = trajectories.actions.shape[1]
    named = [*(signals or _numbered("observation", p)), *(controls or _numbered("action", q))]
    require(
        len(named) == p + q,
        "signals, controls",
        f"{p} and {q} columns",
        f"{len(named)} in all",
        "describe",
    )
    values = np.hstack([trajectories.observations, trajectories.actions])
    table = {
        signal.name: _statistics(column) | {"unit": signal.unit}
        for signal, column in zip(named, values.T, strict=True)
    }
    groups = None if trajectories.group is None else int(trajectories.group.max()) + 1
    return Description(
        len(trajectories),
        tuple(stop - start for start, stop in trajectories.spans),
        groups,
        _duration(trajectories),
        table,
    )


def _statistics(column: Array) -> dict[str, Any]:
    return {
        "min": float(column.min()),
        "mean": float(column.mean()),
        "max": float(column.max()),
        "sd": float(column.std()),
    }


def _duration(trajectories: Trajectories) -> float | None:
    """Seconds from each trajectory's first row to its last, in all."""
    if trajectories.time is None:
        return None
    return float(
        sum(
            trajectories.time[stop - 1] - trajectories.time[start]
            for start, stop in trajectories.spans
        )
    )


def columns(source: Problem | Simulator | None, count: int) -> list[Signal]:
    """Names and units of the data's observation columns: the model's, else the simulator's signals,
    else numbered.
    """
    simulator = simulator_of(source)
    if isinstance(simulator, RobotSimulator) and len(simulator.layout) == count:
        return simulator.layout.column_signals
    if simulator is not None and len(simulator.signals) == count:
        return list(simulator.signals)
    return _numbered("observation", count)


def controls(source: Problem | Simulator | None, count: int) -> list[Signal]:
    """Names of the data's action columns: the model's actuators ("ctrl.motor"), else numbered."""
    simulator = simulator_of(source)
    if not isinstance(simulator, RobotSimulator) or len(simulator.controls) != count:
        return _numbered("action", count)
    return [Signal(f"ctrl.{name}") for name in simulator.action_names]


def _numbered(word: str, count: int) -> list[Signal]:
    return [Signal(f"{word}[{i}]") for i in range(count)]


def simulator_of(source: Problem | Simulator | None) -> Simulator | None:
    """The simulator of a problem, or itself."""
    return source.simulator if isinstance(source, Problem) else source
