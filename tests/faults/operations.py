"""Lets commands fail at their file operations: a full disk, a disk that fails, a kill, a torn line.

`python tests/faults/operations.py --seed 0 --faults 500` runs every command in turn with a fault at
an operation drawn at random; after each the same command must end as if nothing had been. It prints
what went wrong, and at last how many faults there were. `--command NAME` takes one command alone.
"""

import argparse
import errno
import importlib
import json
import os
import shutil
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.random import Generator

from dropo.cli.main import main
from dropo.core.services import registry
from dropo.core.services.files.journal import read_lines
from dropo.optimizers.samplers.emcee import Emcee
from dropo.studies.engine.study import Study, Table
from tests.faults.fuzz import SEARCH, VARIANT, build_inputs

FIT = ("fit", "problem.yaml", "--method")
LOG = ("log.csv", "--map", "map.yaml", "--model", "robot.xml")
COMMANDS = {
    "fit": (*FIT, "dropo"),
    "posterior": (*FIT, "posterior", "--likelihood", "linear"),
    "droid": (*FIT, "droid", "--budget", "12"),
    "diagnose": ("diagnose", "problem.yaml", *SEARCH),
    "quick": (
        "diagnose",
        "torque-arm",
        "--quick",
        "--hide",
        "joint_armature:elbow=0.01",
        "--wiring",
        "off",
    ),
    "recover": ("recover", "toy"),
    "train": ("train", "problem.yaml", "--budget", "3", "--trust"),
    "import": ("data", "import", *LOG),
    "init": ("init", "robot.xml", "log.csv", "--map", "map.yaml"),
    "compare": ("compare", "--problem", "problem.yaml", *VARIANT),
    "export": ("export", "checked", "--to", "mujoco"),
    "verify": ("verify", "checked"),
}
"""By name, the commands that write into a folder, but for its option."""
KINDS = ("full", "failing", "kill", "torn")
ERRORS = {"full": errno.ENOSPC, "failing": errno.EIO}
KILLED = 137
UNTOUCHED = 77
"""The exit status of a run that had fewer operations."""
IMPORTED = (
    "cma",
    "emcee",
    "ruamel.yaml",
    "scipy.stats",
    "dropo.cli.support.record",
    "dropo.core.records.saved_schema",
    "dropo.diagnosis.diagnose",
    "dropo.estimators.dropo",
    "dropo.estimators.posterior",
    "dropo.estimators.support.segment_length",
    "dropo.evaluation.predictions",
    "dropo.likelihoods.emulated",
    "dropo.logs.importing",
    "dropo.optimizers.cma_es",
    "dropo.problems.file.reader",
    "dropo.training.train",
)
"""Imported once, for all the processes that are forked."""
TORN = 15
"""Bytes that a torn write lacks."""


def toy(work: Any, seeds: int | None = None) -> Study:
    """A study of tasks that take no time."""
    found = work.map(square, range(seeds or 4))
    row = ("sum", str(sum(answer["square"] for answer in found)))
    return Study("toy", "Toy", (Table("t", ("a", "b"), (row,)),), (), {"found": found})


def square(item: int) -> dict[str, int]:
    """An item squared."""
    return {"square": item**2}


class Operations:
    """Counts file operations, and lets one of them fail."""

    def __init__(self, at: int, kind: str):
        self.at = at
        self.kind = kind
        self.count = 0

    def wrap(self, owner: Any, name: str) -> None:
        """Count the calls of a function."""
        function = getattr(owner, name)

        def counted(*given: Any, **named: Any) -> Any:
            self.count += 1
            if self.count == self.at:
                self._fail(name, given)
            return function(*given, **named)

        setattr(owner, name, counted)

    def _fail(self, name: str, given: tuple[Any, ...]) -> None:
        if self.kind in ERRORS:
            reads = name == "open" and not set("wa+") & set("".join(map(str, given[1:2])))
            number = errno.EIO if reads else ERRORS[self.kind]  # a full disk can be read
            raise OSError(number, os.strerror(number))
        if self.kind == "torn" and name == "fsync":
            size = os.fstat(given[0]).st_size
            os.ftruncate(given[0], max(size - TORN, 0))
        os._exit(KILLED)


