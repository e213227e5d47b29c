"""An arm strikes a puck: its model moves as it should, and its target is another one."""

import numpy as np
import pytest

from dropo.core.contracts.support.fit_by_name import estimator_for
from dropo.core.services.errors import BadArgument
from dropo.problems.panda.reaching import joint_path
from dropo.problems.panda.sliding import (
    FRAME_SKIP,
    GOALS,
    NOISE,
    STEPS,
    TRUTH,
    record,
    reward,
    sliding,
    sliding_simulator,
    sliding_spec,
    stops,
)
from dropo.problems.panda.strikes import rest

STEP = 0.004  # [s] of control


@pytest.fixture(scope="module")
def model():
    return sliding_spec().compile()


def test_a_pose_out_of_reach_is_refused(model):
    """It says which."""
    with pytest.raises(BadArgument, match=r"pose 0 at .* out of the arm's reach"):
        joint_path(model, "blade", np.array([[2.0, 0, 0]]), np.eye(3)[None], rest(model))


def test_where_the_puck_stops():
    """Farther after a faster strike and with less friction, aside with the direction; friction
    along x does not slow a strike along y.
    """
    simulator = sliding_simulator(1)
    assert len(simulator.space) == 18
    true = simulator.space.vector(TRUTH)
    rough_x = true.copy()
    rough_y = true.copy()
    rough_x[simulator.space.names.index("friction_x")] *= 1.5
    rough_y[simulator.space.names.index("friction_y")] *= 1.5
    ends = stops(
        simulator, [true, rough_x, rough_y], [[0.0, 0.0], [1.5, 0.0], [1.5, 1.0], [1.5, -1.0]]
    )
    assert ends[0, 1, 1] > 1.5 * ends[0, 0, 1]
    assert ends[0, 2, 0] < -0.02 < 0.02 < ends[0, 3, 0]
    np.testing.assert_allclose(ends[1, 1], ends[0, 1], atol=2e-3)
    np.testing.assert_allclose(
        ends[2, 1, 1] / ends[0, 1, 1], 0.72, atol=0.05
    )  # 1 / 1.5, but for the way together with the blade
    assert abs(ends[1, 2, 0]) < 0.95 * abs(ends[0, 2, 0])


def test_the_target_is_another_machine():
    """At its own numbers the model misses the puck's speed by more than noise, for it is seen late,
    and the arm by noise alone.
    """
    problem = sliding(1).using(transitions=STEPS)
    predicted = problem.simulator.predict([problem.space.vector(TRUTH)], problem.segments)[0]
    off = (
        np.sqrt(np.mean((predicted - problem.simulator.targets(problem.segments)) ** 2, axis=0))
        / NOISE
    )
    np.testing.assert_allclose(
        off[:7], 1, atol=4 / np.sqrt(2 * STEPS)
    )  # four standard errors of a standard deviation
    assert off[16:].max() > 2


def test_the_problem():
    """Five strikes from one start, replayed as wholes; the same seed, the same data; the truth and
    the model lie in the box.
    """
    problem = sliding(1)
    assert problem.reset == "start"
    assert len(problem.segments) == 5
    assert len(problem.trajectories) == 5 * STEPS
    starts = problem.segments.starts
    assert (starts == starts[0]).all()
    for values in (problem.space.vector(TRUTH), problem.simulator.nominal):
        assert ((values > problem.space.low) & (values < problem.space.high)).all()
    assert estimator_for(problem, "dropo", {}).likelihood == "linear"
    assert estimator_for(problem, "dropo", {"likelihood": "monte-carlo"}).draws == 60
    again = sliding(1)
    other = sliding(1, seed=1)
    np.testing.assert_array_equal(
        again.trajectories.next_observations, problem.trajectories.next_observations
    )
    assert (other.trajectories.actions != problem.trajectories.actions).any()
    assert (
        problem.simulator.control_step == pytest.approx(STEP) == pytest.approx(FRAME_SKIP * 0.002)
    )


def test_reward_and_goals():
    """The thesis' reward is highest at the goal, and twelve goals lie on a grid."""
    np.testing.assert_allclose(
        reward(np.array([0.0, 0.1])), [-np.log(0.001), -0.01 - np.log(0.011)]
    )
    assert GOALS.shape == (12, 2)
    assert [len(np.unique(GOALS[:, i])) for i in range(2)] == [3, 4]
    with pytest.raises(BadArgument, match="latents"):
        record(np.zeros((2, 3)), np.random.default_rng(0))


def test_latents_may_be_lists():
    """The same data as from an array."""
    of_list = record([[0.5, 0.0]], np.random.default_rng(0))
    of_array = record(np.array([[0.5, 0.0]]), np.random.default_rng(0))
    np.testing.assert_array_equal(of_list.next_observations, of_array.next_observations)
