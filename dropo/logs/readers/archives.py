"""NPZ archives of columns: one table, or many runs as arrays "000/time", "000/qpos", ... with their
`names`.
"""

import re
import zipfile
import zlib
from collections.abc import Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dropo.core.services.errors import BadFile
from dropo.logs.readers.reader import Arrays, Log, Progress, expanded

EXPECTED = "an .npz file, as numpy.savez writes it"
_RUN = re.compile(r"^(\d+)/(.+)$")


def npz_log(path: str | Path) -> Log:
    """The reader for an archive: of runs where its arrays are called "000/time" and so on, else of
    columns.
    """
    log = NpzLog(path)
    return RunsLog(path) if any(_RUN.match(name) for name in log.members) else log


class NpzLog(Log):
    """Arrays of one length, each a column, or (n, k) for columns "name[0]" to "name[k - 1]"; others
    are passed over.
    """

    @cached_property
    def members(self) -> list[str]:
        """The names of the arrays."""
        size = self.path.stat().st_size
        try:
            with zipfile.ZipFile(self.path) as archive:
                return [name.removesuffix(".npy") for name in archive.namelist()]
        except (zipfile.BadZipFile, OSError) as error:
            raise self.broken(
                EXPECTED, f"byte {size}", f"{error}: it ends before the table of its contents"
            ) from None

    @cached_property
    def arrays(self) -> Arrays:
        """All arrays by name."""
        name = ""
        try:
            with np.load(self.path, allow_pickle=False) as content:
                out = {}
                for name in self.members:
                    out[name] = np.asarray(content[name])
                return out
        except (zipfile.BadZipFile, zlib.error, OSError, EOFError, ValueError) as error:
            raise self.broken("an array of numbers", name, error) from None

    @cached_property
    def _table(self) -> Arrays:
        arrays = {name: array for name, array in self.arrays.items() if array.ndim >= 1}
        lengths = [len(array) for array in arrays.values()]
        rows = max(lengths, key=lengths.count, default=0)
        return expanded({name: array for name, array in arrays.items() if len(array) == rows})

    def columns(self, topic: str | None) -> list[str]:
        return list(self._table)

    def read(self, topic: str | None, columns: Sequence[str], progress: Progress) -> Arrays:
        progress(1.0, f"reading {self.path.name}")
        return {name: self._table[name] for name in columns}


class RunsLog(NpzLog):
    """Many runs in one archive: `names` (n,), and for run i the arrays "{i:03d}/time" and others,
    first axis time.

    A run that lacks a column has NaN in it. The column "run" holds the runs' names.
    """

    run_column = "run"
    time_column = "time"
    separate_runs = True

    @cached_property
    def names(self) -> list[str]:
        """The names of the runs, in order."""
        numbers = sorted({int(found[1]) for name in self.members if (found := _RUN.match(name))})
        given = [str(name) for name in self.arrays.get("names", ())]
        if given and len(given) != len(numbers):
            raise BadFile(
                self.path, "names", f"a name for each of the {len(numbers)} runs", f"{len(given)}"
            )
        return given or [f"{i:03d}" for i in numbers]

    @cached_property
    def runs(self) -> list[Arrays]:
        """The arrays of each run, first axis time."""
        by_number: dict[int, Arrays] = {}
        for name, array in self.arrays.items():
            if found := _RUN.match(name):
                by_number.setdefault(int(found[1]), {})[found[2]] = array
        runs = [by_number[i] for i in sorted(by_number)]
        for run, name in zip(runs, self.names, strict=True):
            lengths = {channel: len(array) for channel, array in run.items()}
            if len(set(lengths.values())) > 1:
                raise BadFile(
                    self.path,
                    name,
                    "arrays of one length",
                    ", ".join(f"{key} of {n}" for key, n in lengths.items()),
                )
        return runs

    @cached_property
    def _runs(self) -> list[Arrays]:
        """The columns of each run."""
        return [expanded(run) for run in self.runs]

    def columns(self, topic: str | None) -> list[str]:
        return [*dict.fromkeys(name for run in self._runs for name in run), "run"]

    def read(self, topic: str | None, columns: Sequence[str], progress: Progress) -> Arrays:
        parts: dict[str, list[NDArray[Any]]] = {name: [] for name in columns}
        for number, (run, name) in enumerate(zip(self._runs, self.names, strict=True)):
            rows = len(next(iter(run.values())))
            for column, into in parts.items():
                into.append(
                    np.full(rows, name)
                    if column == "run"
                    else run.get(column, np.full(rows, np.nan))
                )
            progress((number + 1) / len(self.names), f"reading {self.path.name}")
        return {name: np.concatenate(arrays) for name, arrays in parts.items()}