def in_child(function: Callable[[], int], silent: Path) -> int:
    """The exit status of a function in a process of its own, whose output goes to a file."""
    child = os.fork()
    if child == 0:
        with silent.open("w") as file:
            os.dup2(file.fileno(), 1)
            os.dup2(file.fileno(), 2)
        os._exit(function())
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def run(command: tuple[str, ...], operations: Operations) -> int:
    """The exit status of a command whose operations are counted, and may fail."""
    os.fsync = lambda file: None  # no fault here loses what the system holds
    time.thread_time = lambda: 0.0  # which stands in comparisons
    for name in ("open", "replace", "mkdir", "unlink"):
        operations.wrap(Path, name)
    operations.wrap(os, "fsync")
    status = main(list(command))
    Path("count.txt").write_bytes(str(operations.count).encode())
    return status if operations.count >= operations.at else UNTOUCHED


def results() -> dict[str, Any]:
    """What every file of the folder holds, without how long anything took."""
    found: dict[str, Any] = {}
    for path in sorted(Path("out").rglob("*")):
        if path.suffix == ".json":
            found[str(path)] = _without_times(json.loads(path.read_text()))
        elif path.suffix == ".jsonl":
            found[str(path)] = read_lines(path, "")
        elif path.is_file():
            found[str(path)] = path.read_bytes()
    return found


def _without_times(content: Any) -> Any:
    """JSON without the time that a run took."""
    if isinstance(content, dict):
        return {k: _without_times(v) for k, v in content.items() if k != "wall_time_s"}
    return content


class Attacked:
    """A command, what an undisturbed run of it writes, and how many operations that takes."""

    def __init__(self, name: str, said: Path):
        self.name = name
        self.said = said
        out = "out/data.npz" if name == "import" else "out"
        into = () if name == "verify" else ("--out", out)
        self.command = (*COMMANDS[name], "--threads", "1", *into)
        status = self._run(Operations(0, ""))
        assert status == 0, f"{name}: {said.read_text()}"
        self.whole = results()
        self.count = int(Path("count.txt").read_text())

    def fault(self, kind: str, at: int) -> list[str]:
        """What is wrong after a fault, and after the same command once more."""
        label = f"{self.name}, {kind} at operation {at}"
        status = self._run(Operations(at, kind))
        text = self.said.read_text()
        wrong = []
        allowed = (0, 1, 2) if "cannot be read" in text else (0, 1)
        if kind in ERRORS and status not in allowed:
            wrong.append(f"{label}: status {status}: {text}")
        if "Traceback" in text or (kind in ERRORS and text.count("dropo: ") > 1):
            wrong.append(f"{label}: {text}")
        status = self._run(Operations(0, ""), new=False)
        found = results()
        if status != 0 or found != self.whole:
            names = {*found, *self.whole}
            other = sorted(one for one in names if found.get(one) != self.whole.get(one))
            wrong.append(f"{label}, then status {status}: {other}, {self.said.read_text()}")
        return wrong

    def _run(self, operations: Operations, *, new: bool = True) -> int:
        """The exit status of the command in a new folder, or in that which is there."""
        if new:
            shutil.rmtree("out", ignore_errors=True)
        return in_child(partial(run, self.command, operations), self.said)


def attack(names: list[str], faults: int, rng: Generator) -> None:
    """Print what goes wrong after faults at operations drawn at random, each command in turn."""
    for name in IMPORTED:
        importlib.import_module(name)
    registry._registered["studies"] = {"toy": toy}
    registry._registered["samplers"] = {"emcee": partial(Emcee, steps=12, burn_in=4)}
    said = Path("said.txt").resolve()
    attacked = [Attacked(name, said) for name in names]
    for number in range(faults):
        one = attacked[number % len(attacked)]
        kind = KINDS[rng.integers(len(KINDS))]
        for told in one.fault(kind, int(rng.integers(1, one.count + 1))):
            print(" ".join(told.split()), flush=True)
    print(faults, "faults in", sum(one.count for one in attacked), "operations")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--faults", type=int, default=500)
    parser.add_argument("--command", choices=tuple(COMMANDS))
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        build_inputs(Path(folder))
        os.chdir(folder)
        checked = ("diagnose", "problem.yaml", *SEARCH, "--out", "checked", "--quiet")
        assert main(list(checked)) == 0
        chosen = [given.command] if given.command else list(COMMANDS)
        attack(chosen, given.faults, np.random.default_rng(given.seed))
    sys.exit(0)
