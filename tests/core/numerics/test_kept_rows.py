"""Rows kept in files: the same numbers, in blocks."""

import numpy as np
import pytest

from dropo.core.numerics.kept_rows import FileRows, MemorySettings, keep_rows, row_blocks
from dropo.core.services.errors import BadArgument


def test_a_file_holds_what_was_written():
    """Slices, numbers and masks of rows, bit for bit, written in any blocks."""
    numbers = np.random.default_rng(0).standard_normal((100, 3, 2))
    kept = FileRows(numbers.shape)
    for rows in (slice(40, 100), slice(0, 7), slice(7, 40)):
        kept[rows] = numbers[rows]
    assert (len(kept), kept.shape, kept.nbytes) == (100, (100, 3, 2), 4800)
    chosen = np.array([0, 1, 2, 50, 99])
    masked = np.arange(100) % 7 == 0
    for rows in (slice(None), slice(30, 55), slice(5, 5), chosen, masked):
        assert np.array_equal(kept[rows], numbers[rows])


def test_files_begin_where_memory_ends():
    """All arrays together are within the share, or all are in files; without a limit none is."""
    shapes = [(10, 4), (10, 2, 2)]
    for limit, kind in ((6400, np.ndarray), (6399, FileRows)):
        memory = MemorySettings(limit=limit)
        assert [type(one) for one in keep_rows(shapes, 0.1, memory)] == [kind, kind]
    assert isinstance(keep_rows(shapes, 0.0, None)[0], np.ndarray)


def test_blocks_cover_all_rows():
    """In order, none twice, one row at least."""
    for size in (1, 1 << 20, 1 << 40):
        blocks = row_blocks(50, size)
        assert np.concatenate([np.arange(50)[rows] for rows in blocks]).tolist() == list(range(50))


def test_what_cannot_be_is_refused(tmp_path):
    """With the setting, the rule, and what was got."""
    with pytest.raises(BadArgument, match=r"limit.*positive"):
        MemorySettings(limit=0)
    with pytest.raises(BadArgument, match=r"kept.*share in \[0, 1\]"):
        MemorySettings(kept=1.5)
    with pytest.raises(BadArgument, match=r"folder.*exists"):
        MemorySettings(folder=str(tmp_path / "nowhere"))
    with pytest.raises(BadArgument, match=r"no room for .* bytes.*MemorySettings\(limit="):
        FileRows((1 << 40, 1 << 20), str(tmp_path))
    assert not list(tmp_path.iterdir())
