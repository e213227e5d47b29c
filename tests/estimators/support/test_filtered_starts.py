"""Filtered starts: the exact maximum likelihood where it is known, what they gain, contacts, and
refusals.
"""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.optimize import minimize

from dropo.core.contracts.estimator import Run
from dropo.core.contracts.problem import Problem
from dropo.core.records.parameters import Parameter
from dropo.core.records.trajectories import Trajectories
from dropo.core.services.errors import Incompatible, UnknownName
from dropo.core.services.registry import find
from dropo.estimators.dropo import DROPO
from dropo.estimators.support.filtered_starts import filter_starts
from dropo.simulators.function import FunctionSimulator
from tests.reference.pushes import z_of_mean

DT = 0.1
STIFFNESS = 2.0
DAMPING = 0.5
TRUTH = np.array([STIFFNESS, DAMPING])
EPSILON = np.array([4e-4, 9e-4])  # of every measurement


def matrix(value):
    return np.array([[1.0, DT], [-value[0] * DT, 1 - value[1] * DT]])


def oscillate(value, starts, actions):
    """A driven oscillator by Euler's rule: linear in the state."""
    out = np.empty((*actions.shape[:2], 2))
    state = starts
    for j in range(actions.shape[1]):
        state = state @ matrix(value).T + np.array([0, DT]) * actions[:, j]
        out[:, j] = state
    return out


