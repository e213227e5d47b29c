"""DROPO beside the published loop, least squares of mujoco.sysid and NPE of sbi, on the same data.

`python benchmarks/methods.py` prints a table: data set 0 of table 6.1 with noise, 1000 transitions
of the hopper, one thread, each method in a process of its own. The published loop is abridged, to
10 draws, 2000 evaluations and every tenth transition; what it takes unabridged is scaled from that,
since both are linear. Least squares are mujoco.sysid's optimizer, `mujoco.minimize`, with the same
simulations of single transitions as the others.
"""

import json
import resource
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.readme import numbers
from dropo.core.contracts.problem import Problem
from dropo.core.services.tables import number
from dropo.core.services.validation import Array
from dropo.estimators.dropo import DROPO
from dropo.estimators.npe import NPE
from dropo.studies.tiboni_2021.hopper_sets import MEAN, data_set

TRANSITIONS = 1000
DRAWS, EVALUATIONS, STRIDE = 10, 2000, 10  # of the published loop, abridged
WHOLE = (100 / DRAWS) * (5000 / EVALUATIONS) * STRIDE
"""How many times as much the published loop takes unabridged."""


def published(problem: Problem) -> tuple[Array, int]:
    """Means [kg] and steps of CMA-ES on Monte Carlo, abridged."""
    fewer = problem.using(transitions=len(problem.trajectories) // STRIDE)
    method = DROPO(
        likelihood="monte-carlo",
        optimizer="cma-es",
        draws=DRAWS,
        budget=EVALUATIONS,
        start="middle",
    )
    fit = method.fit(fewer, rng=0)
    return fit.mean, fit.simulator_steps


def least_squares(problem: Problem) -> tuple[Array, int]:
    """Means [kg] and steps of mujoco.sysid's least squares, from the middle of the box."""
    from mujoco import minimize

    simulator, segments, space = problem.simulator, problem.segments, problem.space
    targets = simulator.targets(segments)

    def residual(columns: Array) -> Array:
        predicted = simulator.predict(columns.T, segments)
        return np.asarray((predicted - targets).reshape(columns.shape[1], -1).T)

    middle = 0.5 * (space.low + space.high)[:, None]
    bounds = [space.low[:, None], space.high[:, None]]
    found, _ = minimize.least_squares(middle, residual, bounds, verbose=0)
    return np.asarray(found).ravel(), simulator.steps


def fitted(method: Any) -> Callable[[Problem], tuple[Array, int]]:
    """Means [kg] and steps of one of dropo's methods."""

    def run(problem: Problem) -> tuple[Array, int]:
        fit = method.fit(problem, rng=0)
        return fit.mean, fit.simulator_steps

    return run


METHODS: dict[str, Callable[[Problem], tuple[Array, int]]] = {
    "DROPO": fitted(DROPO()),
    "published loop, abridged": published,
    "least squares of mujoco.sysid": least_squares,
    "NPE of sbi": fitted(NPE(density="nsf")),
}


def measured(name: str, transitions: int = TRANSITIONS) -> dict[str, Any]:
    """One method, in this process: steps, processor time [s], error [kg], memory [MB]."""
    problem, _ = data_set("6.1", "noisy", 0, transitions)
    begun = time.process_time()
    with threadpool_limits(1):
        mean, steps = METHODS[name](problem)
    return {
        "steps": int(steps),
        "seconds": time.process_time() - begun,
        "error": float(np.sqrt(np.mean((mean - MEAN) ** 2))),
        "memory": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
    }


def table(found: dict[str, dict[str, Any]]) -> str:
    """A Markdown table, with a row for the published loop unabridged."""
    lines = [
        "| method | simulator steps | s of processor time | error, kg | memory, MB |",
        "|---" * 5 + "|",
    ]
    for name, row in found.items():
        lines.append(
            f"| {name} | {row['steps']:,} | {row['seconds']:,.1f} | {number(row['error'], 2)} | "
            f"{row['memory']:,.0f} |"
        )
        if name == "published loop, abridged":
            steps, seconds = WHOLE * row["steps"], WHOLE * row["seconds"]
            lines.append(f"| published loop, scaled up | {steps:,.0f} | {seconds:,.0f} | - | - |")
    return "\n".join(lines)


def main() -> None:
    """Print the table, each method in a process of its own."""
    if len(sys.argv) > 1:
        print(json.dumps(measured(sys.argv[1])))
        return
    found = {}
    for name in METHODS:
        print(name, file=sys.stderr, flush=True)
        command = [sys.executable, __file__, name]
        done = subprocess.run(command, check=True, capture_output=True, text=True)
        found[name] = json.loads(done.stdout.splitlines()[-1])
    print(table(found))
    print(numbers(found))


if __name__ == "__main__":
    main()
