"""Policies: found, the same on any number of threads and after an interruption, kept as files, and
evaluated.
"""

import json

import numpy as np
import pytest

from dropo.core.records.task import Task
from dropo.core.services.errors import (
    BadArgument,
    BadFile,
    Incompatible,
    MissingPackage,
    SimulationFailed,
    UnknownName,
)
from dropo.training.ars import ARS, Search
from dropo.training.distributions import Curriculum, Point, Uniform
from dropo.training.evaluate import Compared, evaluate, motion
from dropo.training.policy import LinearPolicy, load_policy
from dropo.training.train import train
from tests.models.cart_task import STEPS, aside, cart, fit_of, near, on_rail

QUICK = ARS(updates=12, directions=8, best=4, step=0.1, size=0.1, trials=8, every=3)


@pytest.fixture(scope="module")
def problem():
    return cart()


@pytest.fixture(scope="module")
def distribution(problem):
    return fit_of(problem.space, [2.0, 0.5], [0.2, 0.05], correlation=0.5, epsilon=1e-6)


@pytest.fixture(scope="module")
def policy(problem, distribution):
    return train(problem, distribution, QUICK, rng=1)


def nothing(problem):
    """A policy that never acts."""
    return LinearPolicy(
        np.zeros((1, 2)), np.zeros(2), np.ones(2), np.array([[-1.0], [1.0]]), {"steps": STEPS}
    )


def same_policy(one, other):
    assert all(
        np.array_equal(getattr(one, name), getattr(other, name))
        for name in ("weights", "mean", "deviation")
    )
    assert one.about["history"] == other.about["history"]
    return True


def test_search_finds_a_policy(problem, distribution, policy):
    """It beats doing nothing by far, on the target and under the fit; a reward that is always the
    same teaches nothing.
    """
    found = evaluate(policy, problem, episodes=50)
    idle = evaluate(nothing(problem), problem, episodes=50)
    better = found.returns - idle.returns  # the same starts
    assert better.mean() > 10 * better.std() / np.sqrt(50)
    assert (
        evaluate(policy, problem, distribution=distribution, episodes=50).mean
        > evaluate(nothing(problem), problem, distribution=distribution, episodes=50).mean
    )
    flat = train(
        cart(Task(lambda before, actions, after: np.zeros(len(after)), aside, steps=STEPS)),
        distribution,
        QUICK,
        rng=1,
    )
    assert np.array_equal(flat.weights, np.zeros((1, 2)))


def test_threads_do_not_matter(problem, distribution, policy):
    assert same_policy(train(problem, distribution, QUICK, rng=1, threads=2), policy)
    assert not np.array_equal(train(problem, distribution, QUICK, rng=2).weights, policy.weights)


@pytest.mark.parametrize("stop_at", [0.2, 0.6])
def test_an_interrupted_search_goes_on(stop_at, problem, distribution, policy, tmp_path):
    """To the same policy, with nothing done twice; what cannot be read is refused."""
    fractions = []

    def stop(fraction, text):
        fractions.append(fraction)
        if fraction > stop_at:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train(problem, distribution, QUICK, rng=1, out=tmp_path, progress=stop)
    again = []
    assert same_policy(
        train(
            problem,
            distribution,
            QUICK,
            rng=1,
            out=tmp_path,
            progress=lambda fraction, text: again.append(fraction),
        ),
        policy,
    )
    assert len(fractions) + len(again) == QUICK.updates
    (tmp_path / "ars.npz").write_bytes(b"broken")
    with pytest.raises(BadFile, match="a search that was interrupted"):
        train(problem, distribution, QUICK, rng=1, out=tmp_path)


def test_the_bonus_does_not_count_in_the_search(distribution):
    """However large, it changes no weight of the last update; trials count it."""
    policies = [
        train(
            cart(Task(near, aside, steps=STEPS, alive=on_rail, bonus=bonus)),
            distribution,
            QUICK,
            rng=3,
        )
        for bonus in (0.0, 1e6)
    ]
    histories = [np.array(p.about["history"]) for p in policies]
    np.testing.assert_array_equal(histories[0][:, :2], histories[1][:, :2])
    np.testing.assert_allclose(histories[1][:, 2] - histories[0][:, 2], 1e6 * STEPS, rtol=1e-6)


