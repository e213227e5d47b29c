"""How data are cut into windows to fit and windows held out."""

from dataclasses import replace

import numpy as np
import pytest

from dropo.core.contracts.problem import Problem
from dropo.core.services.errors import BadArgument
from dropo.diagnosis.search.windows import split
from tests.models.linear_mass import Mass, measured


def rows(windows):
    """Every row of the data that the windows measure at, starts and ends."""
    steps = windows.segments.steps
    return {*steps.ravel().tolist(), *(steps[:, -1] + 1).tolist()}


@pytest.mark.parametrize("episodes", [1, 3, 20])
def test_no_measurement_is_used_twice(episodes):
    """Windows of one trajectory, of few and of many share no measurement, and the two sides share
    no block.
    """
    train, test = split(
        Problem("mass", Mass(), measured({}, episodes=episodes, steps=400 // episodes)), 5, 1000
    )
    for windows in (train, test):
        assert len(rows(windows)) == len(windows) * 6
        assert np.all(np.diff(windows.segments.steps, axis=1) == 1)
    assert not rows(train) & rows(test) or episodes < 4
    assert not set(train.block.tolist()) & set(test.block.tolist())
    assert len(set(train.block.tolist())) >= 10


def test_held_out_trajectories_of_the_problem_are_taken():
    """A problem's own held-out data judge; all of its other data fit."""
    problem = Problem("mass", Mass(), measured({}), held_out=measured({}, seed=1))
    train, test = split(problem, 5, 40)
    assert train.segments.trajectories is problem.trajectories
    assert test.segments.trajectories is problem.held_out
    assert len(train) == len(test) == 40


def test_too_few_windows_are_refused_with_the_number_needed():
    """Twelve steps hold two windows."""
    with pytest.raises(
        BadArgument, match=r"at least 8 windows of 5 steps to fit. Got 1.* about 192 transitions"
    ):
        split(Problem("mass", Mass(), measured({}, episodes=1, steps=12)), 5, 96)


def test_starts_that_were_estimated_have_their_errors():
    """Of both sides; what was measured has the noise's, and where nothing was estimated the search
    finds them all.
    """
    problem = Problem("mass", Mass(), measured({}))
    first, *others = [signal.name for signal in problem.simulator.signals]
    for windows in split(replace(problem, estimated={first: 0.3}), 5, 40):
        np.testing.assert_array_equal(windows.start_sd, [0.3, *[np.inf] * len(others)])
    assert [windows.start_sd for windows in split(problem, 5, 40)] == [None, None]
