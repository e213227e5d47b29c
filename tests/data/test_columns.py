"""What is said of a column, or in one line of several."""

import numpy as np
import pytest

from dropo.data.checks.columns import (
    Column,
    check_column,
    check_limits,
    check_marks,
    describe_coarse,
    describe_still,
    is_coarse,
)

TIME = np.arange(400) / 100
WAVE = 0.7 * np.sin(2 * TIME)


def column(values, name="elbow", **given):
    values = np.asarray(values, dtype=float)
    rows = np.arange(len(values))
    return Column(name, "rad", TIME[: len(values)], values, rows, **given)


def stepped(step, name="elbow"):
    return column(np.rint(WAVE / step) * step, name)


def test_what_does_not_move_is_said_in_one_line():
    """Of one run with its value, of several with their names, of many with how many more."""
    (one,) = describe_still([column(np.full(20, 0.5), run="a")])
    assert one.sentence == "it does not move: all 20 rows are 0.5."
    assert one.run == "a"
    (three,) = describe_still([column(np.zeros(20), run=name) for name in "abc"])
    assert three.sentence == "it does not move in 3 runs: a, b, c."
    (many,) = describe_still([column(np.zeros(20), run=f"r{i}") for i in range(40)])
    assert many.sentence.startswith("it does not move in 40 runs: r0, r1")
    assert many.sentence.rstrip(".").endswith("more")
    assert list(describe_still([])) == []


def test_coarse_steps_are_said_of_a_column_and_of_several():
    """The step and the least noise that it means; of several the smallest to the largest."""
    (one,) = [f for f in check_column(stepped(0.2)) if "steps of" in f.sentence]
    assert "it moves in steps of 0.2 rad" in one.sentence
    assert f"{0.2 / np.sqrt(12):.6g} rad" in one.advice
    (alike,) = describe_coarse([stepped(0.2), stepped(0.2, "wrist")])
    assert alike.sentence.startswith("the resolution of 2 signals is 0.2 rad, coarse")
    assert alike.signal == "elbow, wrist"
    (others,) = describe_coarse([stepped(0.1), stepped(0.2, "wrist")])
    assert others.sentence.startswith("the resolution of 2 signals is 0.1 to 0.2 rad, coarse")
    assert f"{0.1 / np.sqrt(12):.6g} rad" in others.advice
    assert list(describe_coarse([column(WAVE)])) == []
    assert is_coarse(stepped(0.2))
    assert not is_coarse(column(WAVE))
    assert not is_coarse(column([0.1]))


def test_a_stop_may_give_way_a_little():
    """Positions just beyond a joint's range are no finding, commands just beyond theirs are."""
    limits = (-0.69, 0.69)
    assert list(check_limits(column(WAVE, limits=limits))) == []
    (far,) = check_limits(column(2 * WAVE, limits=limits))
    assert "positions are outside the joint's range" in far.sentence
    (clipped,) = check_limits(column(WAVE, limits=limits, sensor=False))
    assert clipped.sentence.startswith("49 of 400 actions are outside the control range [-0.69")


def test_numbers_beyond_all_bounds_alone():
    """A column of nothing else has no marks beside."""
    (only,) = check_marks(column(np.full(5, 1e300)))
    assert "is no measurement; of 5 the first is 1e+300 rad" in only.sentence
    assert only.level == "error"
    assert only.row == pytest.approx(0)
