"""Randomized environments: Gymnasium's own where nothing is randomized, draws of the fit where
something is, many the same as one.
"""

from dataclasses import replace

import gymnasium
import numpy as np
import pytest
from gymnasium.envs.mujoco.hopper_v5 import HopperEnv
from gymnasium.utils.env_checker import check_env

from dropo.core.records.fits.fit import Fit
from dropo.core.records.parameters import Parameter, ParameterSpace
from dropo.core.records.task import Task
from dropo.core.services.errors import BadArgument, Incompatible, SimulationFailed, UnknownName
from dropo.core.services.registry import find
from dropo.mjmodel.fields import FieldParameter
from dropo.problems.hopper.problem import hopper_simulator
from dropo.simulators.mujoco.simulator import MujocoSimulator
from dropo.training.distributions import Curriculum, Point, Uniform, draw
from dropo.training.environments import randomize
from tests.models.cart_task import aside, cart, fit_of, near, to_goal

pytestmark = pytest.mark.filterwarnings(
    "ignore:.*A Box observation space m.*infinity",
    "ignore:.*Not able to test alternative render modes",
    "ignore:.*is different from the unwrapped version",
)
HOPPER = hopper_simulator(1)
HALF = Uniform(HOPPER.space, HOPPER.nominal * 0.7, HOPPER.nominal * 1.3)


def episode(env, seed, actions):
    """Observations, rewards and ends under actions, until the first end."""
    out = [(env.reset(seed=seed)[0], 0.0, False, False)]
    for action in actions:
        observed, reward, terminated, truncated, _ = env.step(action)
        out.append((np.array(observed), float(reward), bool(terminated), bool(truncated)))
        if terminated or truncated:
            break
    return out


def same(one, other):
    """Whether two episodes are the same, bit for bit."""
    assert len(one) == len(other) > 5
    return all(
        np.array_equal(a[0], b[0]) and a[1:] == b[1:] for a, b in zip(one, other, strict=True)
    )


def one_of(vector, i, seed, actions):
    """Environment i of many, under the same actions as `episode`; the others get other ones."""
    out = [(vector.reset(seed=seed - i)[0][i], 0.0, False, False)]
    for action in actions:
        everyone = np.tile(-action, (vector.num_envs, 1))
        everyone[i] = action
        observed, reward, terminated, truncated, _ = vector.step(everyone)
        out.append((observed[i], float(reward[i]), bool(terminated[i]), bool(truncated[i])))
        if terminated[i] or truncated[i]:
            break
    return out


def actions_for(env, n=40):
    env.action_space.seed(1)
    return [env.action_space.sample() for _ in range(n)]


@pytest.mark.parametrize("name", ["Hopper-v5", "Ant-v5", "Reacher-v5", "Humanoid-v5"])
def test_gymnasium_is_its_own_where_nothing_is_drawn(name):
    """Observations, rewards and ends are those of `gymnasium.make`, bit for bit, alone and among
    others.
    """
    plain = gymnasium.make(name)
    actions = actions_for(plain)
    expected = episode(plain, 7, actions)
    assert same(episode(randomize(name), 7, actions), expected)
    assert same(one_of(randomize(name, count=3), 1, 7, actions), expected)


@pytest.mark.parametrize(
    ("target", "distribution"), [("Hopper-v5", HALF), (cart(), Uniform(cart().space))]
)
def test_many_are_as_one(target, distribution):
    """Under draws and noise an environment among many, on two threads, moves as it does alone;
    another seed draws others.
    """
    single = randomize(target, distribution, noise=1e-3)
    actions = actions_for(single)
    expected = episode(single, 5, actions)
    assert same(
        one_of(randomize(target, distribution, count=4, noise=1e-3, threads=2), 2, 5, actions),
        expected,
    )
    assert not np.array_equal(episode(single, 6, actions[:1])[1][0], expected[1][0])


def test_checked_by_gymnasium():
    """`check_env` finds nothing, of a problem's environment and of Gymnasium's with draws."""
    check_env(randomize(cart(), Uniform(cart().space)), skip_render_check=True)
    check_env(randomize("Hopper-v5", HALF), skip_render_check=True)


def test_draws_are_the_fits():
    """In the model that moves, with the fit's mean, spread and correlation: within 4.5 standard
    errors of 600 draws.
    """
    distribution = fit_of(
        HOPPER.space, HOPPER.nominal, np.full(4, 0.2), correlation=0.8, signals=11
    )
    env = distribution.randomize("Hopper-v5")
    drawn = []
    for seed in range(600):
        parameters = env.reset(seed=seed)[1]["parameters"]
        drawn.append(
            [env.unwrapped.model.body(body).mass[0] for body in ("torso", "thigh", "leg", "foot")]
        )
        assert list(parameters.values()) == drawn[-1]
    drawn = np.array(drawn)
    assert np.all(np.abs(drawn.mean(axis=0) - distribution.mean) < 4.5 * 0.2 / np.sqrt(600))
    assert np.all(np.abs(drawn.std(axis=0) - 0.2) < 4.5 * 0.2 / np.sqrt(1200))
    correlation = np.corrcoef(drawn.T)
    assert abs(correlation[0, 1] - 0.8) < 4.5 * (1 - 0.8**2) / np.sqrt(600)
    assert abs(correlation[0, 2]) < 4.5 / np.sqrt(600)


