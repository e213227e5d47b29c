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
    """Counts and statistics of the data; it prints itself as a table.

    Attributes
    ----------
    transitions : int
        N, in all trajectories.
    lengths : tuple of int
        Transitions of each trajectory.
    groups : int or None
        Number of groups, where the data have such.
    duration : float or None
        Seconds from each trajectory's first row to its last, in all; None without time stamps.
    signals : dict
        For each observation and action column, by name: "min", "mean", "max" and "sd" in its unit,
        and "unit".
    """

    transitions: int
    lengths: tuple[int, ...]
    groups: int | None
    duration: float | None
    signals: dict[str, dict[str, Any]]

    def to_json(self) -> dict[str, Any]:
        """Give the same numbers for JSON.

        Returns
        -------
        dict
            By the names of its fields.
        """
        return {
            "transitions": self.transitions,
            "trajectories": len(self.lengths),
            "lengths": list(self.lengths),
            "groups": self.groups,
            "duration_s": self.duration,
            "signals": self.signals,
        }

    def parts(self) -> list[str | Table]:
        """Give the counts, and a table of the signals."""
        shortest = min(self.lengths)
        longest = max(self.lengths)
        lengths = f"{shortest}" if shortest == longest else f"{shortest} to {longest}"
        transitions = _count(self.transitions, "transition")
        trajectories = _count(len(self.lengths), "trajectory", "trajectories")
        counts = [f"{transitions} in {trajectories} of {lengths}"]
        if self.groups is not None:
            counts.append(_count(self.groups, "group"))
        if self.duration is not None:
            counts.append(f"{self.duration:.6g} s")
        shown = ("min", "mean", "max", "sd")
        rows = []
        for name, row in self.signals.items():
            rows.append((name, row["unit"], *(number(row[key]) for key in shown)))
        return [", ".join(counts), Table("", ("signal", "unit", *shown), tuple(rows))]


def _count(number: int, one: str, many: str = "") -> str:
    """A number with its noun in the singular or plural."""
    return f"{number} {one if number == 1 else many or one + 's'}"


def describe(
    trajectories: Trajectories,
    signals: Sequence[Signal] | None = None,
    controls: Sequence[Signal] | None = None,
) -> Description:
    """Describe data by counts, lengths, and the range, mean and deviation of every column.

    Parameters
    ----------
    trajectories : Trajectories
        The data, with p observation and q action columns.
    signals : sequence of Signal, optional
        Names and units of the p observation columns, see `columns`; by default "observation[0]"
        and so on.
    controls : sequence of Signal, optional
        Names and units of the q action columns, see the function `controls`; by default
        "action[0]" and so on.

    Returns
    -------
    Description

    Raises
    ------
    BadArgument
        If `signals` and `controls` are not p and q names.
    """
    p = trajectories.observations.shape[1]
    q = trajectories.actions.shape[1]
    named = [*(signals or _numbered("observation", p)), *(controls or _numbered("action", q))]
    rule = f"{p} and {q} columns"
    got = f"{len(named)} in all"
    require(len(named) == p + q, "signals, controls", rule, got, "describe")
    values = np.hstack([trajectories.observations, trajectories.actions])
    table = {}
    for signal, column in zip(named, values.T, strict=True):
        table[signal.name] = _statistics(column) | {"unit": signal.unit}
    groups = None if trajectories.group is None else int(trajectories.group.max()) + 1
    return Description(
        len(trajectories),
        tuple(stop - start for start, stop in trajectories.spans),
        groups,
        _duration(trajectories),
        table,
    )


def _statistics(column: Array) -> dict[str, Any]:
    """Range, mean and standard deviation of a column (N,)."""
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
    time = trajectories.time
    return float(sum(time[stop - 1] - time[start] for start, stop in trajectories.spans))


def columns(source: Problem | Simulator | None, count: int) -> list[Signal]:
    """Name the data's observation columns: by the model, else by the simulator's signals.

    Parameters
    ----------
    source : Problem, Simulator or None
        What the data are for.
    count : int
        How many columns there are.

    Returns
    -------
    list of Signal
        Names and units; numbered names where the source has another number of columns.
    """
    simulator = simulator_of(source)
    if isinstance(simulator, RobotSimulator) and len(simulator.layout) == count:
        return simulator.layout.column_signals
    if simulator is not None and len(simulator.signals) == count:
        return list(simulator.signals)
    return _numbered("observation", count)


def controls(source: Problem | Simulator | None, count: int) -> list[Signal]:
    """Name the data's action columns by the model's actuators, such as "ctrl.motor".

    Parameters
    ----------
    source : Problem, Simulator or None
        What the data are for.
    count : int
        How many columns there are.

    Returns
    -------
    list of Signal
        The names; numbered ones where the source has another number of columns.
    """
    simulator = simulator_of(source)
    if not isinstance(simulator, RobotSimulator) or len(simulator.controls) != count:
        return _numbered("action", count)
    return [Signal(f"ctrl.{name}") for name in simulator.action_names]


def _numbered(word: str, count: int) -> list[Signal]:
    """Names such as "action[0]"."""
    return [Signal(f"{word}[{i}]") for i in range(count)]


def simulator_of(source: Problem | Simulator | None) -> Simulator | None:
    """Take the simulator of a problem, or the simulator itself.

    Parameters
    ----------
    source : Problem, Simulator or None
        Where it comes from.

    Returns
    -------
    Simulator or None
    """
    return source.simulator if isinstance(source, Problem) else source
