"""Trajectories and the segments cut from them."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dropo.core.records.trajectories import Trajectories
from dropo.core.services.errors import BadArgument, UnknownName


def trajectories(*lengths, group=None):
    """Row i has observation (i, -i), action (10 i,) and next observation (i + 1, -i - 1): every
    number tells where it is from.
    """
    row = np.arange(sum(lengths), dtype=float)
    ends = np.isin(row, np.cumsum(lengths) - 1)
    return Trajectories(
        np.stack([row, -row], 1), 10 * row[:, None], np.stack([row + 1, -row - 1], 1), ends, group
    )


def test_rows_know_their_trajectory():
    """Trajectories of 3, 1 and 4 rows."""
    data = trajectories(3, 1, 4)
    assert data.spans == [(0, 3), (3, 4), (4, 8)]
    np.testing.assert_array_equal(data.trajectory, [0, 0, 0, 1, 2, 2, 2, 2])
    assert len(data) == 8


def test_arrays_are_read_only_copies():
    """Neither the caller's array nor the data's can change the other."""
    given = np.zeros((2, 1))
    data = Trajectories(given, np.zeros((2, 0)), given, np.array([False, True]), time=[0.0, 0.1])
    given[0] = 7.0
    assert data.observations[0, 0] == 0.0
    for array in (data.observations, data.actions, data.next_observations, data.time):
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 1.0


@settings(deadline=None, derandomize=True)
@given(
    st.lists(st.integers(1, 12), min_size=1, max_size=5),
    st.integers(1, 6),
    st.sampled_from(["transition", "partial"]),
)
def test_windows_stay_apart_and_inside(lengths, size, reset):
    """No window crosses a trajectory's end, none overlaps another, and as many as fit are there."""
    data = trajectories(*lengths)
    if size > (min if reset == "partial" else max)(lengths):
        with pytest.raises(BadArgument, match=rf"lambda = {size} is longer than trajectory \d"):
            data.segments(size, reset=reset)
        return
    segments = data.segments(size, reset=reset)
    assert len(segments) == sum(n // size for n in lengths)
    assert len(np.unique(segments.steps)) == segments.steps.size
    np.testing.assert_array_equal(np.diff(segments.steps, axis=1), 1)
    assert (data.trajectory[segments.steps] == segments.trajectory[:, None]).all()
    np.testing.assert_array_equal(segments.targets[:, 0], segments.starts[:, 0] + size)


def test_lambda_steps():
    """lambda = 2 in trajectories of 5 and 4: four windows, two actions each, compared at their
    ends.
    """
    segments = trajectories(5, 4).segments(2)
    np.testing.assert_array_equal(segments.steps, [[0, 1], [2, 3], [5, 6], [7, 8]])
    np.testing.assert_array_equal(segments.previous, -1)
    np.testing.assert_array_equal(segments.lengths, 2)
    np.testing.assert_array_equal(segments.starts[:, 0], [0, 2, 5, 7])
    np.testing.assert_array_equal(
        segments.actions[:, :, 0], [[0, 10], [20, 30], [50, 60], [70, 80]]
    )
    np.testing.assert_array_equal(segments.targets[:, 0], [2, 4, 7, 9])
    np.testing.assert_array_equal(segments.rows[1], 1)


def test_every_step():
    """Every step compared: rows by segment, then step; the ends are among them."""
    segments = trajectories(4).segments(2, every_step=True)
    np.testing.assert_array_equal(segments.rows, [[0, 0, 1, 1], [0, 1, 0, 1]])
    np.testing.assert_array_equal(segments.targets[:, 0], [1, 2, 3, 4])
    assert segments.comparing_every_step() is segments
    np.testing.assert_array_equal(
        trajectories(4).segments(2).comparing_every_step().targets, segments.targets
    )


def test_start_mode():
    """One segment a trajectory, every step compared; a shorter one ends with -1 and its action."""
    segments = trajectories(3, 1).segments(reset="start")
    np.testing.assert_array_equal(segments.steps, [[0, 1, 2], [3, -1, -1]])
    np.testing.assert_array_equal(segments.lengths, [3, 1])
    np.testing.assert_array_equal(segments.rows, [[0, 0, 0, 1], [0, 1, 2, 0]])
    np.testing.assert_array_equal(segments.targets[:, 0], [1, 2, 3, 4])
    np.testing.assert_array_equal(segments.actions[1, :, 0], [30, 30, 30])
    assert segments.every_step


def test_partial_mode_is_a_chain_in_each_trajectory():
    """Each window goes on from the one before it; a trajectory's first from none; levels order them
    for replay.
    """
    segments = trajectories(7, 4).segments(2, reset="partial", set_columns=[True, False])
    np.testing.assert_array_equal(segments.previous, [-1, 0, 1, -1, 3])
    np.testing.assert_array_equal(segments.set_columns, [True, False])
    assert [level.tolist() for level in segments.levels] == [[0, 3], [1, 4], [2]]


def test_take():
    """By places, in their order, or by a mask; of a chain only with what comes before."""
    segments = trajectories(5, 4).segments(2)
    np.testing.assert_array_equal(segments.take([3, 0]).steps, [[7, 8], [0, 1]])
    np.testing.assert_array_equal(segments.take(segments.trajectory == 1).steps, [[5, 6], [7, 8]])
    chain = trajectories(5, 4).segments(2, reset="partial")
    np.testing.assert_array_equal(chain.take([2, 3]).previous, [-1, 0])
    with pytest.raises(
        BadArgument, match=r"'index' of Segments.take must be closed under 'previous'"
    ):
        chain.take([1, 2])


def test_groups():
    """The data's own groups become 0, 1, ...; without, a segment's group is its trajectory."""
    np.testing.assert_array_equal(trajectories(4, 2).segments(2).group, [0, 0, 1])
    np.testing.assert_array_equal(
        trajectories(4, 2, group=[7, 7, 9, 9, 7, 7]).segments(2).group, [0, 1, 0]
    )


def test_some_of_the_rows():
    """The first transitions, and some of the trajectories: each piece ends where the next row is
    missing.
    """
    data = trajectories(3, 2, 3, group=[5, 5, 6, 6, 6, 8, 8, 8])
    assert data.head(4).spans == [(0, 3), (3, 4)]
    assert len(data.head(100)) == 8
    kept = data.select([0, 2])
    assert kept.spans == [(0, 3), (3, 6)]
    np.testing.assert_array_equal(kept.observations[:, 0], [0, 1, 2, 5, 6, 7])
    np.testing.assert_array_equal(kept.group, [0, 0, 1, 2, 2, 2])
    with pytest.raises(BadArgument, match="'rows' of Trajectories must be at least one"):
        data.select([3])
    with pytest.raises(BadArgument, match=r"'transitions' of Trajectories.head must be at least 1"):
        data.head(0)


def arrays(**changes):
    """Arguments of two good rows of two signals, some of them changed."""
    good = {
        "observations": np.zeros((2, 2)),
        "actions": np.zeros((2, 1)),
        "next_observations": np.zeros((2, 2)),
        "terminals": np.array([False, True]),
    }
    return good | changes


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        (
            {"terminals": [False, False]},
            (
                "'terminals' of Trajectories must be True on each trajectory's last row. Got "
                "'no True at all'"
            ),
        ),
        ({"terminals": [True, False]}, "'terminals' of Trajectories must be True on the last row"),
        ({"terminals": [True]}, r"'terminals' of Trajectories must be of shape \(2,\). Got \(1,\)"),
        (
            {"observations": [[0, 0], [np.nan, 0]]},
            r"'observations' of Trajectories must be finite. Got 'nan at \(1, 0\)'",
        ),
        (
            {"actions": [[np.inf], [0]]},
            r"'actions' of Trajectories must be finite. Got 'inf at \(0, 0\)'",
        ),
        (
            {"observations": np.zeros(2)},
            r"'observations' of Trajectories must be of shape \(any, any\). Got \(2,\)",
        ),
        (
            {"observations": np.zeros((0, 2))},
            "'observations' of Trajectories must be at least one row",
        ),
        (
            {"actions": np.zeros((3, 1))},
            r"'actions' of Trajectories must be of shape \(2, any\). Got \(3, 1\)",
        ),
        (
            {"next_observations": np.zeros((2, 3))},
            r"'next_observations' of Trajectories must be of shape \(2, 2\). Got \(2, 3\)",
        ),
        ({"actions": [["push"], ["pull"]]}, "'actions' of Trajectories must be numbers"),
        ({"group": [0]}, r"'group' of Trajectories must be of shape \(2,\)"),
        ({"time": [0.0, np.nan]}, "'time' of Trajectories must be finite"),
    ],
)
def test_data_that_cannot_be_used_is_refused(changes, words):
    """The message names array, rule and what was got, with the place of a NaN."""
    with pytest.raises(BadArgument, match=words):
        Trajectories(**arrays(**changes))


def test_segments_that_cannot_be_cut_are_refused():
    """lambda below 1, longer than a trajectory, an unknown reset mode, a mask of another size."""
    data = trajectories(5, 3)
    with pytest.raises(
        BadArgument, match=r"'lambda' of Trajectories.segments must be at least 1. Got 0"
    ):
        data.segments(0)
    with pytest.raises(
        BadArgument,
        match=r"lambda = 6 is longer than trajectory 0, which has 5 transitions. "
        r"Choose a smaller lambda",
    ):
        data.segments(6)
    with pytest.raises(
        BadArgument, match=r"lambda = 4 is longer than trajectory 1, which has 3 transitions"
    ):
        data.segments(4, reset="partial")
    assert len(data.segments(4)) == 1
    with pytest.raises(
        UnknownName, match=r"No reset mode called 'transitions'. Did you mean 'transition'?"
    ):
        data.segments(reset="transitions")
    with pytest.raises(
        BadArgument, match=r"'set_columns' of Trajectories.segments must be of shape \(2,\)"
    ):
        data.segments(reset="partial", set_columns=[True])
