"""Episodes in a batch are the replays of the simulator itself, whatever else the batch holds."""

from dataclasses import replace

import numpy as np
import pytest

from dropo.core.contracts.effect import EffectInstance, Quantity
from dropo.core.records.trajectories import Trajectories
from dropo.core.services.errors import Incompatible
from dropo.core.services.registry import find
from dropo.problems.hopper.data import start_states
from dropo.problems.hopper.problem import hopper_simulator
from dropo.simulators.mujoco.episodes import Episodes

STEPS = 25
ONE = np.array([1])


@pytest.fixture(scope="module")
def hopper():
    return hopper_simulator(1)


@pytest.fixture(scope="module")
def motion():
    """A start state and commands, some of them beyond the limits."""
    rng = np.random.default_rng(3)
    return start_states(rng, 1), rng.uniform(-1.2, 1.2, (STEPS, 3)) / 3


def replayed(simulator, value, start, commands):
    """(L, p) what the simulator predicts from the start under the commands."""
    rows = np.zeros((len(commands), 11))
    rows[0] = start[0, 1:]
    data = Trajectories(rows, commands, np.zeros_like(rows), np.arange(len(rows)) == len(rows) - 1)
    return simulator.predict(value[None], data.segments(reset="start"))[0]


def run(episodes, ids, value, start, commands):
    """(L, P) the measured rows of one episode in a batch."""
    assert episodes.set(ids, value[None]).all()
    episodes.reset(ids, start)
    out = []
    for command in commands:
        assert episodes.step(ids, command[None]).all()
        out.append(episodes.measured(ids, episodes.rows(ids))[0])
    return np.array(out)


def atom_of(simulator, name, size):
    """The first place of an effect, with that size, or the size at which a screening tries it."""
    instance = next(iter(find("effects", name)(simulator.effect_context)))
    return replace(instance, start=None), np.array(
        [q.probes[-1] if size is None else size for q in instance.quantities]
    )


def test_motion_is_the_replays(hopper, motion):
    """Bit for bit, under other parameters than the model's, and again from the same start in the
    same batch.
    """
    value = hopper.nominal * 1.3
    episodes = Episodes(hopper, 3)
    expected = replayed(hopper, value, *motion)
    first = run(episodes, ONE, value, *motion)
    np.testing.assert_array_equal(first, expected)
    np.testing.assert_array_equal(run(episodes, ONE, value, *motion), expected)
    assert np.abs(first - replayed(hopper, hopper.nominal, *motion)).max() > 0.01, (
        "the control: other masses move otherwise"
    )


@pytest.mark.parametrize(
    ("name", "size"),
    [
        ("actuator_delay", 0.013),
        ("actuator_lag", 0.02),
        ("gear_lash", 0.003),
        ("actuator_saturation", 0.8),
        ("joint_stribeck", None),
        ("joint_load_friction", None),
        ("external_force", None),
        ("body_com", 0.01),
        ("joint_damping", 0.3),
        ("sensor_bias", 0.1),
        ("sensor_gain", 0.1),
    ],
)
def test_effects_act_as_in_the_replays(name, size, hopper, motion):
    """Every layer around the physics, bit for bit; and it acts."""
    there = hopper.with_effects((), [atom_of(hopper, name, size)])
    found = run(Episodes(there, 2), ONE, hopper.nominal, *motion)
    np.testing.assert_array_equal(found, replayed(there, hopper.nominal, *motion))
    assert np.abs(found - replayed(hopper, hopper.nominal, *motion)).max() > 1e-6


def test_late_sensors(hopper, motion):
    """As in the replays from the moment at which the start has arrived; before it, the start is
    seen.
    """
    instance, size = atom_of(hopper, "sensor_delay", 0.0101)
    there = hopper.with_effects((), [(instance, size)])
    episodes = Episodes(there, 2)
    found = run(episodes, ONE, hopper.nominal, *motion)
    np.testing.assert_allclose(
        found[1:], replayed(there, hopper.nominal, *motion)[1:], rtol=0, atol=1e-14
    )
    episodes.reset(ONE, motion[0])
    np.testing.assert_array_equal(episodes.measured(ONE, episodes.rows(ONE)), motion[0][:, 1:])


def test_free_effects_are_parameters(hopper, motion):
    """A size of 0 is absence; another in the same batch acts."""
    instance, size = atom_of(hopper, "actuator_delay", 0.02)
    free = hopper.with_effects([instance])
    episodes = Episodes(free, 2)
    absent, active = (
        run(episodes, ONE, np.append(hopper.nominal, s), *motion) for s in (0.0, size[0])
    )
    np.testing.assert_array_equal(absent, replayed(hopper, hopper.nominal, *motion))
    np.testing.assert_array_equal(active, replayed(free, np.append(hopper.nominal, size), *motion))


def test_threads_and_company_do_not_matter(hopper, motion):
    """An episode beside others that begin at other times, on two threads, is the same alone."""
    start, commands = motion
    episodes = Episodes(hopper, 4, threads=2)
    rng = np.random.default_rng(0)
    values = hopper.nominal * rng.uniform(0.8, 1.2, (4, 4))
    everyone = np.arange(4)
    episodes.set(everyone, values)
    episodes.reset(everyone, np.tile(start, (4, 1)))
    rows = []
    for t, command in enumerate(commands):
        episodes.step(everyone, np.tile(command, (4, 1)))
        rows.append(episodes.rows(np.array([2]))[0])
        if t % 7 == 3:
            episodes.set(np.array([0]), values[1:2])
            episodes.reset(np.array([0]), start)
    np.testing.assert_array_equal(rows, replayed(hopper, values[2], start, commands))


def test_divergence_is_noticed(hopper):
    """A start beyond what MuJoCo can handle is not sound; its neighbour is."""
    episodes = Episodes(hopper, 2)
    both = np.arange(2)
    episodes.set(both, np.tile(hopper.nominal, (2, 1)))
    starts = np.tile(start_states(np.random.default_rng(0), 1), (2, 1))
    starts[0, 6:] = 1e9
    episodes.reset(both, starts)
    sound = [episodes.step(both, np.zeros((2, 3))) for _ in range(3)][-1]
    assert sound.tolist() == [False, True]


def test_recorded_forces_are_refused(hopper):
    """What is known for recorded motion alone has no place in a new episode."""
    pushed = EffectInstance(
        "push",
        None,
        (Quantity("size", "N", 0.0, 1.0, (0.5,)),),
        applied_force=lambda steps, magnitudes: np.zeros((steps, 6)),
    )
    with pytest.raises(Incompatible, match="recorded motion alone"):
        Episodes(hopper.with_effects([pushed]), 1)
