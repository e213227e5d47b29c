"""Rows in a row for which something holds."""

import numpy as np
from numpy.typing import NDArray


def spans_of(holds: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Find where something begins to hold, and where it ends.

    Parameters
    ----------
    holds : (n,) array of bool
        Whether it does.

    Returns
    -------
    (k, 2) array of int
        First and last + 1 row of each of the k spans.
    """
    edges = np.flatnonzero(np.diff(np.concatenate([[0], holds.astype(int), [0]])))
    return np.asarray(edges, dtype=np.int64).reshape(-1, 2)
