"""Steps per second of MuJoCo Warp on a GPU, beside MuJoCo on all cores of the same machine.

`python benchmarks/gpu.py` writes the table into the README; "not measured" where Warp finds no GPU.
"""

import datetime as dt
import importlib.util
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.readme import numbers, write_block
from benchmarks.robots import humanoid_problem, quadruped_problem
from dropo.core.contracts.problem import Problem
from dropo.core.contracts.simulator import Simulator
from dropo.problems.loading import load

PROBLEMS: dict[str, Callable[[], Problem]] = {
    "hopper-noisy": lambda: load("hopper-noisy"),
    "half-cheetah": lambda: load("half-cheetah"),
    "quadruped, 12 joints": lambda: quadruped_problem(500, 0),
    "humanoid, 29 joints": lambda: humanoid_problem(500, 0),
}
WORLDS = (1_000, 10_000, 100_000)


def device() -> str | None:
    """The name of the GPU that Warp finds, if there is one."""
    if importlib.util.find_spec("mujoco_warp") is None:
        return None
    import warp as wp

    wp.config.log_level = wp.LOG_ERROR  # else its greeting is printed, too
    found = [device for device in wp.get_devices() if device.is_cuda]
    return str(found[0].name) if found else None


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


def table() -> str:
    """A Markdown table, with device and date."""
    gpu = device()
    lines = ["| problem | worlds | CPU, steps/s | GPU, steps/s |", "|---|---|---|---|"]
    fastest: dict[str, float] = {}
    for name, made in PROBLEMS.items():
        for worlds in WORLDS:
            cells = "not measured | not measured"
            if gpu is not None:
                problem = made()
                warp = problem.using(simulator="warp").simulator
                warp.worlds = worlds  # type: ignore[attr-defined]
                rates = [rate(one, problem, worlds) for one in (problem.simulator, warp)]
                cells = " | ".join(f"{one:,.0f}" for one in rates)
                fastest[name] = max(fastest.get(name, 0.0), rates[1])
            lines.append(f"| {name} | {worlds:,} | {cells} |")
    said = "No GPU was at hand." if gpu is None else f"{gpu}, {dt.date.today()}."
    return f"{said}\n\n" + "\n".join([*lines, numbers(fastest)])


def main() -> None:
    """The table, into the README between `<!-- gpu -->` and `<!-- end -->` too."""
    text = table()
    write_block("gpu", text)
    print(text)


if __name__ == "__main__":
    main()
