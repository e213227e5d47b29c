"""Steps per second of MuJoCo Warp on a GPU, beside MuJoCo on all cores of the same machine.

`python benchmarks/gpu.py` writes the table into the README; "not measured" where Warp finds no GPU.
"""

import datetime as dt
import importlib.util
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.readme import write_block
from dropo.core.contracts.simulator import Simulator
from dropo.problems.loading import load

PROBLEMS = ("hopper-noisy", "half-cheetah")
WORLDS = (1_000, 10_000, 100_000)


def device() -> str | None:
    """The name of the GPU that Warp finds, if there is one."""
    if importlib.util.find_spec("mujoco_warp") is None:
        return None
    import warp as wp

    found = [device for device in wp.get_devices() if device.is_cuda]
    return str(found[0].name) if found else None


def rate(simulator: Simulator, name: str, worlds: int) -> float:
    """Physics steps per second of so many worlds, the second time that they are asked for."""
    problem = load(name)
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
    for name in PROBLEMS:
        for worlds in WORLDS:
            cells = "not measured | not measured"
            if gpu is not None:
                problem = load(name)
                warp = problem.using(simulator="warp").simulator
                warp.worlds = worlds  # type: ignore[attr-defined]
                rates = [rate(one, name, worlds) for one in (problem.simulator, warp)]
                cells = " | ".join(f"{one:,.0f}" for one in rates)
            lines.append(f"| {name} | {worlds:,} | {cells} |")
    said = "No GPU was at hand." if gpu is None else f"{gpu}, {dt.date.today()}."
    return f"{said}\n\n" + "\n".join(lines)


def main() -> None:
    """The table, into the README between `<!-- gpu -->` and `<!-- end -->`."""
    print(write_block("gpu", table()))


if __name__ == "__main__":
    main()
