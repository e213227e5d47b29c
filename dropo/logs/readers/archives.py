"""NPZ archives of columns: one table, or many runs with arrays "000/time", "000/qpos" and so on."""

import re
from collections.abc import Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dropo.core.services.errors import BadFile
from dropo.core.services.files.saved_files import NPZ, names_in_npz, read_npz
from dropo.logs.readers.reader import Arrays, Log, Progress, expand_columns

RUN_COLUMN = "run"
"""The column of an archive of runs that holds their names."""
_RUN = re.compile(r"^(\d+)/(.+)$")


def npz_log(path: str | Path) -> Log:
    """Choose the reader for an archive.

    Parameters
    ----------
    path : str or Path
        The .npz file.

    Returns
    -------
    Log
        A `RunsLog` where its arrays are called "000/time" and so on, else an `NpzLog`.

    Raises
    ------
    BadFile
        If it cannot be read.
    """
    log = NpzLog(path)
    return RunsLog(path) if any(_RUN.match(name) for name in log.members) else log


class NpzLog(Log):
    """Arrays of one length (n,), each a column, or (n, k) for "name[0]" to "name[k - 1]".

    Arrays of other lengths are ignored.
    """

    @cached_property
    def members(self) -> list[str]:
        """The names of the arrays."""
        return names_in_npz(self.path, NPZ)

    @cached_property
    def arrays(self) -> Arrays:
        """All arrays by name."""
        return read_npz(self.path, NPZ)

    @cached_property
    def _table(self) -> Arrays:
        """The columns, all of the most frequent length."""
        arrays = {name: array for name, array in self.arrays.items() if array.ndim >= 1}
        lengths = [len(array) for array in arrays.values()]
        rows = max(lengths, key=lengths.count, default=0)
        return expand_columns({name: array for name, array in arrays.items() if len(array) == rows})

    def columns(self, topic: str | None) -> list[str]:
        """List the names of the columns."""
        return list(self._table)

    def read(self, topic: str | None, columns: Sequence[str], progress: Progress) -> Arrays:
        """Read columns by name."""
        progress(1.0, f"reading {self.path.name}")
        return {name: self._table[name] for name in columns}


class RunsLog(NpzLog):
    """Many runs in one archive, for run i the arrays "{i:03d}/time" and others, first axis time.

    An array `names` (n,) may name them. A run that lacks a column has NaN in it. The column "run"
    holds the runs' names.
    """

    run_column = RUN_COLUMN
    time_column = "time"
    separate_runs = True

    @cached_property
    def names(self) -> list[str]:
        """The names of the runs, in order.

        Raises
        ------
        BadFile
            If there is not a name for each run.
        """
        numbers = sorted({int(found[1]) for name in self.members if (found := _RUN.match(name))})
        given = [str(name) for name in self.arrays.get("names", ())]
        if given and len(given) != len(numbers):
            expected = f"a name for each of the {len(numbers)} runs"
            raise BadFile(self.path, "names", expected, f"{len(given)}")
        return given or [f"{i:03d}" for i in numbers]

    @cached_property
    def runs(self) -> list[Arrays]:
        """The arrays of each run, first axis time.

        Raises
        ------
        BadFile
            If the arrays of a run differ in length.
        """
        by_number: dict[int, Arrays] = {}
        for name, array in self.arrays.items():
            if found := _RUN.match(name):
                by_number.setdefault(int(found[1]), {})[found[2]] = array
        runs = [by_number[i] for i in sorted(by_number)]
        for run, name in zip(runs, self.names, strict=True):
            lengths = {channel: len(array) for channel, array in run.items()}
            if len(set(lengths.values())) > 1:
                got = ", ".join(f"{key} of {n}" for key, n in lengths.items())
                raise BadFile(self.path, name, "arrays of one length", got)
        return runs

    @cached_property
    def _runs(self) -> list[Arrays]:
        """The columns of each run."""
        return [expand_columns(run) for run in self.runs]

    def columns(self, topic: str | None) -> list[str]:
        """List the names of the columns."""
        names = dict.fromkeys(name for run in self._runs for name in run)
        return [*names, RUN_COLUMN]

    def read(self, topic: str | None, columns: Sequence[str], progress: Progress) -> Arrays:
        """Read columns by name."""
        parts: dict[str, list[NDArray[Any]]] = {name: [] for name in columns}
        for number, (run, name) in enumerate(zip(self._runs, self.names, strict=True)):
            rows = len(next(iter(run.values())))
            for column, blocks in parts.items():
                if column == RUN_COLUMN:
                    blocks.append(np.full(rows, name))
                else:
                    blocks.append(run.get(column, np.full(rows, np.nan)))
            progress((number + 1) / len(self.names), f"reading {self.path.name}")
        return {name: np.concatenate(arrays) for name, arrays in parts.items()}