def test_masses_alone_change():
    """As in the thesis: inertias and derived constants stay, and the fit's draw is all that differs
    from Gymnasium's model.
    """
    env = Point(HOPPER.space, HOPPER.nominal * 1.2)
    made = randomize("Hopper-v5", env)
    made.reset(seed=0)
    plain = gymnasium.make("Hopper-v5").unwrapped.model
    for name in ("body_inertia", "body_invweight0", "dof_damping", "body_subtreemass"):
        np.testing.assert_array_equal(getattr(made.unwrapped.model, name), getattr(plain, name))
    np.testing.assert_allclose(made.unwrapped.model.body_mass[1:], HOPPER.nominal * 1.2)


def test_a_saved_fit_knows_its_places(tmp_path):
    """There and back, the parameters still go where they are in the model."""
    distribution = fit_of(HOPPER.space, HOPPER.nominal, np.full(4, 0.2), signals=11)
    distribution.save(tmp_path)
    back = Fit.load(tmp_path)
    assert not any(isinstance(p, FieldParameter) for p in back.space)
    actions = actions_for(gymnasium.make("Hopper-v5"))
    assert same(
        episode(back.randomize("Hopper-v5"), 3, actions),
        episode(distribution.randomize("Hopper-v5"), 3, actions),
    )


def test_noise_is_what_the_fit_learned():
    """Its variance, within 4.5 standard errors; none where 0 is given; in the observation alone,
    not in the motion.
    """
    distribution = fit_of(cart().space, [2.0, 0.5], [1e-4, 1e-4], epsilon=0.04)
    noisy = distribution.randomize(cart())
    clean = distribution.randomize(cart(), noise=0.0)
    actions = [np.array([0.5])] * 30
    errors = []
    for seed in range(20):
        one = episode(noisy, seed, actions)
        other = episode(clean, seed, actions)
        errors += [a[0] - b[0] for a, b in zip(one, other, strict=True)]
        assert [a[1:] for a in one] == [b[1:] for b in other]
    variance = np.var(errors, axis=0)
    assert np.all(np.abs(variance - 0.04) < 4.5 * 0.04 * np.sqrt(2 / len(errors)))


def test_late_commands_of_an_extended_problem():
    """A fixed effect acts in the problem's environment and, handed over, in Gymnasium's; without it
    the motion is another.
    """
    instance = next(
        a for a in find("effects", "actuator_delay")(HOPPER.effect_context) if a.target is None
    )
    late = [(instance, np.array([0.016]))]
    actions = actions_for(gymnasium.make("Hopper-v5"))
    delayed = [np.zeros(3), np.zeros(3), *actions]
    plain = episode(gymnasium.make("Hopper-v5"), 2, actions)
    found = episode(randomize("Hopper-v5", effects=late), 2, delayed)
    assert not np.array_equal(plain[5][0], found[5][0])
    shifted = episode(
        gymnasium.make("Hopper-v5"),
        2,
        [np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3), *actions],
    )
    np.testing.assert_allclose(
        [row[0] for row in found[:20]], [row[0] for row in shifted[:20]], atol=1e-12
    )
    base = cart()
    instance = next(iter(find("effects", "actuator_delay")(base.simulator.effect_context)))
    extended = replace(
        base, simulator=base.simulator.with_effects((), [(instance, np.array([0.08]))])
    )
    push = [np.array([0.0]), *[np.array([1.0])] * 8]
    one, other = (
        np.array([row[0] for row in episode(randomize(p), 0, push)]) for p in (base, extended)
    )
    np.testing.assert_allclose(other[3:], one[1:-2], atol=0.2)
    np.testing.assert_array_equal(other[:4, 1], np.zeros(4))
    assert np.all(one[2:4, 1] > 0)


def test_a_curriculum_grows():
    """No spread at the start, all of it at the end, in between a fraction; through the same
    environment.
    """
    space = cart().space
    distribution = Curriculum(Uniform(space), 100, start=0.1)
    rng = np.random.default_rng(0)
    spread = [
        np.std([draw(distribution, rng, done)[0] for _ in range(400)])
        for done in (0, 50, 100, 1000)
    ]
    np.testing.assert_allclose(spread, np.array([0.1, 0.55, 1, 1]) * 3 / np.sqrt(12), rtol=0.12)
    env = randomize(cart(), Curriculum(Uniform(space), 60))
    assert env.reset(seed=0)[1]["parameters"] == {"mass": 2.5, "damping": 0.55}
    episode(env, 1, [np.zeros(1)] * 40)
    assert env.reset(seed=2)[1]["parameters"]["mass"] != 2.5


