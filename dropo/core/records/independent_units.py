"""Which compared rows of segments depend on each other."""

from dataclasses import dataclass

import numpy as np

from dropo.core.numerics.dependence import Units
from dropo.core.records.trajectories import Ints, Segments


@dataclass(frozen=True)
class UnitSettings:
    """When parts of the data are units whose sums can be compared with each other.

    Attributes
    ----------
    many : int
        So many trajectories or groups are enough for standard errors clustered by them.
    """

    many: int = 20


SETTINGS = UnitSettings()


def units_of(segments: Segments, settings: UnitSettings = SETTINGS) -> Units:
    """Find the units of the compared rows that are independent of each other.

    They are the first of these of which there are many: parts of the data that share neither a
    trajectory nor a group, trajectories, groups. Else they are the trajectories as series in time.

    Parameters
    ----------
    segments : Segments
        With R compared rows.
    settings : UnitSettings
        How many are many.

    Returns
    -------
    Units
        With a label for each of the R rows.
    """
    segment, step = segments.rows
    trajectory = segments.trajectory[segment]
    group = segments.group[segment]
    choices = [("trajectories", trajectory)]
    if segments.trajectories.group is not None:
        connected = ("trajectories", _connected_parts(trajectory, group))
        choices = [connected, *choices, ("groups", group)]
    time = segments.steps[segment, step]
    for kind, label in choices:
        number = np.unique(label, return_inverse=True)[1]
        if int(number.max()) + 1 >= settings.many:
            return Units(number, False, np.lexsort((time, number)), kind)
    number = np.unique(trajectory, return_inverse=True)[1]
    return Units(number, True, np.lexsort((time, number)), "time")


def _connected_parts(trajectory: Ints, group: Ints) -> Ints:
    """The part (R,) of the data that each row is in, which no trajectory and no group crosses."""
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
