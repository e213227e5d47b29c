"""How often broken files and failing disks broke a rule, in the long runs of `tests/faults`.

`python benchmarks/faults.py fuzz 2` runs 10,000 broken files with seed 2, and
`python benchmarks/faults.py operations 1` 500 failing file operations with seed 1; each keeps its
result in `faults.json` and writes the table into the README. `--output FILE` takes what such a run
printed before, on the day on which the file was written; without a run, the table alone is written.
"""

import argparse
import json
import re
import subprocess
import sys
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.readme import write_block
from dropo.core.services.files.atomic_write import write_json

HERE = Path(__file__).resolve().parent
KEPT = HERE / "faults.json"
SCRIPTS = HERE.parent / "tests" / "faults"
KINDS = {
    "fuzz": ("broken files", "cases", 10_000),
    "operations": ("failing file operations", "faults", 500),
}
"""By script: what it tries, the option for how many, and how many."""
COUNT = re.compile(r"of (\d+) cases broke a rule\.|^(\d+) faults in")
"""In the last line of a script that ran to its end."""


def result(what: str, seed: int, output: str, day: str) -> dict[str, Any]:
    """What a run printed: how many it tried, and a line for each that broke a rule."""
    *broken, last = output.splitlines()
    found = COUNT.search(last)
    if found is None:
        raise SystemExit(f"The run did not come to its end: {last}")
    count = int(found[1] or found[2])
    return {"what": what, "seed": seed, "count": count, "broken": broken, "date": day}


def table(found: list[dict[str, Any]]) -> str:
    """A Markdown table."""
    lines = ["| what | tried | seed | broke a rule | date |", "|---" * 5 + "|"]
    lines += [
        f"| {KINDS[row['what']][0]} | {row['count']:,} | {row['seed']} |"
        f" {len(row['broken'])} | {row['date']} |"
        for row in found
    ]
    return "\n".join(lines)


def write(found: list[dict[str, Any]]) -> None:
    """The table into the README between `<!-- faults -->` and `<!-- end -->`."""
    write_block("faults", table(found))


def main() -> None:
    """Run or take what is asked for, and write the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("what", nargs="?", choices=tuple(KINDS))
    parser.add_argument("seed", nargs="?", type=int, default=0)
    parser.add_argument("--output", type=Path, metavar="FILE")
    given = parser.parse_args()
    found = json.loads(KEPT.read_text()) if KEPT.exists() else []
    if given.what:
        now = datetime.now(UTC)
        if given.output:
            output = given.output.read_text()
            now = datetime.fromtimestamp(given.output.stat().st_mtime, UTC)
        else:
            _, option, count = KINDS[given.what]
            options = [f"--{option}", str(count), "--seed", str(given.seed)]
            command = [sys.executable, str(SCRIPTS / f"{given.what}.py"), *options]
            output = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=False).stdout
        new = result(given.what, given.seed, output, now.date().isoformat())
        found = [row for row in found if (row["what"], row["seed"]) != (given.what, given.seed)]
        found.append(new)
        write_json(KEPT, found)
    write(found)
    print(table(found))


if __name__ == "__main__":
    main()
