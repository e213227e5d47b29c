"""What a fit costs against the number of transitions: memory, processor time, error.

`python benchmarks/transitions.py` measures what `transitions.json` lacks, on one thread, each cell
in a process of its own, and writes the table into the README; with `--upto N` the cells of up to N
transitions alone.
"""

import argparse
import json
import resource
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.readme import read_kept, write_block
from benchmarks.robots import block_problem, problem_of
from dropo.core.contracts.problem import Problem
from dropo.core.services.files.atomic_write import write_json
from dropo.estimators.dropo import DROPO

HERE = Path(__file__).resolve().parent
KEPT = HERE / "transitions.json"
CELLS = [("block", t) for t in (10_000, 100_000, 1_000_000)]
CELLS += [("hopper", t) for t in (10_000, 100_000, 1_000_000)]


def problem(what: str, transitions: int) -> Problem:
    """A block on a spring or the hopper, 4 parameters each."""
    if what == "block":
        return block_problem(transitions, 1)
    return problem_of(4, transitions, 1)


def peak() -> float:
    """The most memory that this process ever held [MB]."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def measured(what: str, transitions: int) -> dict[str, Any]:
    """One fit, with the memory that its data took before it began."""
    made = problem(what, transitions)
    before = peak()
    begun = time.process_time()
    fit = DROPO().fit(made, rng=0)
    truth = made.space.vector(made.truth or {})
    return {
        "steps": fit.simulator_steps,
        "seconds": time.process_time() - begun,
        "data_mb": before,
        "memory_mb": peak(),
        "status": fit.status.value,
        "error": float(np.max(np.abs(fit.mean - truth) / (made.space.high - made.space.low))),
        "z": float(np.max(np.abs((fit.mean - truth) / fit.mean_se))),
    }


def table(found: dict[str, dict[str, Any]]) -> str:
    """A Markdown table."""
    lines = [
        "| what | signals | transitions | steps | s of processor time | s a million transitions |"
        " memory before the fit, MB | at most, MB | largest error, % of the interval | largest z |",
        "|---" * 10 + "|",
    ]
    for what, transitions in CELLS:
        row = found.get(f"{what} {transitions}")
        signals = 2 if what == "block" else 11
        if row is None:
            lines.append(f"| {what} | {signals} | {transitions:,} |" + " not measured |" * 7)
            continue
        rate = 1e6 * row["seconds"] / transitions
        lines.append(
            f"| {what} | {signals} | {transitions:,} |"
            f" {row['steps']:,} | {row['seconds']:.0f} |"
            f" {rate:.0f} | {row['data_mb']:,.0f} | {row['memory_mb']:,.0f} |"
            f" {100 * row['error']:.2g} | {row['z']:.2g} |"
        )
    return "\n".join(lines)


def write(found: dict[str, dict[str, Any]]) -> None:
    """The table into the README between `<!-- transitions -->` and `<!-- end -->`."""
    write_block("transitions", table(found))


def main() -> None:
    """Measures the missing cells, each in a process of its own, and writes what there is."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--upto", type=int, default=10**9, metavar="N")
    parser.add_argument("--cell", nargs=2, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.cell:
        print(json.dumps(measured(options.cell[0], int(options.cell[1]))))
        return
    for what, transitions in CELLS:
        name = f"{what} {transitions}"
        found = read_kept(KEPT)
        if name in found or transitions > options.upto:
            continue
        print(name, file=sys.stderr, flush=True)
        command = [sys.executable, __file__, "--cell", what, str(transitions)]
        done = subprocess.run(command, check=True, capture_output=True, text=True)
        write_json(KEPT, {**found, name: json.loads(done.stdout)})
    found = json.loads(KEPT.read_text())
    write(found)
    print(table(found))


if __name__ == "__main__":
    main()
