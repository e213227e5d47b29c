"""Spans of rows for which something holds."""

import numpy as np
import pytest

from dropo.core.numerics.spans import spans_of


@pytest.mark.parametrize(
    ("holds", "spans"),
    [
        ([], []),
        ([0, 0], []),
        ([1, 1], [[0, 2]]),
        ([1, 0, 1, 1, 0, 1], [[0, 1], [2, 4], [5, 6]]),
        ([0, 1, 0], [[1, 2]]),
    ],
)
def test_first_and_past_last_row_of_each(holds, spans):
    assert spans_of(np.array(holds, dtype=bool)).tolist() == spans
