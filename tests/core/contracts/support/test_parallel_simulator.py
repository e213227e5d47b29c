"""Simulations shared out among an executor's workers are the same numbers, bit for bit."""

import multiprocessing
import pickle
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor

import numpy as np
import pytest

from dropo.core.contracts.support.parallel_simulator import ParallelSimulator
from dropo.core.services.errors import BadArgument, Incompatible
from dropo.estimators.least_squares import LeastSquares
from dropo.problems.hopper.problem import hopper
from dropo.problems.simulated.slide import slide


class Late(type(slide().simulator)):
    """Its starts are off by its first parameter, and its first segment begins in a contact."""

    def extra_start_sd(self, value, segments):
        return np.full((len(segments), len(self.signals)), value[0])

    def in_contact(self, segments):
        return np.arange(len(segments)) == 0


@pytest.fixture(scope="module")
def processes():
    """Two processes of their own, spawned: nothing is shared by accident."""
    with ProcessPoolExecutor(2, mp_context=multiprocessing.get_context("spawn")) as pool:
        yield pool


def points(problem, count=5):
    """(K, d) points of the problem's box."""
    return problem.space.from_unit(np.random.default_rng(0).random((count, len(problem.space))))


@pytest.mark.parametrize(
    "make", [slide, lambda: hopper(threads=1).using(transitions=20)], ids=["slide", "hopper"]
)
def test_processes_give_the_same_predictions(make, processes):
    """Every bit, also where a start is moved, and the same steps are counted; the control: other
    parameters differ.
    """
    problem = make()
    values = points(problem)
    shape = (5, len(problem.segments), problem.simulator.start_size)
    offsets = 1e-3 * np.random.default_rng(1).standard_normal(shape)
    spread = problem.using(executor=processes)
    for given in (None, offsets):
        alone, shared = (
            p.simulator.predict(values, p.segments, offsets=given) for p in (problem, spread)
        )
        np.testing.assert_array_equal(alone, shared)
    assert problem.simulator.steps == spread.simulator.steps > 0
    assert (spread.simulator.predict(values[::-1], spread.segments) != alone).any()


def test_fits_are_the_same(processes):
    """A whole fit: the same means, standard errors and steps."""
    problem = slide()
    alone, shared = (
        LeastSquares().fit(p, rng=0) for p in (problem, problem.using(executor=processes))
    )
    np.testing.assert_array_equal(alone.mean, shared.mean)
    np.testing.assert_array_equal(alone.mean_se, shared.mean_se)
    assert alone.simulator_steps == shared.simulator_steps


def test_threads_and_a_pickled_problem():
    """Threads are an executor too; a problem comes back from pickle with read-only data and the
    same predictions.
    """
    problem = hopper(threads=1).using(transitions=10)
    again = pickle.loads(pickle.dumps(problem))
    assert not again.trajectories.observations.flags.writeable
    with ThreadPoolExecutor(2) as pool:
        ways = [
            p.simulator.predict(points(problem), p.segments)
            for p in (problem, again, problem.using(executor=pool))
        ]
    np.testing.assert_array_equal(ways[0], ways[1])
    np.testing.assert_array_equal(ways[0], ways[2])


def test_what_is_asked_of_the_simulator_itself():
    """What needs no simulation is answered by the simulator, not by the contract's default."""

    segments = slide().segments
    with ThreadPoolExecutor(1) as pool:
        parallel = ParallelSimulator(Late(), pool)
        assert np.all(parallel.extra_start_sd(np.array([0.25]), segments) == 0.25)
        assert parallel.in_contact(segments).sum() == 1


def test_refusals():
    """No parts, and simulators whose gradients would be lost on the way."""

    class WithGradients(type(slide().simulator)):
        has_gradients = True

    with ThreadPoolExecutor(1) as pool:
        with pytest.raises(BadArgument, match="'parts' of ParallelSimulator must be at least 1"):
            ParallelSimulator(slide().simulator, pool, parts=0)
        with pytest.raises(Incompatible, match="Use it without an executor"):
            ParallelSimulator(WithGradients(), pool)
