"""Networks of stable-baselines3: the thesis' sizes, trained a little, resumed, kept as files."""

from functools import partial

import numpy as np
import pytest

from dropo.core.records.task import Task
from dropo.core.services.errors import Incompatible
from dropo.training import networks
from dropo.training.evaluate import evaluate
from dropo.training.networks import PPO, SAC
from dropo.training.policy import load_policy
from dropo.training.train import train
from tests.models.cart_task import STEPS, aside, cart, fit_of, near

pytest.importorskip("stable_baselines3", reason="stable-baselines3 is not installed")
ALGORITHMS = {"sac": SAC(steps=180, every=90), "ppo": PPO(steps=4096, count=1, every=2048)}
SIZES = {
    "sac": [(256, 2), (256, 256), (1, 256), (1, 256)],
    "ppo": [(128, 2), (128, 128), (128, 2), (128, 128), (1, 128), (1, 128)],
}


@pytest.fixture(scope="module")
def problem():
    return cart()


@pytest.mark.parametrize("name", ["sac", pytest.param("ppo", marks=pytest.mark.study)])
def test_trained_resumed_and_kept(name, problem, tmp_path):
    """With the thesis' layers; an interrupted training goes on with the steps that are left; the
    file acts the same.
    """
    distribution = fit_of(problem.space, [2.0, 0.5], [0.2, 0.05], epsilon=1e-6)
    algorithm = ALGORITHMS[name]
    seen = []

    def stop(fraction, text):
        if fraction > 0.8:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train(problem, distribution, algorithm, out=tmp_path, progress=stop)
    policy = train(
        problem,
        distribution,
        algorithm,
        out=tmp_path,
        progress=lambda fraction, text: seen.append(fraction),
    )
    assert seen[0] > 0.5, "the first half is not done again"
    assert policy.about["control_steps"] == algorithm.steps
    network = policy.model.policy.actor if name == "sac" else policy.model.policy
    assert [tuple(p.shape) for p in network.parameters() if p.ndim == 2] == SIZES[name]
    assert (policy.mean is None) == (name == "sac")
    path = policy.save(tmp_path / "kept")
    assert {p.name for p in path.parent.iterdir()} == {"policy.json", "policy.zip"}
    found = evaluate(policy, problem, episodes=3)
    np.testing.assert_array_equal(
        found.returns, evaluate(load_policy(path.parent), problem, episodes=3).returns
    )
    assert set(found.lengths) == {STEPS}


@pytest.mark.study
def test_ppo_learns():
    """More return at the end than at the beginning of its training, by three standard errors."""
    rewarded = cart(Task(near, aside, steps=STEPS))
    early, late = (train(rewarded, None, PPO(steps=steps, count=4), rng=0) for steps in (1, 16384))
    gained = (
        evaluate(late, rewarded, episodes=40).returns
        - evaluate(early, rewarded, episodes=40).returns
    )
    assert gained.mean() > 3 * gained.std() / np.sqrt(40)


def test_ppo_has_the_thesis_layers(problem, monkeypatch):
    """And the policy keeps how observations are normalised."""
    made = networks._algorithms()
    short = partial(made["ppo"], n_steps=64, n_epochs=1)
    monkeypatch.setattr(networks, "_algorithms", lambda: {**made, "ppo": short})
    policy = train(problem, None, PPO(steps=1, count=1))
    assert [tuple(p.shape) for p in policy.model.policy.parameters() if p.ndim == 2] == SIZES["ppo"]
    assert policy.mean is not None


def test_actions_without_limits_are_refused():
    with pytest.raises(Incompatible, match="need limits"):
        train(
            cart(Task(near, aside, steps=5, limits=np.array([[-np.inf], [np.inf]]))),
            None,
            SAC(steps=10),
        )
