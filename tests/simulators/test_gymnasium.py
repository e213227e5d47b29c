"""Gymnasium's MuJoCo environments by their id, against their own `step`."""

import gymnasium
import mujoco
import numpy as np
import pytest

from dropo.core.records.trajectories import Trajectories
from dropo.core.services.errors import Incompatible, UnknownName
from dropo.mjmodel.fields import FieldParameter
from dropo.mjmodel.warnings import suppress_mujoco_warnings
from dropo.simulators.gymnasium import GymnasiumSimulator
from dropo.testing import check_simulator


def environment(env_id):
    """The environment itself."""
    with suppress_mujoco_warnings():
        return gymnasium.make(env_id).unwrapped


def visited(env, skipped, count=60):
    """(N, nq + nv) states of a random walk, as far as an observation tells them (skipped positions
    are 0), and (N, nu) actions.
    """
    env.reset(seed=0)
    states = []
    rng = np.random.default_rng(0)
    actions = rng.uniform(-1, 1, (count, env.model.nu))
    for action in actions:
        states.append([*env.data.qpos, *env.data.qvel])
        env.step(action)
    states = np.array(states)
    states[:, :skipped] = 0.0
    return states, actions


def simulated(env_id, torso, skipped, value, warm=False):
    """Predictions of one transition with a relative torso mass, and what `env.step` makes of the
    same state.
    """
    env = environment(env_id)
    states, actions = visited(env, skipped)
    env.model.opt.disableflags |= 0 if warm else mujoco.mjtDisableBit.mjDSBL_WARMSTART
    env.model.body(torso).mass *= value
    after = []
    for state, action in zip(states, actions, strict=True):
        env.set_state(state[: env.model.nq], state[env.model.nq :])
        env.step(action)
        after.append([*env.data.qpos, *env.data.qvel])
    mass = FieldParameter(
        "mass", 0.5, 2.0, field="body_mass", element=torso, relative=True, derived=False
    )
    simulator = GymnasiumSimulator(env_id, [mass], threads=2)
    rows = states[:, skipped:]
    segments = Trajectories(
        rows, actions, np.array(after)[:, skipped:], np.arange(len(rows)) == len(rows) - 1
    ).segments()
    return (
        simulator.predict([[value]], segments)[0],
        simulator.targets(segments),
        simulator,
        segments,
    )


@pytest.mark.parametrize("env_id", ["Hopper-v5", "HalfCheetah-v5"])
@pytest.mark.parametrize("value", [1.0, 1.3])
def test_predictions_are_the_environments_own(env_id, value):
    """60 transitions of a random walk agree with set_state and step to 1e-10, without warm starts;
    at 1.01 times the mass they do not.
    """
    found, own, simulator, segments = simulated(env_id, "torso", 1, value)
    np.testing.assert_allclose(found, own, rtol=0, atol=1e-10)
    assert np.abs(simulator.predict([[1.01 * value]], segments)[0] - own).max() > 1e-4


@pytest.mark.parametrize("env_id", ["Hopper-v5", "HalfCheetah-v5"])
def test_warm_starts_matter_little(env_id):
    """An environment that carries the contact forces of its last step into the next differs by less
    than 1e-6.
    """
    found, own, *_ = simulated(env_id, "torso", 1, 1.3, warm=True)
    np.testing.assert_allclose(found, own, rtol=0, atol=1e-6)


def test_names_are_the_models():
    """The hopper's columns: all positions but the travelled distance, then velocities."""
    simulator = GymnasiumSimulator("Hopper-v5", [])
    assert [signal.name for signal in simulator.signals][:3] == [
        "qpos.rootz",
        "qpos.rooty",
        "qpos.thigh_joint",
    ]
    assert len(simulator.signals) == 11
    assert simulator.control_step == pytest.approx(0.008)


def test_keeps_to_the_contract():
    """The checks that plug-in authors call are silent."""
    _, _, simulator, segments = simulated("Hopper-v5", "torso", 1, 1.0)
    check_simulator(simulator, segments)


def test_options_go_to_the_environment():
    """An environment that shows its first position is observed with it; another frame skip is taken
    over.
    """
    simulator = GymnasiumSimulator(
        "Hopper-v5", [], exclude_current_positions_from_observation=False, frame_skip=2
    )
    assert len(simulator.signals) == 12
    assert simulator.frame_skip == 2


def test_a_rotation_is_compared_by_three_numbers():
    """The ant's 27 columns of positions and velocities are 26 signals, its orientation in the
    torso's frame.
    """
    simulator = GymnasiumSimulator("Ant-v5", [])
    names = [signal.name for signal in simulator.signals]
    assert (len(simulator.layout), len(names)) == (27, 26)
    assert names[:4] == ["qpos.root[2]", "qpos.root.rx", "qpos.root.ry", "qpos.root.rz"]


def test_writes_no_log(tmp_path, monkeypatch, capfd):
    """Some of Gymnasium's models use deprecated MJCF: MuJoCo's log of that does not land in the
    user's folder.
    """
    monkeypatch.chdir(tmp_path)
    GymnasiumSimulator("HalfCheetah-v5", [])
    assert list(tmp_path.iterdir()) == []
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(
    ("env_id", "error", "words"),
    [
        (
            "CartPole-v1",
            Incompatible,
            (
                "The environment 'CartPole-v1' is not a MuJoCo one. Use EnvSimulator with a "
                "function that sets its state."
            ),
        ),
        (
            "Reacher-v5",
            Incompatible,
            "The observation of 'Reacher-v5' does not hold positions and velocities as they are."
            " Give observation=['qpos', 'qvel'], and data with these columns.",
        ),
        (
            "Hoper-v5",
            UnknownName,
            "No Gymnasium environment called 'Hoper-v5'. Did you mean 'Hopper-v5'?",
        ),
        (
            "Hopper-v99",
            UnknownName,
            "No Gymnasium environment called 'Hopper-v99'. Did you mean 'Hopper-v5'?",
        ),
        (
            "hopper v5",
            UnknownName,
            "No Gymnasium environment called 'hopper v5'. Did you mean 'Hopper-v5'?",
        ),
        (
            "Hopper-v2",
            Incompatible,
            "The environment 'Hopper-v2' cannot be made here: The mujoco v2 and v3 based "
            "environments have been moved to the gymnasium-robotics "
            "project (https://github.com/Farama-Foundation/gymnasium-robotics).",
        ),
    ],
)
def test_refusals(env_id, error, words):
    """The message gives the reason and the way out, or the nearest id."""
    with pytest.raises(error) as caught:
        GymnasiumSimulator(env_id, [])
    assert str(caught.value) == words


def test_any_environment_by_its_state():
    """Reacher observes cosines; with the columns given, its model is replayed like any other
    (1e-10).
    """
    damping = FieldParameter("damping", 0.1, 2.0, field="dof_damping", element="joint0")
    simulator = GymnasiumSimulator("Reacher-v5", [damping], observation=["qpos", "qvel"])
    env = gymnasium.make("Reacher-v5").unwrapped
    env.reset(seed=0)
    env.model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_WARMSTART
    rows = [np.concatenate([env.data.qpos, env.data.qvel])]
    actions = np.random.default_rng(0).uniform(-1, 1, (20, 2))
    for action in actions:
        env.step(action)
        rows.append(np.concatenate([env.data.qpos, env.data.qvel]))
    data = Trajectories(rows[:-1], actions, rows[1:], np.arange(20) == 19)
    np.testing.assert_allclose(
        simulator.predict([simulator.nominal], data.segments())[0], rows[1:], atol=1e-10
    )
    env.close()
