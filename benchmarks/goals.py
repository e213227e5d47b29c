"""Goals of cost beside what the other blocks of the page measured, and why where one is not met."""

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.readme import numbers_in, read_kept

HERE = Path(__file__).resolve().parent
DURATIONS = HERE.parent / "tests" / "durations.json"
THIRD = {"hopper": 1.6e6 / 3, "half-cheetah": 1.1e6 / 3, "walker2d": 2.3e6 / 3}
"""Median steps of a diagnosis with one thing hidden: a third of what they were once."""


@dataclass(frozen=True)
class Row:
    """A goal, what was measured, whether that meets it (None: not measured), and what is to be
    said of it.
    """

    goal: str
    measured: str
    met: bool | None
    why: str = ""

    def __str__(self) -> str:
        said = {True: "met", False: "not met", None: "not measured"}[self.met]
        return f"| {self.goal} | {self.measured} | {said} | {self.why} |"


def main_job(found: Mapping[str, Any]) -> list[Row]:
    """`dropo fit hopper`, from shares.py."""
    goals = (
        "`dropo fit hopper`: 1.5 s on two free cores",
        "100,000 simulator steps",
        "60 % of its processor time in the simulation",
    )
    if not found:
        return [Row(goal, "-", None) for goal in goals]
    total, simulation = found["total"], found["simulation"]
    alone = total - simulation
    both = alone + simulation / 2
    share = simulation / total
    return [
        Row(
            goals[0],
            f"{total:.2f} s of processor time, {both:.2f} s with the simulation on two cores",
            both <= 1.5,
            "" if both <= 1.5 else f"imports take {found['imports']:.2f} s",
        ),
        Row(goals[1], f"{found['steps']:,}", found["steps"] <= 1e5),
        Row(
            goals[2],
            f"{share:.0%}",
            share >= 0.6,
            "" if share >= 0.6 else f"{found['imports'] / total:.0%} are imports",
        ),
    ]


def diagnoses(found: Mapping[str, Any]) -> list[Row]:
    """Diagnoses with one thing hidden, from diagnosis.py."""
    rows = []
    limits = {"hopper": 5.0, "half-cheetah": 30.0}
    for machine, limit in limits.items():
        goal = f"diagnosis of a {machine}: {limit:.0f} s"
        one = found.get(f"{machine}, one")
        if one is None:
            rows.append(Row(goal, "-", None))
            continue
        seconds, largest = one["seconds"], one["simulator"]
        why = "" if seconds <= limit else f"{largest:.0f} s of them inside of the simulator"
        rows.append(Row(goal, f"median {seconds:.0f} s of one core", seconds <= limit, why))
    for machine, limit in THIRD.items():
        goal = f"diagnosis of a {machine}: {limit:,.0f} steps"
        one = found.get(f"{machine}, one")
        if one is None:
            rows.append(Row(goal, "-", None))
            continue
        steps, stages = one["steps"], one["stages"]
        most = ", ".join(f"{name} {share:.0%}" for name, share in list(stages.items())[:4])
        why = "" if steps <= limit else f"most in {most}"
        rows.append(Row(goal, f"median {steps:,.0f}", steps <= limit, why))
    return rows


def many_transitions(kept: Mapping[str, Any], rounds: Mapping[str, Any]) -> list[Row]:
    """A million transitions, from transitions.json; time against their number from cost.json."""
    rows = []
    for what in ("block", "hopper"):
        for goal, key, limit, unit in (
            ("10 minutes", "seconds", 600.0, "s of one core"),
            ("2 GiB", "memory_mb", 2048.0, "MB"),
        ):
            name = f"a million transitions of the {what}, 4 parameters: {goal}"
            row = kept.get(f"{what} 1000000")
            if row is None:
                rows.append(Row(name, "-", None, _of_fewer(kept, what)))
                continue
            value = row[key]
            rows.append(Row(name, f"{value:,.0f} {unit}", value <= limit))
    rows.append(_linear(rounds))
    return rows


def _of_fewer(kept: Mapping[str, Any], what: str) -> str:
    """What 100,000 transitions took, where a million were not measured."""
    row = kept.get(f"{what} 100000")
    if row is None:
        return ""
    return (
        f"100,000 take {row['seconds']:,.0f} s of one core, {row['steps']:,} steps"
        f" and {row['memory_mb']:,.0f} MB"
    )


def _linear(rounds: Mapping[str, Any]) -> Row:
    """How time grows with the number of transitions."""
    goal = "time linear in the transitions: at most 12 times as much for 10 times as many"
    times = []
    for parameters in (4, 18, 100):
        sizes = (10_000, 100_000)
        cells = [rounds.get(json.dumps(["round", parameters, size, 2])) for size in sizes]
        few, many = cells
        if few is not None and many is not None:
            times.append((parameters, many["seconds"] / few["seconds"]))
    if not times:
        return Row(goal, "-", None)
    said = ", ".join(f"{ratio:.1f} ({parameters} parameters)" for parameters, ratio in times)
    return Row(goal, said, all(ratio <= 12 for _, ratio in times), "from 10,000 to 100,000")


def many_parameters(rounds: Mapping[str, Any]) -> list[Row]:
    """A hundred parameters, from cost.json."""
    goal = "100 parameters, 1000 transitions: 30 s"
    row = rounds.get(json.dumps(["fit", 100, 1000, 2]))
    if row is None:
        return [Row(goal, "-", None)]
    seconds, inside = row["seconds"], row["simulation"]
    why = f"{inside:.0f} s in the simulator, the rest in the maximisation of local models"
    return [Row(goal, f"{seconds:.0f} s", seconds <= 30, "" if seconds <= 30 else why)]


def on_a_gpu(found: Mapping[str, Any]) -> list[Row]:
    """The published method on a GPU, from gpu.py, and the backend's checks without one."""
    seconds = found.get("published", {}).get("noisy")
    goal = "the published method unabridged, 2e9 steps, on one GPU: 5 minutes"
    if seconds is None:
        rows = [Row(goal, "-", None, "no GPU was at hand")]
    else:
        rows = [Row(goal, f"{seconds / 60:.1f} min", seconds <= 300)]
    times = json.loads(DURATIONS.read_text())
    spent = sum(value for key, value in times.items() if "simulators/test_warp.py" in key)
    checks = "checks of the GPU's simulator on the CPU: 60 s"
    return [*rows, Row(checks, f"{spent:.0f} s of processor time", spent <= 60)]


def table(texts: Mapping[str, str]) -> str:
    """A Markdown table of all goals, from the texts of the other blocks."""
    found = {name: numbers_in(text) for name, text in texts.items()}

    rounds = read_kept(HERE / "cost.json")
    parts: tuple[Callable[[], list[Row]], ...] = (
        lambda: main_job(found.get("shares", {})),
        lambda: diagnoses(found.get("diagnosis", {})),
        lambda: many_transitions(read_kept(HERE / "transitions.json"), rounds),
        lambda: many_parameters(rounds),
        lambda: on_a_gpu(found.get("gpu", {})),
    )
    lines = ["| goal | measured | | |", "|---|---|---|---|"]
    lines += [str(row) for part in parts for row in part()]
    return "\n".join(lines)
