"""The hopper that replays the published transitions, and the data that it gives."""

import mujoco
import numpy as np
import pytest
from mujoco import rollout

from dropo.core.services.errors import BadArgument
from dropo.problems.hopper.data import (
    HopperPolicy,
    healthy,
    simulate,
)
from dropo.problems.hopper.model import BODIES, FRAME_SKIP, TRUTH, hopper_model
from dropo.problems.measured.external_data import find_data

MASSES = np.array(list(TRUTH.values()))


def following(model, observations, actions, masses=MASSES):
    """(N, 11) what MuJoCo's own rollout gives one control step after each observation."""
    model.body_mass[1:] = masses
    starts = np.column_stack(
        [np.zeros((len(observations), 2)), observations]
    )  # time and the distance travelled
    states, _ = rollout.rollout(
        model, mujoco.MjData(model), starts, np.repeat(actions[:, None], FRAME_SKIP, axis=1)
    )
    return states[:, -1, 2:]


@pytest.fixture(scope="module")
def data():
    """1000 transitions of the true hopper."""
    return simulate(rng=0)[0]


def test_truth_is_the_published_masses():
    assert list(TRUTH) == ["torso_mass", "thigh_mass", "leg_mass", "foot_mass"]
    np.testing.assert_allclose(MASSES, [3.534, 3.927, 2.714, 5.089], atol=5e-4)
    np.testing.assert_array_equal([hopper_model().body(body).mass[0] for body in BODIES], MASSES)


@pytest.mark.parametrize(("file", "tolerance"), [("clean.npz", 1e-12), ("noisy-1e-5.npz", 0.03)])
def test_published_transitions_are_reproduced(file, tolerance):
    """All 10,000 to rounding, or within 9 standard deviations where noise of variance 1e-5 was
    added.
    """
    path = find_data(f"hopper-published/{file}")
    if path is None:
        pytest.skip(f"hopper-published/{file} is not at hand (DROPO_DATA)")
    with np.load(path, allow_pickle=False) as kept:
        ours = following(hopper_model(), kept["observations"], kept["actions"])
        assert len(ours) == 10_000
        assert np.abs(ours - kept["next_observations"]).max() < tolerance


def test_another_margin_does_not_replay_the_data(data):
    """The check above can fail: the stock margins alone are noticed."""
    model = hopper_model()
    model.geom_margin[:] = 0.001
    assert (
        np.abs(following(model, data.observations, data.actions) - data.next_observations).max()
        > 1e-3
    )


def test_data_are_the_models_own_transitions(data):
    """In one piece, starting upright, and equal to MuJoCo's rollout from each observation."""
    np.testing.assert_allclose(
        following(hopper_model(), data.observations, data.actions),
        data.next_observations,
        atol=1e-10,
    )
    for start, stop in data.spans:
        np.testing.assert_array_equal(
            data.observations[start + 1 : stop], data.next_observations[start : stop - 1]
        )
        assert np.abs(data.observations[start] - np.eye(1, 11)[0] * 1.25).max() <= 5e-3
    assert len(data) == 1000
    assert np.abs(data.actions).max() <= 1


def test_data_are_the_same_again_and_for_any_number_of_threads(data):
    for threads in (1, 2):
        again, masses = simulate(rng=0, threads=threads)
        np.testing.assert_array_equal(again.next_observations, data.next_observations)
        np.testing.assert_array_equal(masses, np.tile(MASSES, (len(masses), 1)))
    assert not np.array_equal(simulate(rng=1)[0].actions, data.actions)


def test_trajectories_last():
    """Of 20 trajectories of 500 steps at most three fall, and none falls early."""
    many, _ = simulate(500, 20, rng=2)
    lengths = np.array([stop - start for start, stop in many.spans])
    assert len(many) == 10_000
    assert (lengths == 500).sum() >= 17
    assert many.observations[:, 5].mean() > 1.5  # [m/s] it hops forward


def test_contact_and_flight_both_happen(data):
    """Between 15 and 85 % of the observations touch the ground."""
    model = hopper_model()
    state = mujoco.MjData(model)
    touching = 0
    for row in data.observations:
        state.qpos[1:], state.qvel[:] = row[:5], row[5:]
        mujoco.mj_forward(model, state)
        touching += state.ncon > 0
    assert 0.15 < touching / len(data) < 0.85


def test_masses_are_identifiable(data):
    """1000 transitions under noise of variance 1e-5 give each mass to better than 0.02 kg (Cramer
    and Rao).
    """
    model = hopper_model()
    h = 1e-4
    after = lambda masses: following(model, data.observations, data.actions, masses).ravel()
    jacobian = np.column_stack(
        [(after(MASSES + step) - after(MASSES - step)) / (2 * h) for step in h * np.eye(4)]
    )
    errors = np.sqrt(1e-5 * np.diag(np.linalg.inv(jacobian.T @ jacobian)))
    assert (errors < 0.02).all(), errors


def test_masses_change_by_block_and_in_body_mass_alone():
    """Each block of 10 transitions is replayed by its own masses, and by no others."""
    varied, masses = simulate(
        95, 2, rng=3, block=10, masses=lambda rng, n: MASSES * rng.uniform(0.9, 1.1, (n, 4))
    )
    np.testing.assert_array_equal(varied.group, np.repeat(np.arange(20), ([10] * 9 + [5]) * 2))
    assert masses.shape == (20, 4)
    model = hopper_model()
    for g, own in enumerate(masses):
        rows = varied.group == g
        replay = lambda m, rows=rows: following(
            model, varied.observations[rows], varied.actions[rows], m
        )
        np.testing.assert_allclose(replay(own), varied.next_observations[rows], atol=1e-10)
        assert np.abs(replay(masses[g - 1]) - varied.next_observations[rows]).max() > 1e-4


def test_given_masses_are_taken_in_order_and_again():
    rows = MASSES * np.array([[1.0], [1.05], [0.95]])
    _, masses = simulate(20, 2, rng=3, block=10, masses=rows)
    np.testing.assert_array_equal(masses, rows[[0, 1, 2, 0]])
    with pytest.raises(BadArgument, match=r"'masses' of hopper_data.simulate must be positive"):
        simulate(20, 2, rng=3, masses=-MASSES)


def test_noise_is_on_the_next_observations_only(data):
    noisy, _ = simulate(rng=0, noise_variance=1e-5)
    np.testing.assert_array_equal(noisy.observations, data.observations)
    np.testing.assert_array_equal(noisy.actions, data.actions)
    error = (noisy.next_observations - data.next_observations) / np.sqrt(1e-5)
    assert abs(error.var() - 1) < 4.5 * np.sqrt(2 / error.size)
    assert abs(error.mean()) < 4.5 / np.sqrt(error.size)


def test_a_fall_ends_a_trajectory_and_another_is_started():
    """A policy that does nothing falls; every trajectory but the last ends fallen, and the count is
    met.
    """
    idle = HopperPolicy(np.zeros((3, 11)), np.zeros(11), np.ones(11), action_noise=0.1)
    fallen, masses = simulate(200, 3, rng=4, policy=idle, block=50)
    assert len(fallen) == 600
    assert len(fallen.spans) > 3
    ends = fallen.next_observations[fallen.terminals][:-1]
    assert not healthy(np.column_stack([np.zeros(len(ends)), ends])).any()
    assert len(masses) == fallen.group.max() + 1
    assert all(
        len(np.unique(fallen.trajectory[fallen.group == g])) == 1 for g in range(len(masses))
    )
