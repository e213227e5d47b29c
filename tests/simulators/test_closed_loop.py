"""A model in closed loop with a policy, many runs at a time."""

import mujoco
import numpy as np

from dropo.problems.hopper.data import (
    hopper_policy,
    observe,
    start_states,
)
from dropo.problems.hopper.model import FRAME_SKIP, hopper_model
from dropo.simulators.mujoco.closed_loop import closed_loop


def test_closed_loop_equals_stepping_by_hand():
    """Against a plain loop over mj_step with the same policy, and field values that change in
    between.
    """
    model = hopper_model()
    policy = hopper_policy()
    rng = np.random.default_rng(5)
    starts = start_states(rng, 2)
    noise = rng.standard_normal((2, 12, 3))
    fields = {"body_mass": model.body_mass * rng.uniform(0.9, 1.1, (2, 3, model.nbody))}
    act = lambda states, ids, step: policy(observe(states), noise[ids, step])
    runs = closed_loop(model, act, starts, 12, frame_skip=FRAME_SKIP, fields=fields, hold=5)
    for i in range(2):
        own = hopper_model()
        state = mujoco.MjData(model)
        state.qpos[:], state.qvel[:] = np.split(starts[i], 2)
        for t in range(12):
            own.body_mass[:] = fields["body_mass"][i, t // 5]
            state.ctrl[:] = policy(np.r_[state.qpos[1:], state.qvel][None], noise[i : i + 1, t])[0]
            np.testing.assert_array_equal(state.ctrl, runs.actions[i, t])
            mujoco.mj_step(own, state, FRAME_SKIP)
            np.testing.assert_array_equal(np.r_[state.qpos, state.qvel], runs.states[i, t + 1])


def test_a_diverging_simulation_ends_and_spoils_no_other():
    """MuJoCo itself would put it back to its initial state and go on."""
    model = hopper_model()
    starts = start_states(np.random.default_rng(6), 2)
    starts[1, 6:] = 1e12
    runs = closed_loop(
        model, lambda states, ids, step: np.zeros((len(ids), 3)), starts, 5, frame_skip=FRAME_SKIP
    )
    np.testing.assert_array_equal(runs.lengths, [5, 0])
    assert np.isfinite(runs.states[0]).all()
    assert np.isnan(runs.states[1, 1:]).all()
    assert np.isnan(runs.actions[1]).all()