def oscillator(seed, *, trajectories=4, steps=60, **settings):
    """Every state measured once, with noise, as the end of one transition and the next's start."""
    rng = np.random.default_rng(seed)
    actions = np.repeat(rng.normal(0, 2, (trajectories, steps // 5, 1)), 5, axis=1)
    start = rng.normal(0, 1, (trajectories, 2))
    states = np.concatenate([start[:, None], oscillate(TRUTH, start, actions)], axis=1)
    rows = states + np.sqrt(EPSILON) * rng.standard_normal(states.shape)
    ends = np.tile(np.arange(steps) == steps - 1, trajectories)
    data = Trajectories(
        rows[:, :-1].reshape(-1, 2), actions.reshape(-1, 1), rows[:, 1:].reshape(-1, 2), ends
    )
    simulator = FunctionSimulator(
        oscillate, [Parameter("stiffness", 0.5, 5), Parameter("damping", 0.05, 2)], ["x", "v"]
    )
    return Problem("oscillator", simulator, data, epsilon=EPSILON, **settings)


def exact(problem):
    """The maximum of the Kalman filter's likelihood: the textbook recursion, on its own."""
    data = problem.trajectories
    noise = np.diag(EPSILON)

    def cost(value):
        total = 0.0
        a = matrix(value)
        for first, last in data.spans:
            state = data.observations[first]
            known = noise
            for t in range(first, last):
                state = a @ state + np.array([0, DT]) * data.actions[t]
                known = a @ known @ a.T
                spread = known + noise
                off = data.next_observations[t] - state
                total += off @ np.linalg.solve(spread, off) + np.linalg.slogdet(spread)[1]
                gain = known @ np.linalg.inv(spread)
                state = state + gain @ off
                known = known - gain @ known
        return total / 2

    return minimize(cost, TRUTH, method="Nelder-Mead", options={"xatol": 1e-6, "fatol": 1e-8}).x


@cache
def fits(starts, seed=0):
    segments = DROPO(likelihood="emulated", starts=starts, start_noise=True, family="point")
    return segments.fit(oscillator(seed))


def test_it_is_the_exact_maximum_likelihood_where_the_motion_is_linear():
    """Within a twentieth of a standard error of the Kalman filter's own; propagated start noise
    alone is beyond a whole one.
    """
    for seed in range(2):
        best = exact(oscillator(seed))
        fit = fits("filtered", seed)
        assert (np.abs(z_of_mean(fit, best)) < 0.05).all(), str(fit)
        assert (np.abs(z_of_mean(fit, TRUTH)) < 4.5).all(), str(fit)
    off = [
        np.abs(fits("measured", seed).mean - exact(oscillator(seed)))
        / fits("filtered", seed).mean_se
        for seed in range(2)
    ]
    assert np.max(off) > 1


def test_errors_shrink():
    """Standard errors are less than half of those from measured starts: the whole past is in a
    state.
    """
    assert (fits("filtered").mean_se < 0.5 * fits("measured").mean_se).all()
    turns = fits("filtered").start_filter.moves
    assert turns[-1] < 0.05
    assert fits("filtered").start_filter.resets == 0


@pytest.mark.parametrize("length", [1, 4])
def test_innovations_are_white(length):
    """At the truth, residuals of neighbouring segments from filtered starts do not correlate; from
    measured starts they do.

    240 / length rows: a correlation has the standard error 1 / sqrt(240 / length).
    """
    problem = oscillator(5).using(horizon=length)
    seen, added, states = filter_starts(
        problem, Run(problem, np.random.default_rng(0)), TRUTH, np.zeros((2, 2)), EPSILON
    )
    after = {
        name: problem.simulator.targets(p.segments)
        - p.simulator.predict(TRUTH[None], p.segments)[0]
        for name, p in {"filtered": seen, "measured": problem}.items()
    }
    together = lambda r: (
        np.array([np.corrcoef(r[:-1, j], r[1:, j])[0, 1] for j in range(2)]) * np.sqrt(len(r))
    )
    assert (np.abs(together(after["filtered"])) < 4).all()
    if length == 1:
        assert np.abs(together(after["measured"])).max() > 5
    size = np.mean(after["filtered"] ** 2, axis=0) / np.mean(
        np.einsum("rpp->rp", added) + EPSILON, axis=0
    )
    np.testing.assert_allclose(size, 1, atol=4.5 * np.sqrt(2 * length / 240))
    assert states.resets == 0


def test_an_innovation_that_is_too_large_begins_anew():
    """A jump of the state by 1, fifty standard deviations, which no model explains: the filter
    takes the measurement.
    """
    problem = oscillator(6, trajectories=1)
    data = problem.trajectories
    before = data.observations.copy()
    after = data.next_observations.copy()
    before[30:, 0] += 1.0
    after[29:, 0] += 1.0
    kicked = replace(
        problem, trajectories=replace(data, observations=before, next_observations=after)
    )
    _, _, states = filter_starts(
        kicked, Run(kicked, np.random.default_rng(0)), TRUTH, np.zeros((2, 2)), EPSILON
    )
    assert states.resets >= 1
    assert (states.offsets[30] == 0).all()
    np.testing.assert_array_equal(states.covariance[30], np.diag(EPSILON))
    assert (states.offsets[29] != 0).any()


def test_two_measurements_of_one_state_are_both_used():
    """Where the next start was measured once more, the state's covariance is what three sources of
    information give.
    """
    problem = oscillator(7, trajectories=1)
    data = problem.trajectories
    rng = np.random.default_rng(0)
    twice = replace(
        data,
        observations=data.observations
        + np.sqrt(EPSILON) * rng.standard_normal(data.observations.shape),
    )
    once = filter_starts(problem, Run(problem, rng), TRUTH, np.zeros((2, 2)), EPSILON)[2]
    problem = replace(problem, trajectories=twice)
    both = filter_starts(problem, Run(problem, rng), TRUTH, np.zeros((2, 2)), EPSILON)[2]
    noise = np.linalg.inv(np.diag(EPSILON))
    predicted = matrix(TRUTH) @ np.diag(EPSILON) @ matrix(TRUTH).T
    np.testing.assert_allclose(
        once.covariance[1], np.linalg.inv(np.linalg.inv(predicted) + noise), rtol=1e-6
    )
    np.testing.assert_allclose(
        both.covariance[1], np.linalg.inv(np.linalg.inv(predicted) + 2 * noise), rtol=1e-6
    )


def test_refusals():
    with pytest.raises(UnknownName, match="No starts called 'smoothed'"):
        DROPO(starts="smoothed")
    with pytest.raises(
        Incompatible, match="Filtered starts need segments that start from a measured state"
    ):
        DROPO(starts="filtered").fit(replace(oscillator(0), reset="start"))
    with pytest.raises(Incompatible, match="'monte-carlo' takes no filtered starts"):
        DROPO(starts="filtered", likelihood="monte-carlo").fit(oscillator(0))
    with pytest.raises(Incompatible, match="RandomEffects takes no filtered starts"):
        DROPO(starts="filtered", likelihood="random-effects").fit(oscillator(0))
    assert find("methods", "dropo")().starts == "measured"
