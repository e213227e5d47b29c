"""Which compared rows of segments depend on each other."""

import numpy as np

from dropo.core.numerics.dependence import Units
from dropo.core.records.trajectories import Ints, Segments

MANY = 20  # trajectories or groups from which their number is enough for errors clustered by them


def units_of(segments: Segments) -> Units:
    """The units of the compared rows: trajectories that share no group, trajectories, or groups,
    the first of them that are many; else the trajectories as series in time.
    """
    segment, step = segments.rows
    trajectory = segments.trajectory[segment]
    group = segments.group[segment]
    named = segments.trajectories.group is not None
    choices = [("trajectories", _joined(trajectory, group))] if named else []
    choices += [("trajectories", trajectory)] + ([("groups", group)] if named else [])
    time = segments.steps[segment, step]
    for kind, label in choices:
        dense = np.unique(label, return_inverse=True)[1]
        if int(dense.max()) + 1 >= MANY:
            return Units(dense, False, np.lexsort((time, dense)), kind)
    dense = np.unique(trajectory, return_inverse=True)[1]
    return Units(dense, True, np.lexsort((time, dense)), "time")


def _joined(trajectory: Ints, group: Ints) -> Ints:
    """(R,) the parts of the data that neither a trajectory nor a group crosses."""
    label = np.unique(trajectory, return_inverse=True)[1]
    while True:
        by_group = np.full(int(group.max()) + 1, len(label))
        np.minimum.at(by_group, group, label)
        by_trajectory = np.full(int(trajectory.max()) + 1, len(label))
        np.minimum.at(by_trajectory, trajectory, by_group[group])
        new = by_trajectory[trajectory]
        if np.array_equal(new, label):
            return label
        label = new
