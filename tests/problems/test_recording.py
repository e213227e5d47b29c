"""Recorded data: true states go on as they are, whatever the sensors make of them."""

import numpy as np
import pytest

from dropo.problems.simulated.recording import record
from dropo.problems.simulated.robots import machine
from tests.models.hidden_in_arm import instance

ARM = simulated_robot("torque-arm")
STEPS = 20
EPISODES = 6


def recorded(*hidden, noise=0.0):
    """Measurements (E, 1 + T, p) of the arm under random commands that answer to nothing, with
    effects (label, size).
    """
    effects = [(instance(ARM.simulator, label), np.array([size])) for label, size in hidden]
    rng = np.random.default_rng(0)
    data = record(
        ARM.simulator,
        effects,
        np.zeros(0),
        ARM.starts(rng, EPISODES),
        lambda rows, push: 0.6 * push,
        STEPS,
        actions=2,
        noise=noise,
        alive=ARM.alive,
        rng=rng,
        memory=0.8,
    )
    before, after = (
        rows.reshape(EPISODES, STEPS, 4) for rows in (data.observations, data.next_observations)
    )
    assert np.array_equal(before[:, 1:], after[:, :-1])
    return np.concatenate([before[:, :1], after], axis=1)


def test_what_acts_on_the_machine_changes_its_motion():
    """Damping does, a sensor does not: the control that the next tests need."""
    assert np.abs(recorded(("joint_damping:elbow", 0.1)) - recorded())[:, -1].max() > 0.1


@pytest.mark.parametrize("steps", [1, 2])
def test_a_late_sensor_shows_what_was_there_before(steps):
    """A velocity that comes whole control steps late is the prompt one of so many steps before, to
    rounding, the start until then; the other signals stay.
    """
    late = recorded(("sensor_delay:qvel.elbow", steps * ARM.simulator.control_step))
    prompt = recorded()
    np.testing.assert_allclose(
        late[:, steps:, 3], prompt[:, : STEPS + 1 - steps, 3], rtol=1e-9, atol=1e-12
    )
    assert np.array_equal(late[:, 0], prompt[:, 0])
    assert np.array_equal(late[..., :3], prompt[..., :3])
    assert np.abs(late - prompt)[..., 3].max() > 0.1


def test_a_biased_sensor_shows_its_bias():
    """From the start on; the motion is the same, and the noise is added to what is shown."""
    biased = recorded(("sensor_bias:qpos.elbow", 0.07), noise=1e-3)
    prompt = recorded(noise=1e-3)
    np.testing.assert_allclose(
        biased - prompt, np.broadcast_to([0, 0.07, 0, 0], prompt.shape), atol=1e-12
    )
