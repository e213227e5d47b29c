"""Regenerate the page of the benchmarks, README.md, block by block.

python benchmarks/page.py               the blocks that `page.json` lacks, the quickest first
python benchmarks/page.py cost goals    these anew
python benchmarks/page.py --upto 10     of those that it lacks, the ones of up to 10 minutes
python benchmarks/page.py --kept cost   what cost.py has of its cells, without measuring any
python benchmarks/page.py --list        which there are, and when each was measured

Each block is what a script beside this one prints, kept in `page.json` and written into the page as
soon as it is measured, so that an interrupted run goes on where it was. The goals, which are read
from the other blocks, are written at the end of each run.
"""

import argparse
import os
import subprocess
import sys
import time
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks import goals
from benchmarks.readme import read_kept, write_block
from dropo.core.services.files.atomic_write import write_json

HERE = Path(__file__).resolve().parent
KEPT = HERE / "page.json"


@dataclass(frozen=True)
class Block:
    """A part of the page: the script that prints it, about how many minutes it takes on two free
    cores, and the options with which it prints what it has kept, if it keeps what it measures.
    """

    command: tuple[str, ...]
    minutes: float
    kept: tuple[str, ...] | None = None


BLOCKS = {
    "gpu": Block(("gpu.py", "rates", "published"), 8),
    "shares": Block(("shares.py",), 1),
    "meshes": Block(("meshes.py",), 2),
    "objective": Block(("objective.py",), 2),
    "walk": Block(("walk.py",), 3),
    "methods": Block(("methods.py",), 5),
    "tables": Block(("tables.py",), 5),
    "cost": Block(("cost.py",), 20, ("--upto", "0")),
    "diagnosis": Block(("diagnosis.py",), 30, ("--kept",)),
    "transitions": Block(("transitions.py",), 60, ("--upto", "0")),
    "faults": Block(("faults.py",), 1, ()),
}
"""By the name of its place in the page."""


def conditions() -> dict[str, Any]:
    """Where and when something is measured."""
    return {
        "date": datetime.now(UTC).date().isoformat(),
        "cores": os.cpu_count() or 1,
        "load": os.getloadavg()[0],
        "versions": {name: version(name) for name in ("dropo", "mujoco", "numpy")},
    }


def in_words(row: dict[str, Any]) -> str:
    """The conditions of a block, in a sentence."""
    if row["kept"]:
        return f"Printed on {row['date']} of what was measured by then."
    versions = ", ".join(f"{name} {number}" for name, number in row["versions"].items())
    waiting = row["load"] / row["cores"]
    busy = "free" if waiting < 1.2 else f"with {waiting:.0f} times more work than cores"
    cores = f"{row['cores']} cores, {busy}"
    return f"Measured on {row['date']}: {cores}, {versions}."


def measured(name: str, kept: bool = False) -> dict[str, Any]:
    """What the script of a block prints, and under which conditions; what it has kept, if asked."""
    script, *options = BLOCKS[name].command
    if kept:
        options += BLOCKS[name].kept or ()
    where = conditions()
    begun = time.perf_counter()
    command = [sys.executable, str(HERE / script), *options]
    done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True)
    spent = time.perf_counter() - begun
    return {**where, "kept": kept, "seconds": spent, "text": done.stdout.strip()}


def listed(found: dict[str, dict[str, Any]]) -> str:
    """A line for each block: its minutes, and when it was measured."""
    lines = []
    for name, block in BLOCKS.items():
        when = found[name]["date"] if name in found else "not measured"
        lines.append(f"{name:12} {block.minutes:3.0f} min  {when}")
    return "\n".join(lines)


def main() -> None:
    """Measure what is asked for, and write the page."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("blocks", nargs="*", metavar="BLOCK", help=", ".join((*BLOCKS, "goals")))
    parser.add_argument("--upto", type=float, default=float("inf"), metavar="MINUTES")
    parser.add_argument("--kept", action="store_true")
    parser.add_argument("--list", action="store_true")
    options = parser.parse_args()
    unknown = set(options.blocks) - {*BLOCKS, "goals"}
    if unknown:
        parser.error(f"no such block: {', '.join(sorted(unknown))}; there are {', '.join(BLOCKS)}")
    found = read_kept(KEPT)
    if options.list:
        print(listed(found))
        return
    missing = [name for name in BLOCKS if name not in found]
    wanted = [name for name in BLOCKS if name in options.blocks] if options.blocks else missing
    for name in sorted(wanted, key=lambda name: BLOCKS[name].minutes):
        block = BLOCKS[name]
        if block.kept is None if options.kept else block.minutes > options.upto:
            continue
        print(name, file=sys.stderr, flush=True)
        found[name] = measured(name, options.kept)
        write_json(KEPT, found)
        write_block(name, f"{found[name]['text']}\n\n{in_words(found[name])}")
    print(write_block("goals", goals.table({name: row["text"] for name, row in found.items()})))


if __name__ == "__main__":
    main()
