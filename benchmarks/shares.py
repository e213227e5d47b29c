"""What the main job, `dropo fit hopper`, spends its processor time on.

`python benchmarks/shares.py` prints imports, bare simulation (inside of MuJoCo's `rollout`, and of
its `batch`, which makes the built-in data) and the rest, of one thread, and the most memory that
the process held.
"""

import json
import resource
import subprocess
import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.readme import numbers

RUN = """
import contextlib, io, json, resource, sys, time
import mujoco.batch, mujoco.rollout
spent = 0.0
def timed(bare):
    def run(*given, **named):
        global spent
        before = time.process_time()
        try:
            return bare(*given, **named)
        finally:
            spent += time.process_time() - before
    return run
mujoco.rollout.rollout = timed(mujoco.rollout.rollout)
mujoco.batch.Batch.step = timed(mujoco.batch.Batch.step)
from dropo.cli.main import main
output = io.StringIO()
with contextlib.redirect_stdout(output):
    status = main(sys.argv[1:])
assert status == 0, output.getvalue()
used = resource.getrusage(resource.RUSAGE_SELF)
print(json.dumps({
    "total": used.ru_utime + used.ru_stime,
    "simulation": spent,
    "memory": used.ru_maxrss / 1024,
    "steps": json.loads(output.getvalue())["simulator_steps"],
    "modules": [name for name in sys.modules if not name.startswith("__")],
}))
"""
IMPORT = """
import contextlib, importlib, json, resource, sys
for name in json.load(sys.stdin):
    with contextlib.suppress(Exception):
        importlib.import_module(name)
used = resource.getrusage(resource.RUSAGE_SELF)
print(used.ru_utime + used.ru_stime)
"""


def in_process(code: str, arguments: list[str], given: str = "") -> Any:
    """What a process of its own prints, read as JSON."""
    command = [sys.executable, "-c", code, *arguments]
    done = subprocess.run(command, input=given, capture_output=True, text=True, check=True)
    return json.loads(done.stdout)


def fit(arguments: list[str]) -> dict[str, Any]:
    """Seconds of processor time of a fit by part, its memory [MB], and its simulator steps."""
    command = ["fit", *arguments, "--threads", "1", "--quiet", "--json"]
    found: dict[str, Any] = in_process(RUN, command)
    found["imports"] = in_process(IMPORT, [], json.dumps(found.pop("modules")))
    found["rest"] = found["total"] - found["imports"] - found["simulation"]
    return found


def starting(arguments: list[str]) -> float:
    """Seconds of processor time of Python with these arguments, beside Python's own."""

    def spent(given: list[str]) -> float:
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        subprocess.run([sys.executable, *given], check=True, stdout=subprocess.DEVNULL)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime

    spent(arguments)  # compiles what is not yet compiled
    return spent(arguments) - spent(["-c", "pass"])


def report(arguments: list[str]) -> str:
    """The shares of a fit as a table."""
    found = fit(arguments)
    lines = [
        f"`dropo fit {' '.join(arguments)}`: {found['steps']:,} simulator steps on one thread,"
        f" at most {found['memory']:.0f} MB.",
        "",
        "| part | s of processor time | share |",
        "|---|---|---|",
    ]
    for part in ("imports", "simulation", "rest", "total"):
        share = found[part] / found["total"]
        lines.append(f"| {part} | {found[part]:.2f} | {100 * share:.0f}% |")
    imported = starting(["-c", "import dropo"])
    helped = starting(["-m", "dropo", "--help"])
    lines += ["", f"`import dropo` takes {imported:.2f} s, `dropo --help` {helped:.2f} s."]
    return "\n".join([*lines, numbers(found)])


if __name__ == "__main__":
    print(report(["hopper"]))
