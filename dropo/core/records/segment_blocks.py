"""Segments cut into blocks within a number of bytes, so that memory does not grow with them."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from dropo.core.records.trajectories import Segments

DESIGN_BYTES = 1 << 26  # of the predictions that are held at once


def segment_blocks(
    segments: Segments, bytes_per_row: int
) -> Iterator[tuple[Segments, slice, NDArray[np.int64]]]:
    """Cut segments into blocks, but no chain of segments that go on from each other.

    Parameters
    ----------
    segments : Segments
    bytes_per_row : int

    Yields
    ------
    block : Segments
        In order, each within DESIGN_BYTES if its chains let it.
    rows : slice
        Its compared rows among all.
    places : (n,) array
        Its segments among all.
    """
    count = len(segments)
    first_row = np.searchsorted(segments.rows[0], np.arange(count + 1))  # of each segment
    size = max(1, DESIGN_BYTES // max(bytes_per_row, 1))
    ends = np.append(_uncut(segments), count)
    begin = 0
    while begin < count:
        # The last end within the size, or the next one.
        limit = first_row[begin] + size
        last = np.searchsorted(first_row[ends], limit, side="right") - 1
        following = np.searchsorted(ends, begin, side="right")
        end = int(ends[max(last, following)])
        places = np.arange(begin, end)
        part = segments if len(places) == count else segments.take(places)
        yield part, slice(int(first_row[begin]), int(first_row[end])), places
        begin = end


def _uncut(segments: Segments) -> NDArray[np.int64]:
    """The places from 1 on at which no chain is cut.

    There no segment behind goes on from one before, nor the other way round.
    """
    n = len(segments)
    own = np.arange(n)
    other = np.where(segments.previous >= 0, segments.previous, own)
    low = np.minimum(other, own)
    high = np.maximum(other, own)
    crossing = np.zeros(n + 1, dtype=np.int64)  # links low < c <= high cross a cut at c
    np.add.at(crossing, low + 1, 1)
    np.add.at(crossing, high + 1, -1)
    cuts: NDArray[np.int64] = np.flatnonzero(np.cumsum(crossing)[:n] == 0)
    return cuts[cuts > 0]
