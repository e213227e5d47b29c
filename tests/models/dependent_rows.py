"""Trajectories of which rows depend on each other."""

import numpy as np

from dropo.core.records.trajectories import Trajectories


def trajectories(lengths, group=None):
    """Transitions without content, of trajectories of these lengths."""
    n = sum(lengths)
    ends = np.zeros(n, dtype=bool)
    ends[np.cumsum(lengths) - 1] = True
    return Trajectories(np.arange(n)[:, None], np.zeros((n, 0)), np.zeros((n, 1)), ends, group)
