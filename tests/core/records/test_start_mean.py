"""Where a search begins: by name, at values, at another fit's mean."""

import numpy as np
import pytest

import dropo
from dropo.core.services.errors import BadArgument, UnknownName


@pytest.fixture(scope="module")
def problem():
    """The hopper's, few transitions."""
    return dropo.load("hopper").using(transitions=40)


def first_batch(problem, start):
    """What is found with a first batch of evaluations alone."""
    method = dropo.DROPO(likelihood="monte-carlo", draws=4, epsilon=1e-4, budget=10, start=start)
    return method.fit(problem, rng=0)


def test_a_mapping_a_vector_and_a_fit_begin_alike(problem):
    """At their values; what a mapping leaves out begins in the middle of its bounds."""
    space = problem.space
    values = (space.low + space.high) / 2
    values[1] = 0.9 * space.low[1] + 0.1 * space.high[1]
    by_name = first_batch(problem, {space.names[1]: values[1]})
    by_order = first_batch(problem, tuple(values))
    np.testing.assert_array_equal(by_name.phi, by_order.phi)
    assert not np.array_equal(by_name.phi, first_batch(problem, "middle").phi)
    of_fit = first_batch(problem, by_order)
    np.testing.assert_array_equal(of_fit.phi, first_batch(problem, tuple(by_order.mean)).phi)


def test_least_squares_begins_there(problem):
    """One evaluation moves it by less than from the middle."""
    found = dropo.LeastSquares().fit(problem, rng=0)
    near = dropo.LeastSquares(start=found, budget=1).fit(problem, rng=0)
    far = dropo.LeastSquares(budget=1).fit(problem, rng=0)
    error = np.abs(near.mean - found.mean).max()
    assert error < 0.01 * np.abs(far.mean - found.mean).max()


@pytest.mark.parametrize("method", [dropo.DROPO, dropo.LeastSquares, dropo.Posterior])
def test_refusals(problem, method):
    """A name, a parameter, a value and a count that do not fit, with the rule and what was got."""
    with pytest.raises(UnknownName, match="middle"):
        method(start="midle")
    with pytest.raises(BadArgument, match="finite"):
        method(start=(1.0, np.nan))
    name = problem.space.names[0]
    given = {"likelihood": "monte-carlo"} if method is dropo.DROPO else {}
    with pytest.raises(UnknownName, match=name):
        method(start={name[:-1]: 1.0}, **given).fit(problem, rng=0)
    with pytest.raises(BadArgument, match=f"start of {name} must be within its bounds.*got 1000"):
        method(start={name: 1e3}, **given).fit(problem, rng=0)
    with pytest.raises(BadArgument, match="start"):
        method(start=(1.0,), **given).fit(problem, rng=0)