def test_observations_are_normalised_by_those_made():
    """Mean and deviation of all rows, as NumPy has them; 1 where nothing varies."""
    search = Search.new(1, 3)
    rng = np.random.default_rng(0)
    parts = [np.column_stack([rng.normal(5, 3, (n, 2)), np.full(n, 7.0)]) for n in (4, 1, 90)]
    for part in parts:
        search.add_observations(part)
    np.testing.assert_allclose(search.mean, np.concatenate(parts).mean(axis=0))
    np.testing.assert_allclose(search.deviation, [*np.concatenate(parts)[:, :2].std(axis=0), 1.0])


def test_files(policy, problem, tmp_path):
    """There and back bit for bit, by the folder or the file; open limits too; anything else is
    refused with what it is.
    """
    assert policy.save(tmp_path) == tmp_path / "policy.json"
    for path in (tmp_path, tmp_path / "policy.json"):
        back = load_policy(path)
        assert same_policy(back, policy)
        assert back.about == json.loads((tmp_path / "policy.json").read_text())["about"]
    np.testing.assert_array_equal(
        evaluate(back, problem, episodes=3).returns, evaluate(policy, problem, episodes=3).returns
    )
    free = LinearPolicy(np.ones((1, 2)), np.zeros(2), np.ones(2), np.array([[-np.inf], [np.inf]]))
    np.testing.assert_array_equal(
        load_policy(free.save(tmp_path / "free.json"))(np.full((1, 2), 50.0)), [[100.0]]
    )
    (tmp_path / "other.json").write_text(
        '{"kind": "linear", "limits": [[-1], [1]], "about": {}, "weights": [[1, 2]], "mean": [0], '
        '"deviation": [1]}'
    )
    for name, got in (
        ("missing.json", "no such file"),
        ("other.json", "must be of shape"),
        ("ars.json", "kind: expected what a run writes, got nothing"),
        ("newer.json", "version: expected .* or older"),
    ):
        (tmp_path / "ars.json").write_text("{}")
        (tmp_path / "newer.json").write_text('{"version": "99.0"}')
        with pytest.raises((BadFile, BadArgument), match=got):
            load_policy(tmp_path / name)


def test_returns(policy, problem):
    """The mean, its standard error and the lengths are those of the episodes; the same seed, the
    same episodes.
    """
    found = evaluate(policy, problem, episodes=40, rng=4)
    assert found.standard_error == pytest.approx(found.returns.std(ddof=1) / np.sqrt(40))
    assert found.to_json()["mean"] == found.mean == found.returns.mean()
    np.testing.assert_array_equal(
        found.returns, evaluate(policy, problem, episodes=40, rng=4, threads=2).returns
    )
    assert not np.array_equal(found.returns, evaluate(policy, problem, episodes=40, rng=5).returns)
    assert set(found.lengths) == {STEPS}
    assert set(evaluate(policy, problem, episodes=3, steps=7).lengths) == {7}
    assert "100%" in str(Compared({"here": found}, ("odd",)))
    assert str(Compared({"here": found}, ("odd",))).endswith("warning: odd")
    assert evaluate(policy, problem, episodes=1).to_json()["standard_error"] is None


def test_the_target_has_its_true_parameters(policy, problem):
    """Those of the problem, where they are known; another distribution replaces them."""
    true = Point(problem.space, np.array([2.0, 0.5]))
    found = evaluate(policy, problem, episodes=5)
    np.testing.assert_array_equal(
        found.returns, evaluate(policy, problem, distribution=true, episodes=5).returns
    )
    other = Point(problem.space, np.array([4.0, 0.5]))
    assert not np.array_equal(
        found.returns, evaluate(policy, problem, distribution=other, episodes=5).returns
    )


