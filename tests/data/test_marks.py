"""Marks for what was not measured are told from motion, rest, stops and sensors at their end."""

import numpy as np
import pytest

from dropo.data.checks.columns import Column, check_marks

TIME = 0.01 * np.arange(300)
MOTION = 1.2 * np.sin(3 * TIME) + 0.3 * np.cos(17 * TIME)


def column(values, unit="rad", **given):
    """A signal at 100 Hz."""
    values = np.asarray(values, dtype=float)
    return Column("q", unit, TIME[: len(values)], values, np.arange(len(values)), **given)


def marked(mark, rows, values=MOTION):
    """The motion with a mark in some rows."""
    values = np.array(values, dtype=float)
    values[rows] = mark
    return values


@pytest.mark.parametrize(
    ("mark", "rows"),
    [
        (-9999.0, [7]),
        (9999.0, [7, 8, 200]),
        (999.0, [7, 8]),
        (-999.25, [7]),
        (32767.0, [7]),
        (np.deg2rad(-999.0), [7, 90]),
        (-99.999, [7, 90, 91, 150]),
        (40.0, [7, 90, 150]),
    ],
)
def test_marks_are_named_by_row_and_value(mark, rows):
    """Codes of loggers, of a log in degrees or millimetres too, and what a joint jumps to."""
    (found,) = check_marks(column(marked(mark, rows)))
    assert (found.level, found.signal, found.row) == ("error", "q", 7)
    assert f"{mark:.6g} rad is far outside the other numbers" in found.sentence
    assert f"of {len(rows)} the first is in row 7 at 0.07 s" in found.sentence


def test_two_marks_and_a_number_beyond_all_bounds():
    """Neither hides the other."""
    values = marked(1e30, [3], marked(-9999.0, [7], marked(9999.0, [9, 20])))
    told = [found.sentence for found in check_marks(column(values))]
    assert [text.split()[:2] for text in told] == [
        ["a", "number"],
        ["-9999", "rad"],
        ["9999", "rad"],
    ]


def test_a_joint_at_rest_is_no_reason_to_miss_a_mark():
    assert [found.row for found in check_marks(column(marked(-999.0, [5], np.full(50, 0.3))))] == [
        5
    ]


@pytest.mark.parametrize(
    "signal",
    [
        column(MOTION),
        column(np.clip(MOTION, -1.0, 1.0), limits=(-1.0, 1.0)),
        column(marked(999.0, [5, 6], 900 + MOTION), "N m"),
        column(marked(9999.0, [5, 6], 5000 * MOTION), "count"),
        column(np.full(20, 999.0)),
        # At rest in one run, elsewhere in another; starts that are always the same.
        column(marked(0.0, slice(0, 100), 50 + 0.01 * MOTION), breaks=np.array([100])),
        column(marked(0.0, [0, 100, 200], 50 + 0.01 * MOTION), breaks=np.array([100, 200])),
        # A stop, and a sensor of forces at the end of its range.
        column(marked(20.0, [5, 50, 90]), limits=(-3.0, 20.0)),
        column(marked(157.0, [5, 50, 90]), "m/s^2"),
        # Commands that are on or off.
        column(marked(999.0, slice(50, 90), np.zeros(300)), "", sensor=False),
        column(marked(40.0, [5, 50])),
    ],
    ids=[
        "motion",
        "clipped",
        "near",
        "counts",
        "constant",
        "rest",
        "starts",
        "stop",
        "force",
        "switch",
        "two spikes",
    ],
)
def test_no_false_alarms(signal):
    assert list(check_marks(signal)) == []
