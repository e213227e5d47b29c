"""Steps per second of MuJoCo Warp on a GPU, beside MuJoCo on all cores of the same machine, and the
published method unabridged on the GPU.

python benchmarks/gpu.py             the table in the README, from what `gpu.json` holds
python benchmarks/gpu.py rates       measures the steps per second before
python benchmarks/gpu.py published   measures the published method before

What is measured is kept in `gpu.json`, row by row. Without a GPU nothing is measured.
"""

import datetime as dt
import importlib.util
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.readme import numbers, read_kept, write_block
from benchmarks.robots import humanoid_problem, quadruped_problem
from dropo.core.contracts.problem import Problem
from dropo.core.contracts.simulator import Simulator
from dropo.core.services.files.atomic_write import write_json
from dropo.problems.loading import load
from dropo.studies.tiboni_2021.hopper_fits import AS_PUBLISHED, estimator, found
from dropo.studies.tiboni_2021.hopper_sets import FULL, THESIS, data_set

KEPT = Path(__file__).with_name("gpu.json")
PROBLEMS: dict[str, Callable[[], Problem]] = {
    "hopper-noisy": lambda: load("hopper-noisy"),
    "half-cheetah": lambda: load("half-cheetah"),
    "quadruped, 12 joints": lambda: quadruped_problem(500, 0),
    "humanoid, 29 joints": lambda: humanoid_problem(500, 0),
}
WORLDS = (1_000, 10_000, 100_000)
OF_A_FIT = ("evaluations", "steps", "seconds", "mean", "mean_se", "log_likelihood")
"""What is kept of the published method's fit."""


def device() -> str | None:
    """The name of the GPU that Warp finds, if there is one."""
    if importlib.util.find_spec("mujoco_warp") is None:
        return None
    import warp as wp

    wp.config.log_level = wp.LOG_ERROR  # else its greeting is printed, too
    there = [device for device in wp.get_devices() if device.is_cuda]
    return str(there[0].name) if there else None


def rate(simulator: Simulator, problem: Problem, worlds: int) -> float:
    """Physics steps per second of so many worlds, the second time that they are asked for."""
    segments = problem.segments.take(problem.segments.thin(min(worlds, 500)))
    draws = -(-worlds // len(segments))
    unit = np.random.default_rng(0).uniform(0.4, 0.6, (draws, len(problem.space)))
    values = problem.space.from_unit(unit)
    simulator.predict(values, segments)
    before = simulator.steps
    begun = time.perf_counter()
    simulator.predict(values, segments)
    return (simulator.steps - before) / (time.perf_counter() - begun)


def measure_rates() -> None:
    """Keep the steps per second of each problem with each number of worlds."""
    for name, made in PROBLEMS.items():
        problem = made()
        pair = (problem.simulator, problem.using(simulator="warp").simulator)
        for worlds in WORLDS:
            rates = [rate(simulator, problem, worlds) for simulator in pair]
            keep("rates", f"{name} | {worlds:,}", rates)


def measure_published(data: str = "noisy") -> None:
    """Keep what the published method finds in the first data set of table 6.1, all evaluations."""
    problem, drawn = data_set("6.1", data, 0)
    row = found(estimator(AS_PUBLISHED, FULL).fit(problem.using(simulator="warp"), rng=0))
    told = {name: row[name] for name in OF_A_FIT}
    keep("published", data, told | {"drawn": drawn[0].tolist()})


def keep(part: str, name: str, row: Any) -> None:
    """Add what was measured, with device and date, to the file."""
    kept = read_kept(KEPT)
    stamp = f"{device()}, {dt.date.today()}"
    kept.setdefault(part, {})[name] = {"where": stamp, "found": row}
    write_json(KEPT, kept)


def table() -> str:
    """Markdown tables of what the file holds, with devices and dates."""
    kept = read_kept(KEPT)
    rates = kept.get("rates", {})
    places = sorted({row["where"] for part in kept.values() for row in part.values()})
    said = "; ".join(places) if places else "No GPU was at hand"
    lines = [f"{said}.", "", "| problem | worlds | CPU, steps/s | GPU, steps/s |"]
    lines.append("|---|---|---|---|")
    for name in PROBLEMS:
        for worlds in WORLDS:
            key = f"{name} | {worlds:,}"
            cells = "not measured | not measured"
            if key in rates:
                cells = " | ".join(f"{one:,.0f}" for one in rates[key]["found"])
            lines.append(f"| {key} | {cells} |")
    lines += ["", *published_table(kept.get("published", {}))]
    seconds = {name: row["found"]["seconds"] for name, row in kept.get("published", {}).items()}
    return "\n".join([*lines, numbers({"published": seconds})])


def published_table(rows: dict[str, Any]) -> list[str]:
    """Lines of a Markdown table: the published method on table 6.1, beside the thesis' own."""
    lines = [
        "| table 6.1, published method | evaluations | steps | s | steps/s | masses [kg] |"
        " drawn [kg] | thesis [kg] |",
        "|---|---|---|---|---|---|---|---|",
    ]
    if not rows:
        lines.append("| noisy | not measured | | | | | | |")
    for data, row in rows.items():
        one = row["found"]
        printed, _ = THESIS["6.1", data, "dropo"]
        masses = [
            ", ".join(f"{mass:.3f}" for mass in given)
            for given in (one["mean"], one["drawn"], printed)
        ]
        counts = f"{one['evaluations']:,} | {one['steps']:.3g} | {one['seconds']:.0f}"
        counts += f" | {one['steps'] / one['seconds']:,.0f}"
        lines.append(f"| {data} | {counts} | {' | '.join(masses)} |")
    return lines


def main() -> None:
    """What is asked for, then the table, into the README between `<!-- gpu -->` too."""
    measures = {"rates": measure_rates, "published": measure_published}
    for part in sys.argv[1:]:
        if device() is None:
            print("Warp finds no GPU: nothing is measured.", file=sys.stderr)
            break
        measures[part]()
    text = table()
    write_block("gpu", text)
    print(text)


if __name__ == "__main__":
    main()
