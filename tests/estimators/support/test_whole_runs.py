"""When start states are found along whole runs, and when they are not."""

from dataclasses import replace

import numpy as np

from dropo.core.contracts.problem import Problem
from dropo.core.records.trajectories import Trajectories
from dropo.estimators.dropo import DROPO
from dropo.estimators.support.segment_length import ChooseHorizon
from dropo.estimators.support.whole_runs import bound_to_segments, lacks_states, may_follow_runs
from dropo.simulators.toy import SlidingBlock, simulate
from tests.models.hidden_in_arm import instance
from tests.models.hidden_in_arm import problem as arm_problem

TRUTH = np.array([1.5, 0.8])
FORCES = np.repeat(np.random.default_rng(81_000).normal(0, 3, (10, 12, 1)), 5, axis=1)


def problem_of(observations, actions, following, terminals):
    """A sliding block with these data."""
    data = Trajectories(observations, actions.reshape(-1, 1), following, terminals)
    return Problem("block", SlidingBlock(), data)


def moved(forces=FORCES, values=TRUTH):
    """Exact states under forces."""
    return simulate(SlidingBlock(), np.broadcast_to(values, (10, 2)), forces, np.zeros(2))


def test_what_looks_alike_is_not_taken_for_noise():
    """States that were measured exactly stay starts, whatever else is between the rows: forces that
    nobody logged, or parameters drawn anew for each run.
    """
    rng = np.random.default_rng(82_000)
    shaken = moved(FORCES + rng.normal(0, 0.5, FORCES.shape))
    varied = moved(values=TRUTH * np.exp(0.2 * rng.standard_normal((10, 2))))
    for data in (shaken, varied):
        problem = problem_of(data.observations, FORCES, data.next_observations, data.terminals)
        assert may_follow_runs(problem)
        assert DROPO().fit(problem, rng=0).likelihood == "emulated"


def test_problems_that_are_left_as_they_are():
    """Segments of another length, starts that are given, and rows that do not follow."""
    data = moved()
    problem = problem_of(data.observations, FORCES, data.next_observations, data.terminals)
    assert may_follow_runs(problem)
    assert not lacks_states(problem)
    assert not may_follow_runs(problem.using(horizon=5))
    assert not may_follow_runs(replace(problem, reset="start"))
    apart = replace(data, next_observations=data.next_observations + 1e-3, group=None)
    assert not may_follow_runs(replace(problem, trajectories=apart))
    within = replace(problem.trajectories, group=np.arange(len(data)) // 10)
    assert not may_follow_runs(replace(problem, trajectories=within))


def test_horizons_are_chosen_by_one_likelihood():
    """That of segments, also for the horizon of one step."""
    assert ChooseHorizon(DROPO()).estimator.likelihood == "emulated"


def test_effects_on_sensors_and_on_the_time_since_a_start_need_segments():
    """They are named, free or fixed; those of the state and the commands are not. Runs that are too
    short for a span are left as they are.
    """
    arm = arm_problem([], episodes=3, steps=24)
    assert may_follow_runs(arm)
    assert bound_to_segments(arm) == []
    assert bound_to_segments(problem_of(*shortest())) == []
    friction = instance(arm.simulator, "joint_friction:elbow")
    late = instance(arm.simulator, "sensor_delay:qpos.elbow")
    bias = instance(arm.simulator, "sensor_bias:qvel.elbow")
    bound = replace(arm, simulator=arm.simulator.with_effects([friction, late], [(bias, [0.1])]))
    assert bound_to_segments(bound) == [late.label, bias.label]
    assert not may_follow_runs(bound)
    held = replace(arm, simulator=arm.simulator.with_effects([friction]))
    assert may_follow_runs(held)
    assert not may_follow_runs(problem_of(*shortest()))


def shortest():
    """Ten runs of three rows."""
    data = moved(FORCES[:, :3])
    return data.observations, FORCES[:, :3], data.next_observations, data.terminals
