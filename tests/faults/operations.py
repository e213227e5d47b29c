"""Lets a fit fail at each of its file operations: a full disk, a kill, a line that is torn.

`python tests/faults/operations.py FOLDER KIND [STEP]` runs a fit in FOLDER, which holds
problem.yaml, with a fault at the first operation, then at one STEP later, and so on; after each the
same command must end as if nothing had been. It prints what went wrong, and at last how many
operations were tried.
"""

import errno
import importlib
import json
import os
import shutil
import sys
from collections.abc import Callable
from functools import partial
from itertools import count
from pathlib import Path
from typing import Any

from dropo.cli.main import main

COMMAND = ("fit", "problem.yaml", "--threads", "1", "--out", "out")
KILLED = 137
UNTOUCHED = 77
"""The exit status of a run that had fewer operations."""
IMPORTED = (
    "dropo.cli.record",
    "dropo.core.records.saved_schema",
    "dropo.estimators.dropo",
    "dropo.estimators.support.segment_length",
    "dropo.evaluation.predictions",
    "dropo.likelihoods.emulated",
    "dropo.optimizers.cma_es",
    "dropo.problems.file.reader",
)
"""Imported once, for all the processes that are forked."""
TORN = 15
"""Bytes that a torn write lacks."""


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
            if name == "open" and not set("wa+") & set("".join(map(str, given[1:2]))):
                return function(*given, **named)
            self.count += 1
            if self.count == self.at:
                self._fail(name, given)
            return function(*given, **named)

        setattr(owner, name, counted)

    def _fail(self, name: str, given: tuple[Any, ...]) -> None:
        if self.kind == "full":
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
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


def faulty(at: int, kind: str) -> int:
    """The exit status of a fit with a fault at one of its operations."""
    operations = Operations(at, kind)
    for name in ("open", "replace", "mkdir", "unlink"):
        operations.wrap(Path, name)
    operations.wrap(os, "fsync")
    status = main(list(COMMAND))
    return status if operations.count >= at else UNTOUCHED


def result() -> Any:
    """What the fit found, without how long it took."""
    content = json.loads(Path("out/fit.json").read_text())
    del content["wall_time_s"]
    return content


def run(folder: Path, kind: str, step: int) -> int:
    """The number of operations after each of which the same command ended well."""
    for name in IMPORTED:
        importlib.import_module(name)
    os.chdir(folder)
    said = Path("said.txt").resolve()
    assert in_child(lambda: main(list(COMMAND)), said) == 0, said.read_text()
    whole = result()
    names = sorted(path.name for path in Path("out").iterdir())
    for number, at in enumerate(count(1, step)):
        shutil.rmtree("out", ignore_errors=True)
        status = in_child(partial(faulty, at, kind), said)
        if status == UNTOUCHED:
            return number
        text = said.read_text()
        if kind == "full" and status not in (0, 1):
            print(f"operation {at}: status {status}: {text}")
        if "Traceback" in text or (kind == "full" and text.count("dropo: ") > 1):
            print(f"operation {at}: {text}")
        status = in_child(lambda: main(list(COMMAND)), said)
        found = sorted(path.name for path in Path("out").iterdir())
        if status != 0 or result() != whole or found != names:
            print(f"operation {at}, then status {status}: {found}, {said.read_text()}")
    raise AssertionError


if __name__ == "__main__":
    folder, kind, *step = sys.argv[1:]
    print(run(Path(folder), kind, int(step[0]) if step else 1), "operations")