def test_a_curriculum(problem, policy):
    """Its width follows the training's steps, across an interruption too; trials and evaluation are
    at its full width.
    """
    distribution = Curriculum(Uniform(problem.space), 10**9)
    found = evaluate(policy, problem, distribution=distribution, episodes=20).returns
    np.testing.assert_array_equal(
        found,
        evaluate(policy, problem, distribution=distribution.distribution, episodes=20).returns,
    )
    narrow = train(problem, distribution, QUICK, rng=1)
    np.testing.assert_allclose(
        narrow.weights,
        train(problem, Point(problem.space, distribution.mean), QUICK, rng=1).weights,
        rtol=1e-4,
    )
    assert not np.allclose(
        narrow.weights, train(problem, distribution.distribution, QUICK, rng=1).weights, rtol=1e-4
    )


def test_motion(policy, problem):
    """An episode to look at, from its start on."""
    qpos, model, step = motion(policy, problem, rng=0)
    assert qpos.shape == (STEPS + 1, 1)
    assert step == pytest.approx(0.04)
    assert abs(qpos[-1, 0]) < abs(qpos[0, 0])
    assert model.nu == 1


def test_broken_episodes_are_run_again(policy):
    """From another draw, and counted; where all break, that is an error with the draw."""

    def flung(rng, n):
        fast = rng.random(n) < 0.5
        return np.column_stack([np.where(fast, 1e9, 0.3), np.where(fast, 1e12, 0.0)])

    found = evaluate(policy, cart(Task(near, flung, steps=5)), episodes=30)
    assert found.failures > 5
    assert np.isfinite(found.returns).all()
    assert f"warning: cart: {found.failures} draws of the parameters broke the simulation" in str(
        found
    )
    never = Task(near, lambda rng, n: np.full((n, 2), 1e12), steps=5)
    with pytest.raises(
        SimulationFailed, match=r"20 episodes in a row, the last under \{'mass': 2\.0"
    ):
        evaluate(policy, cart(never), episodes=2)


def test_refusals(policy, problem):
    with pytest.raises(
        Incompatible, match="takes 2 observations and gives 1 actions, and 'Hopper-v5' has 11 and 3"
    ):
        evaluate(policy, "Hopper-v5")
    wide = LinearPolicy(np.zeros((1, 2)), np.zeros(2), np.ones(2), np.array([[-3.0], [3.0]]))
    with pytest.raises(Incompatible, match=r"lie in \[-3, 3\], and those of 'cart' in \[-1, 1\]"):
        evaluate(wide, problem)
    with pytest.raises(UnknownName, match="Did you mean 'hopper'"):
        evaluate(policy, "hoper")
    with pytest.raises(BadArgument, match="at most directions"):
        ARS(directions=4)
    with pytest.raises(BadArgument, match="'low' of Uniform"):
        Uniform(problem.space, [3.0, 0.2], [2.0, 0.3])


def test_a_missing_extra_says_how_to_get_it(problem, monkeypatch):
    from dropo.core.services import optional_dependencies
    from dropo.training.networks import PPO, SAC

    monkeypatch.setattr(optional_dependencies, "find_spec", lambda name: None)
    for algorithm in (SAC(), PPO()):
        with pytest.raises(MissingPackage, match=r"pip install 'dropo\[rl\]'"):
            train(problem, None, algorithm)


@pytest.mark.study
def test_hopping_is_learned_under_a_fit():
    """Above 1500 in 500 steps of the target; and it still hops in Gymnasium's own Hopper-v5.

    Four minutes of one core.
    """
    from dropo.problems.hopper.problem import hopper

    target = hopper(1)
    distribution = fit_of(
        target.space,
        target.simulator.nominal,
        np.full(4, 0.01),
        epsilon=1e-8,
        signals=11,
        problem="hopper",
    )
    found = train(target, distribution, rng=0, threads=0)
    assert evaluate(found, target).mean > 1500
    assert evaluate(found, "Hopper-v5").mean > 1000  # whose masses and margins are others
