"""The benchmark runs, its slow twin agrees with the fast likelihood, and `predict` costs little beside bare rollout."""

import time

import numpy as np
import pytest

from benchmarks.objective import EPSILON, TINY, Bare, Sizes, draws_near_truth, predict_beside_bare, problem_of, report
from dropo.likelihoods.gaussian import Gaussian
from dropo.problems.hopper_model import BODIES, FRAME_SKIP
from tests.reference.published_loop import log_likelihood

SMALL = Sizes(draws=5, transitions=40, loop_draws=5, loop_transitions=5, predict_draws=5, repeats=1, predict_repeats=1)


def test_loop_and_likelihood_are_the_same_number():
    """What is timed on both sides is the same work: the same log-likelihood to 1e-9, the same steps."""
    problem = problem_of(SMALL, 1)
    masses = draws_near_truth(problem, 20)
    total, steps = log_likelihood(problem.simulator.model, BODIES, masses, problem.trajectories, EPSILON, FRAME_SKIP)
    predictions = problem.simulator.predict(masses, problem.segments)
    rows = Gaussian().log_density(predictions, problem.simulator.targets(problem.segments), EPSILON)
    assert total == pytest.approx(rows.sum(), rel=1e-9)
    assert steps == problem.simulator.steps == 20 * 40 * FRAME_SKIP


def test_bare_rollout_does_the_same_work():
    """The bare call ends in the states that `predict` compares."""
    problem = problem_of(SMALL, 1)
    values = draws_near_truth(problem, 1)
    bare = Bare(problem.simulator, problem.segments, values, 1)
    states, _ = bare.rollout.rollout(bare.models[0], bare.data, bare.states, bare.controls)
    np.testing.assert_array_equal(states[:, -1, 2:], problem.simulator.predict(values, problem.segments)[0])


def test_predict_keeps_most_of_the_bare_throughput():
    """With one thread, at least 0.8 of bare rollout's steps per second of processor time, in the median of nine."""
    sizes = Sizes(transitions=TINY.transitions, predict_draws=TINY.predict_draws, predict_repeats=9)
    *_, ratio = predict_beside_bare(sizes, 1, clock=time.process_time)
    assert ratio >= 0.8


def test_report_has_every_line():
    """One run prints the whole table and the three sentences below it."""
    text = report(SMALL)
    for words in ("published loop, Python", "monte-carlo, 1 thread", "monte-carlo, 2 threads", "bare rollout, K = 5, 2 threads",
                  "of bare rollout with 1 thread.", "of bare rollout with 2 threads.", "times fewer than the"):  # fmt: skip
        assert words in text
