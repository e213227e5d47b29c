"""The block bootstrap: the right spread, whole pieces, and the same draws on any executor."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from dropo.core.contracts.problem import Problem
from dropo.core.records.trajectories import Trajectories
from dropo.core.services.errors import BadArgument
from dropo.estimators.least_squares import LeastSquares
from dropo.evaluation.bootstrap import _pieces, bootstrap, resampled
from dropo.simulators.toy import LinearSimulator, simulate


def line(seed=0, count=30, steps=4, group=True):
    """y = a x with errors of sd 0.1, as a Problem."""
    rng = np.random.default_rng(seed)
    simulator = LinearSimulator(np.array([[[1.0]]]))
    actions = rng.uniform(0.5, 1.5, (count, steps, 1))
    data = simulate(
        simulator, np.full((count, 1), 2.0), actions, np.zeros(1), noise_variance=0.01, rng=rng
    )
    data = (
        data
        if group
        else Trajectories(data.observations, data.actions, data.next_observations, data.terminals)
    )
    return Problem("line", simulator, data)


def test_standard_errors_are_those_of_the_sandwich():
    """100 replications of 30 trajectories: within 30 % (4.5 standard errors of a spread, 32 %) of
    the clustered error.
    """
    problem = line()
    estimator = LeastSquares()
    fit = estimator.fit(problem)
    found = bootstrap(problem, estimator, replications=100, rng=0)
    assert found.means.shape == (100, 1)
    assert found.standard_errors[0] == pytest.approx(fit.mean_se[0], rel=0.3)
    low, high = found.interval()[0]
    assert low < fit.mean[0] < high
    assert high - low == pytest.approx(2 * 1.96 * found.standard_errors[0], rel=0.3)


def test_the_same_draws_on_any_executor():
    """Threads of its own, or an executor with one worker."""
    problem = line()
    with ThreadPoolExecutor(1) as one:
        given = bootstrap(problem, LeastSquares(), replications=4, rng=5, executor=one)
    np.testing.assert_array_equal(
        given.means, bootstrap(problem, LeastSquares(), replications=4, rng=5).means
    )


def test_pieces():
    """Trajectories where there are 20, groups where they are, else blocks of time that overlap and
    stay within a trajectory.
    """
    assert _pieces(line())[1] == "trajectories"
    data = line(count=2, steps=60).trajectories
    grouped = Trajectories(
        data.observations,
        data.actions,
        data.next_observations,
        data.terminals,
        np.repeat(np.arange(24), 5),
    )
    assert _pieces(Problem("grouped", line().simulator, grouped))[1] == "groups"
    blocks, kind = _pieces(line(count=2, steps=60, group=False))
    assert kind == "blocks of 25 transitions"
    assert len(blocks) == 2 * 36
    assert all(len({i // 60 for i in block}) == 1 for block in blocks)


def test_resampled_data_keep_rows_together():
    """Every drawn piece is whole, ends its trajectory, and is a group of its own even where it was
    drawn twice.
    """
    problem = line()
    pieces, _ = _pieces(problem)
    data = resampled(problem.trajectories, pieces, 120, np.random.default_rng(1))
    assert len(data) == 120
    assert len(data.spans) == len(np.unique(data.group)) == 30
    whole = {problem.trajectories.observations[p].tobytes() for p in pieces}
    assert {data.observations[a:b].tobytes() for a, b in data.spans} <= whole


def test_refusals():
    with pytest.raises(BadArgument, match="'replications' of bootstrap must be at least 2"):
        bootstrap(line(), LeastSquares(), replications=1)
