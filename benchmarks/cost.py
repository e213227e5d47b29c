"""What a fit costs, against the number of parameters, of transitions and of threads: simulation,
fitting aside, memory.

python benchmarks/cost.py               measures what `cost.json` lacks; then the table in the
README and `cost.svg` python benchmarks/cost.py --upto 1000   the cells of up to so many transitions
alone; the others stay as they were
"""

import argparse
import json
import resource
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.readme import read_kept, write_block
from benchmarks.robots import problem_of
from dropo.core.contracts.problem import Problem
from dropo.core.contracts.simulator import Simulator
from dropo.core.contracts.support.fisher_scoring import maximize_locally
from dropo.core.services.files.atomic_write import write_json, write_text
from dropo.core.services.tables import number
from dropo.estimators.dropo import DROPO
from dropo.families.truncated_gaussian import TruncatedGaussian
from dropo.likelihoods.emulated import Emulated
from dropo.likelihoods.linear import Linear

HERE = Path(__file__).resolve().parent
PARAMETERS = (4, 18, 100)
TRANSITIONS = (1000, 10_000, 100_000)
THREADS = (1, 2)
Cell = tuple[str, int, int, int]
"""("round" or "fit", parameters, transitions, threads)"""
CELLS: list[Cell] = [("fit", d, TRANSITIONS[0], 2) for d in PARAMETERS]
CELLS += [
    ("round", d, t, threads)
    for d in PARAMETERS
    for t in TRANSITIONS
    for threads in THREADS
    if d * t < 1e7
    and (
        threads > 1 or t < TRANSITIONS[-1]
    )  # the largest are left out, or measured on all threads alone
]
# a round begins 2 % beside the truth, as wide as that
OFF = 0.02
WIDTH = 0.02


def likelihood_of(parameters: int) -> tuple[str, Any]:
    """The emulated likelihood for few parameters, the linear one for many."""
    return ("emulated", Emulated()) if parameters <= 4 else ("linear", Linear())


def one_round(problem: Problem) -> dict[str, Any]:
    """The local likelihood of all transitions around a point beside the truth, and its maximum:
    what a fit does again and again.
    """
    family = TruncatedGaussian(problem.space)
    truth = problem.space.vector(problem.truth or {})
    signs = np.where(np.arange(len(truth)) % 2, 1.0, -1.0)
    centre = truth * (1 + OFF * signs)
    width = WIDTH * truth
    assert problem.epsilon is not None
    _, likelihood = likelihood_of(len(truth))
    local = likelihood.linearize_at(
        problem.simulator,
        problem.segments,
        family,
        problem.epsilon,
        centre,
        width,
        np.random.default_rng(0),
    )
    found = maximize_locally(
        local, np.clip(family.phi(centre, 0.05 * width), local.unknowns.low, local.unknowns.high)
    )
    return {"log_likelihood": found.value}


def whole_fit(problem: Problem) -> dict[str, Any]:
    """A fit from the middle of the box."""
    name, _ = likelihood_of(len(problem.space))
    fit = DROPO(likelihood=name).fit(problem, rng=0)
    truth = problem.space.vector(problem.truth or {})
    return {
        "log_likelihood": fit.log_likelihood,
        "largest_z": float(np.nanmax(np.abs((fit.mean - truth) / fit.mean_se))),
    }


def measured(cell: Cell) -> dict[str, Any]:
    """One cell, in this process: seconds in all and in the simulator, steps, and the most memory
    that the process ever held.
    """
    what, parameters, transitions, threads = cell
    problem = problem_of(parameters, transitions, threads)
    simulator = problem.simulator
    seconds = [0.0]
    before = simulator.steps
    begun = time.perf_counter()
    with threadpool_limits(threads, user_api="blas"), timed_predictions(simulator, seconds):
        found = (one_round if what == "round" else whole_fit)(problem)
    total = time.perf_counter() - begun
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return {
        **found,
        "seconds": total,
        "simulation": seconds[0],
        "steps": simulator.steps - before,
        "memory_mb": memory,
    }


@contextmanager
def timed_predictions(simulator: Simulator, seconds: list[float]) -> Iterator[None]:
    """The time of all predictions added up, those of the simulator's copies too."""
    kind = type(simulator)
    predict = kind._predict

    def run(*arguments: Any) -> Any:
        begun = time.perf_counter()
        try:
            return predict(*arguments)
        finally:
            seconds[0] += time.perf_counter() - begun

    kind._predict = run  # type: ignore[method-assign]
    try:
        yield
    finally:
        kind._predict = predict  # type: ignore[method-assign]


