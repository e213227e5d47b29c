"""Which rows are independent of which others."""

import numpy as np

from dropo.core.records.independent_units import SETTINGS, units_of
from tests.models.dependent_rows import trajectories

MANY = SETTINGS.many


def test_units_are_what_nothing_crosses():
    """Trajectories where there are 20; unions of them where a group holds several; groups within
    few; else time.
    """
    assert units_of(trajectories([3] * MANY).segments()).kind == "trajectories"
    pairs = units_of(trajectories([3] * 2 * MANY, np.repeat(np.arange(MANY), 6)).segments())
    assert (pairs.kind, pairs.count) == ("trajectories", MANY)
    inside = units_of(trajectories([200], np.repeat(np.arange(MANY), 10)).segments())
    assert (inside.kind, inside.count, inside.serial) == ("groups", MANY, False)
    few = units_of(trajectories([30] * (MANY - 1)).segments())
    assert (few.kind, few.count, few.serial) == ("time", MANY - 1, True)


def test_rows_are_put_in_time_order():
    """Rows of every step of segments, taken in another order, come back by trajectory and time."""
    segments = trajectories([4, 6]).segments(2, every_step=True).take([4, 0, 3, 1, 2])
    units = units_of(segments)
    segment, step = segments.rows
    np.testing.assert_array_equal(segments.steps[segment, step][units.order], np.arange(10))
