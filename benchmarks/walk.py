"""What the road from a robot and its log to a page takes: seconds by the clock and of processor.

`python benchmarks/walk.py [arm] [so101] [go2] [--whole]` types the commands in a folder that is
thrown away: `dropo init`, `data check`, `diagnose --quick` (with --whole without it), `report` and
`export`. `arm` is the example of docs/start.md with its three logs; the others are read from
the folder that DROPO_DATA names. No file is edited.
"""

import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from dropo.problems.simulated.example_log import ExampleMachine, write_example

MACHINES = ("arm", "so101", "go2")
LONGEST = 60.0  # s of a measured machine's log


def write_machine(machine: str, folder: Path, rows: int = ExampleMachine.rows) -> list[str]:
    """Write a machine's model and logs; give the arguments of `dropo init`."""
    if machine == "arm":
        write_example(folder, machine=ExampleMachine(rows=rows))
        return ["arm.xml", "log1.csv", "log2.csv", "log3.csv"]
    place = Path(os.environ["DROPO_DATA"]) / machine
    runs = np.load(place / "runs.npz", allow_pickle=False)
    (folder / "robot.xml").write_bytes((place / "model.xml").read_bytes())
    return ["robot.xml", *write_runs(runs, folder)]


def write_runs(runs: "np.lib.npyio.NpzFile", folder: Path) -> list[str]:
    """Write each run as a CSV file of stamps, angles and commands, up to `LONGEST` in all."""
    names = json.loads(str(runs["meta"]))["joints"]
    written: list[str] = []
    seconds = 0.0
    for key in sorted({one.split("/")[0] for one in runs.files if "/" in one}):
        stamps = runs[f"{key}/time"]
        if seconds > LONGEST:
            break
        seconds += float(stamps[-1] - stamps[0])
        measured = runs[f"{key}/qpos_measured"]
        told = runs[f"{key}/ctrl"]
        header = ["time", *(f"{n} pos" for n in names), *(f"{n} cmd" for n in names)]
        table = np.column_stack([stamps - stamps[0], measured, told])
        file = f"run{key}.csv"
        np.savetxt(
            folder / file, table, fmt="%.6f", delimiter=",", header=",".join(header), comments=""
        )
        written.append(file)
    return written


def steps_of(machine: str, robot: Sequence[str], whole: bool) -> dict[str, list[str]]:
    """The commands of the walk, by what they are called in the table."""
    quick = [] if whole else ["--quick"]
    return {
        "init": ["init", *robot, "--out", machine],
        "data check": ["data", "check", f"{machine}/problem.yaml"],
        "diagnose": ["diagnose", f"{machine}/problem.yaml", *quick, "--out", "found"],
        "report": ["report", "found"],
        "export": ["export", "found", "--to", "mujoco"],
    }


def timed(command: Sequence[str], folder: Path) -> tuple[float, float]:
    """Seconds by the clock and of processor that a command takes.

    Raises
    ------
    RuntimeError
        If it fails, with what it said.
    """
    begun = time.perf_counter()
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    whole = [sys.executable, "-m", "dropo", *command, "--quiet"]
    done = subprocess.run(whole, cwd=folder, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise RuntimeError(f"dropo {' '.join(command)}: {done.stderr.strip()}")
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    own = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return time.perf_counter() - begun, own


def walk(machine: str, folder: Path, whole: bool = False, rows: int = ExampleMachine.rows) -> float:
    """Walk with a machine, print a row for each command, and give the seconds by the clock."""
    robot = write_machine(machine, folder, rows)
    total = np.zeros(2)
    for name, command in steps_of(machine, robot, whole).items():
        spent = timed(command, folder)
        total += spent
        print(f"| {machine} | {name} | {spent[0]:.1f} | {spent[1]:.1f} |")
    print(f"| {machine} | all | {total[0]:.1f} | {total[1]:.1f} |")
    return float(total[0])


def main() -> None:
    """Walk with the machines that the command line names."""
    whole = "--whole" in sys.argv[1:]
    machines = [one for one in sys.argv[1:] if not one.startswith("--")] or list(MACHINES)
    print("| machine | command | s by the clock | s of processor |")
    print("|---|---|---|---|")
    for machine in machines:
        with tempfile.TemporaryDirectory() as folder:
            walk(machine, Path(folder), whole)


if __name__ == "__main__":
    main()
