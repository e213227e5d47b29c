"""Numbers of every row of the data, in memory or beyond a limit in a temporary file, and blocks.

No result depends on a limit or on the size of a block.
"""

import shutil
import tempfile
import weakref
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from dropo.core.services.errors import BadArgument
from dropo.core.services.validation import Array, require

ROW_BYTES = 1 << 24  # of the arrays that a block of rows needs at once


def row_blocks(rows: int, bytes_per_row: int) -> list[slice]:
    """Cut rows into blocks.

    Parameters
    ----------
    rows : int
    bytes_per_row : int

    Returns
    -------
    list of slice
        They cover the rows in order, each within ROW_BYTES, or one row.
    """
    size = max(1, ROW_BYTES // max(bytes_per_row, 1))
    return [slice(start, min(start + size, rows)) for start in range(0, rows, size)]


@dataclass(frozen=True)
class MemorySettings:
    """How much memory a fit may take, whatever the number of transitions.

    The data themselves, and a few numbers for each of their rows, are always in memory.

    Attributes
    ----------
    limit : int
        Bytes that a fit may take.
    kept : float
        The share of it for the local model of the simulator (coefficients or slopes of every row);
        a larger one is kept in a temporary file, and read block by block.
    sensitivities : float
        The share of it for the slopes of every row by which a fit is checked at its end; likewise.
    folder : str or None
        Where temporary files go, a disk and no memory; None: where Python's `tempfile` puts them.

    Raises
    ------
    BadArgument
        If the limit is not positive, a share is not in [0, 1], or there is no such folder.
    """

    limit: int = 2 << 30
    kept: float = 0.2
    sensitivities: float = 0.1
    folder: str | None = None

    def __post_init__(self) -> None:
        require(self.limit > 0, "limit", "positive [bytes]", self.limit, "MemorySettings")
        for name in ("kept", "sensitivities"):
            share = getattr(self, name)
            require(0 <= share <= 1, name, "a share in [0, 1]", share, "MemorySettings")
        there = self.folder is None or Path(self.folder).is_dir()
        require(there, "folder", "a folder that exists", self.folder, "MemorySettings")


MEMORY = MemorySettings()


class FileRows:
    """An array (R, ...) of float64 in a temporary file, read and written by slices of rows.

    It is deleted with the object. What is read is what was written, bit for bit, and nothing of it
    stays in memory.

    Parameters
    ----------
    shape : tuple of int
        (R, ...).
    folder : str or None
        Where the file is; None: where Python's `tempfile` puts them.

    Raises
    ------
    BadArgument
        If the folder has no room for it.
    """

    def __init__(self, shape: tuple[int, ...], folder: str | None = None):
        self.shape = shape
        self._row_bytes = 8 * int(np.prod(shape[1:], dtype=np.int64))
        place = folder or tempfile.gettempdir()
        if shutil.disk_usage(place).free < self.nbytes:
            raise BadArgument(
                f"{place} has no room for the {self.nbytes:,} bytes that a fit of these data keeps"
                " there. Name another folder, or allow more memory:"
                " DROPO(memory=MemorySettings(limit=..., folder=...))."
            )
        file: Any = tempfile.TemporaryFile(buffering=0, dir=folder)  # noqa: SIM115 - see below
        self._file = file
        weakref.finalize(self, file.close)

    def __len__(self) -> int:
        return self.shape[0]

    @property
    def nbytes(self) -> int:
        """The size of the whole array."""
        return self.shape[0] * self._row_bytes

    def __getitem__(self, rows: Any) -> Array:
        """Read the rows of a slice without a step, or of an array of their numbers."""
        if not isinstance(rows, slice):
            return self._chosen(np.asarray(rows))
        start, stop, _ = rows.indices(len(self))
        out = np.empty((max(0, stop - start), *self.shape[1:]))
        self._pass_through(self._file.readinto, start, out)
        return out

    def _chosen(self, rows: Any) -> Array:
        """The rows of an array of numbers or of bools, read one run of neighbours at a time."""
        numbers = np.flatnonzero(rows) if rows.dtype == bool else rows
        out = np.empty((len(numbers), *self.shape[1:]))
        cuts = np.flatnonzero(np.diff(numbers) != 1) + 1
        ends = [0, *cuts.tolist(), len(numbers)]
        for first, last in pairwise(ends):
            if last > first:
                begin = int(numbers[first])
                out[first:last] = self[begin : begin + last - first]
        return out

    def __setitem__(self, rows: slice, values: ArrayLike) -> None:
        """Write the rows of a slice."""
        start, stop, _ = rows.indices(len(self))
        shape = (stop - start, *self.shape[1:])
        whole = np.ascontiguousarray(np.broadcast_to(np.asarray(values, dtype=float), shape))
        self._pass_through(self._file.write, start, whole)

    def _pass_through(self, transfer: Callable[[memoryview], int], first: int, rows: Array) -> None:
        """Read or write whole rows from the first one on; a call may move a part of them alone."""
        if not rows.size:
            return
        left = rows.data.cast("B")
        self._file.seek(first * self._row_bytes)
        while len(left):
            moved = transfer(left)
            if not moved:
                raise OSError(f"A temporary file of {self.nbytes:,} bytes could not be read.")
            left = left[moved:]


KeptRows = Array | FileRows
"""Numbers of every row (R, ...): `rows[slice]` reads a block of either."""


def keep_rows(
    shapes: list[tuple[int, ...]], share: float, memory: MemorySettings | None
) -> list[KeptRows]:
    """Make room for numbers of every row.

    Parameters
    ----------
    shapes : list of tuple of int
        (R, ...) of each array.
    share : float
        Of the memory, that all of them may take together.
    memory : MemorySettings or None
        None: without a limit.

    Returns
    -------
    list of KeptRows
        One of each shape, in memory if all together are within the share, else in files.

    Raises
    ------
    BadArgument
        If files have no room.
    """
    needed = sum(8 * int(np.prod(shape, dtype=np.int64)) for shape in shapes)
    if memory is None or needed <= share * memory.limit:
        return [np.empty(shape) for shape in shapes]
    return [FileRows(shape, memory.folder) for shape in shapes]
