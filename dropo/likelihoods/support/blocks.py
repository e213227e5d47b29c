"""Work cut into blocks that keep within a number of bytes, so that memory does not grow with the
data.
"""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from dropo.core.records.trajectories import Segments

ROW_BYTES = 1 << 24  # of the arrays that a block of rows needs at once
DESIGN_BYTES = 1 << 26  # of the predictions that are held at once


def row_blocks(rows: int, bytes_per_row: int) -> list[slice]:
    """Slices that cover so many rows in order, each within ROW_BYTES, or one row."""
    size = max(1, ROW_BYTES // max(bytes_per_row, 1))
    return [slice(start, min(start + size, rows)) for start in range(0, rows, size)]


def segment_blocks(
    segments: Segments, bytes_per_row: int
) -> Iterator[tuple[Segments, slice, NDArray[np.int64]]]:
    """(block, its rows in the whole, its segments' places there), in order, each within
    DESIGN_BYTES; chains are not cut.
    """
    first = np.searchsorted(
        segments.rows[0], np.arange(len(segments) + 1)
    )  # the row that each segment begins with
    size = max(1, DESIGN_BYTES // max(bytes_per_row, 1))
    ends = np.append(_uncut(segments), len(segments))
    begin = 0
    while begin < len(segments):
        last = (
            np.searchsorted(first[ends], first[begin] + size, side="right") - 1
        )  # the last end within the size, or the next
        end = int(ends[max(last, np.searchsorted(ends, begin, side="right"))])
        places = np.arange(begin, end)
        part = segments if len(places) == len(segments) else segments.take(places)
        yield part, slice(int(first[begin]), int(first[end])), places
        begin = end


def _uncut(segments: Segments) -> NDArray[np.int64]:
    """The places from 1 on at which no chain is cut: no segment behind goes on from one before, or
    the other way round.
    """
    n = len(segments)
    other = np.where(segments.previous >= 0, segments.previous, np.arange(n))
    low = np.minimum(other, np.arange(n))
    high = np.maximum(other, np.arange(n))
    crossing = np.zeros(n + 1, dtype=np.int64)  # links low < c <= high cross a cut at c
    np.add.at(crossing, low + 1, 1)
    np.add.at(crossing, high + 1, -1)
    cuts: NDArray[np.int64] = np.flatnonzero(np.cumsum(crossing)[:n] == 0)
    return cuts[cuts > 0]