def table(found: dict[str, dict[str, Any]]) -> str:
    """A Markdown table."""
    head = (
        "| what | parameters | transitions | threads | steps | s | simulation, s | fitting, "
        "share | memory, MB | largest z |"
    )
    lines = [head, "|---" * 10 + "|"]
    for cell in CELLS:
        row = found.get(json.dumps(cell))
        if row:
            what, d, t, threads = cell
            share = 1 - row["simulation"] / row["seconds"]
            numbers = (
                f"{row['steps']:,} | {row['seconds']:.1f} | {row['simulation']:.1f} | "
                f"{share:.0%} | {row['memory_mb']:,.0f}"
            )
            lines.append(
                f"| {what}, {likelihood_of(d)[0]} | {d} | {t:,} | {threads} | {numbers} | "
                f"{number(row.get('largest_z', np.nan), 2)} |"
            )
    return "\n".join(lines)


def draw(figure: Any, found: dict[str, dict[str, Any]]) -> None:
    """Seconds and memory of a round against transitions, and seconds against parameters, a line for
    each number of the other and of threads; and how many times as fast all threads are.
    """
    figure.set_size_inches(8, 6.4)
    by_size, memory, by_number, faster = figure.subplots(2, 2).ravel()
    colors = ("tab:blue", "tab:orange", "tab:green")
    for d, color in zip(PARAMETERS, colors, strict=True):
        for threads, style in zip(THREADS, ("o--", "o-"), strict=True):
            rows = rounds(found, [(d, t) for t in TRANSITIONS], threads)
            at = [t for (_, t), _ in rows]
            label = f"{d} parameters, {threads} thread{'s' * (threads > 1)}"
            seconds = [row["seconds"] for _, row in rows]
            by_size.plot(at, seconds, style, color=color, label=label)
            memory.plot(at, [row["memory_mb"] for _, row in rows], style, color=color)
        few, many = (dict(rounds(found, [(d, t) for t in TRANSITIONS], n)) for n in THREADS)
        both = [cell for cell in few if cell in many]
        times = [few[cell]["seconds"] / many[cell]["seconds"] for cell in both]
        faster.plot([t for _, t in both], times, "o-", color=color)
    for t, color in zip(TRANSITIONS, colors, strict=True):
        rows = rounds(found, [(d, t) for d in PARAMETERS], THREADS[-1])
        at = [d for (d, _), _ in rows]
        seconds = [row["seconds"] for _, row in rows]
        by_number.plot(at, seconds, "o-", color=color, label=f"{t:,} transitions")
    by_size.set(xscale="log", yscale="log", xlabel="transitions", title="a round [s]")
    memory.set(xscale="log", yscale="log", xlabel="transitions", title="peak memory [MB]")
    title = f"a round [s], {THREADS[-1]} threads"
    by_number.set(xscale="log", yscale="log", xlabel="parameters", title=title)
    title = f"times as fast with {THREADS[-1]} threads"
    faster.set(xscale="log", xlabel="transitions", title=title)
    by_size.legend(fontsize=6)
    by_number.legend(fontsize=6)


def rounds(
    found: dict[str, dict[str, Any]], sizes: list[tuple[int, int]], threads: int
) -> list[tuple[tuple[int, int], dict[str, Any]]]:
    """The rounds of some numbers of parameters and transitions that were measured."""
    keys = [(size, json.dumps(("round", *size, threads))) for size in sizes]
    return [(size, found[key]) for size, key in keys if key in found]


def write(found: dict[str, dict[str, Any]]) -> None:
    """The table into the README between `<!-- cost -->` and `<!-- end -->`, and the picture."""
    from dropo.studies.engine.pages import picture

    write_block("cost", table(found))
    write_text(HERE / "cost.svg", picture(lambda figure: draw(figure, found)))


def main() -> None:
    """Measures the missing cells, each in a process of its own, and writes what there is."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--upto",
        type=int,
        default=max(TRANSITIONS),
        metavar="N",
        help="cells of up to N transitions alone",
    )
    parser.add_argument("--cell", type=json.loads, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.cell:
        print(json.dumps(measured(tuple(options.cell))))
        return
    kept = HERE / "cost.json"
    found = read_kept(kept)
    for cell in CELLS:
        key = json.dumps(cell)
        if key in found or cell[2] > options.upto:
            continue
        print(key, file=sys.stderr, flush=True)
        answer = subprocess.run(
            [sys.executable, __file__, "--cell", key], check=True, capture_output=True, text=True
        ).stdout
        found[key] = json.loads(answer)
        write_json(kept, found)
    write(found)
    print(table(found))


if __name__ == "__main__":
    main()