def test_goals_and_own_commands():
    """A goal an episode, seen by the policy and the reward; an action that stands for several
    control steps, in limits of its own.
    """
    goals = lambda rng, n: rng.uniform(-1, 1, (n, 1))
    two = lambda states, actions: np.stack([actions[:, :1], actions[:, 1:]], axis=1)
    task = Task(
        to_goal,
        aside,
        steps=5,
        goals=goals,
        controls=two,
        limits=np.array([[-0.5, -0.5], [0.5, 0.5]]),
    )
    env = randomize(cart(task))
    assert env.observation_space.shape == (3,)
    np.testing.assert_allclose(
        [env.action_space.low, env.action_space.high], [[-0.5] * 2, [0.5] * 2]
    )
    start, _ = env.reset(seed=4)
    seen, reward, terminated, truncated, _ = env.step(np.array([0.3, -0.9]))
    assert seen[2] == start[2] != env.reset(seed=5)[0][2]
    assert reward == -abs(seen[0] - seen[2])
    single = randomize(cart())
    single.reset(seed=4)
    single.batched_env.episodes.reset(np.array([0]), start[None, :2])
    single.step(np.array([0.3]))
    np.testing.assert_array_equal(single.step(np.array([-0.5]))[0], seen[:2])
    assert not terminated
    assert not truncated


def test_draws_that_break_the_simulation():
    """An episode that diverges is cut short, counted, and the next one has another draw; where all
    do, that is an error.
    """

    def flung(rng, n):
        fast = rng.random(n) < 0.5
        return np.column_stack([np.where(fast, 1e9, 0.0), np.where(fast, 1e12, 0.0)])

    task = Task(near, flung, steps=10)
    env = randomize(cart(task))
    ends = []
    for seed in range(20):
        env.reset(seed=seed)
        *_, truncated, info = env.step(np.zeros(1))
        ends.append((truncated, bool(info.get("broken"))))
        assert truncated == ends[-1][1]
    assert 0 < env.batched_env.failures == sum(broken for _, broken in ends) < 20
    weightless = Point(
        ParameterSpace((FieldParameter("m", 0, 9, field="body_mass", element="cart"),)), np.zeros(1)
    )
    simulator = MujocoSimulator(cart().simulator.spec(), weightless.space, frame_skip=4, threads=1)
    made = randomize(replace(cart(), simulator=simulator, truth=None), weightless)
    with pytest.raises(SimulationFailed, match="refused 20 draws in a row"):
        made.reset(seed=0)
    assert made.batched_env.failures == 20


def test_refusals():
    """Each with what is wrong and the way out."""
    bare = Point(ParameterSpace((Parameter("torso_mass", 1.0, 5.0),)), np.array([3.5]))
    with pytest.raises(
        Incompatible, match="does not say where in a model its parameter 'torso_mass' is"
    ):
        randomize("Hopper-v5", bare)
    lacking = ParameterSpace((FieldParameter("tail", 1, 2, field="body_mass", element="tail"),))
    with pytest.raises(Incompatible, match="do not fit 'Hopper-v5': No body called 'tail'"):
        randomize("Hopper-v5", Uniform(lacking))
    with pytest.raises(UnknownName, match="No parameter of the problem 'cart' called 'torso_mass'"):
        randomize(cart(), HALF)
    moved = ParameterSpace(
        (FieldParameter("mass", 1, 4, "kg", field="body_inertia", element="cart", index=0),)
    )
    with pytest.raises(
        Incompatible,
        match=(
            "of another model: its parameter 'mass' has field 'body_inertia' instead of 'body_mass'"
        ),
    ):
        randomize(cart(), Uniform(moved))
    with pytest.raises(Incompatible, match="has no task"):
        randomize(replace(cart(), task=None))
    with pytest.raises(UnknownName, match="Did you mean 'Hopper-v5'"):
        randomize("Hoper-v5")
    with pytest.raises(Incompatible, match="not a MuJoCo one"):
        randomize("CartPole-v1")
    with pytest.raises(Incompatible, match="does not begin with positions and velocities"):
        randomize("Reacher-v5", noise=1e-3)
    with pytest.raises(Incompatible, match="2 variances, and 11 signals"):
        randomize("Hopper-v5", noise=[1e-3, 1e-3])
    with pytest.raises(BadArgument, match="variances of 0 or more"):
        randomize("Hopper-v5", noise=-1.0)
    with pytest.raises(Incompatible, match="there is one"):
        randomize(gymnasium.make("Hopper-v5"), count=2)


def test_an_environment_that_changes_its_actions():
    """It is simulated at its own call, one at a time, with the same numbers."""

    class Halved(HopperEnv):
        def step(self, action):
            return super().step(np.asarray(action) / 2)

    actions = actions_for(gymnasium.make("Hopper-v5"))
    found = episode(randomize(Halved()), 3, actions)
    plain = episode(gymnasium.make("Hopper-v5"), 3, [action / 2 for action in actions])
    assert same(found[: len(plain)], plain)
