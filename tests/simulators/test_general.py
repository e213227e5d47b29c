"""Simulators that replay one segment at a time: a Python function, and a gymnasium.Env whose state
can be set.
"""

import gymnasium
import mujoco
import numpy as np
import pytest

from dropo.core.records.parameters import Parameter
from dropo.core.records.trajectories import Signal, Trajectories
from dropo.core.services.errors import BadArgument
from dropo.simulators.function import EnvSimulator, FunctionSimulator
from dropo.testing import check_simulator
from tests.models.cases import CUTS

RATE = [Parameter("rate", 0.5, 2.0, "1/s"), Parameter("gain", 0.5, 2.0)]


def decay(value, starts, actions):
    """x_{t+1} = x_t exp(-rate / 10) + gain u, both signals alike."""
    state = starts
    out = []
    for action in np.moveaxis(actions, 1, 0):
        state = state * np.exp(-value[0] / 10) + value[1] * action
        out.append(state)
    return np.stack(out, axis=1)


def data(width=2, actions=1, seed=0):
    """Three trajectories of 8, 6 and 4 unrelated rows."""
    rng = np.random.default_rng(seed)
    ends = np.isin(np.arange(18), [7, 13, 17])
    return Trajectories(*(rng.normal(size=(18, n)) for n in (width, actions, width)), ends)


def cut_of(trajectories, cut):
    """The trajectories in one of the ways of CUTS; `partial` sets the first column alone."""
    columns = (
        {"set_columns": np.arange(trajectories.observations.shape[1]) == 0}
        if "partial" in cut
        else {}
    )
    return trajectories.segments(**CUTS[cut], **columns)


@pytest.mark.parametrize("cut", CUTS)
def test_a_function_keeps_to_the_contract(cut):
    """The checks that plug-in authors call are silent."""
    check_simulator(FunctionSimulator(decay, RATE, ["a", "b"]), cut_of(data(), cut))


def test_a_chain_goes_on_from_its_own_end():
    """With partial resets the first column is measured at each link, the second is the last link's
    own.
    """
    simulator = FunctionSimulator(decay, RATE, ["a", "b"])
    trajectories = data()
    value = np.array([1.0, 0.7])
    found = simulator.predict(value[None], cut_of(trajectories, "partial"))[0]
    rows = []
    state = None
    for start, stop in trajectories.spans:
        for t in range(start, stop - 1, 2):
            measured = trajectories.observations[t]
            state = measured if t == start else np.array([measured[0], state[1]])
            state = decay(value, state[None], trajectories.actions[None, t : t + 2])[0, -1]
            rows.append(state)
    np.testing.assert_allclose(found, rows, rtol=1e-14)


def test_a_function_that_fails_marks_its_rows():
    """NaN or infinity from the function fails the segment, and the other draw keeps its numbers."""
    simulator = FunctionSimulator(
        lambda v, s, a: np.where(v[0] > 1.5, np.inf, decay(v, s, a)),
        RATE,
        [Signal("a", "m"), Signal("b", "m")],
    )
    found = simulator.predict([[1.0, 1.0], [1.8, 1.0]], data().segments(2))
    assert np.isfinite(found[0]).all()
    assert np.isnan(found[1]).all()
    assert simulator.failures == 9


def test_a_function_of_the_wrong_shape_is_refused():
    """The message names the simulator, what was wanted and what was got."""
    simulator = FunctionSimulator(lambda v, s, a: decay(v, s, a)[:, -1], RATE, ["a", "b"])
    words = (
        r"^The 'replayed observations' of FunctionSimulator must be of shape "
        r"\(9, 2, 2\). Got \(9, 2\) instead.$"
    )
    with pytest.raises(BadArgument, match=words):
        simulator.predict([[1.0, 1.0]], data().segments(2))


def cart_with_pole():
    """InvertedPendulum-v5 by itself: warm starts off, since they make a step depend on the one
    before.
    """
    env = gymnasium.make("InvertedPendulum-v5").unwrapped
    env.model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_WARMSTART

    def set_masses(env, values):
        env.model.body("cart").mass[0], env.model.body("pole").mass[0] = (
            values["cart"],
            values["pole"],
        )

    masses = [Parameter("cart", 5.0, 20.0, "kg"), Parameter("pole", 2.0, 10.0, "kg")]
    return EnvSimulator(
        env,
        masses,
        set_state=lambda env, row: env.set_state(row[:2], row[2:]),
        set_parameters=set_masses,
    )


@pytest.mark.parametrize("cut", CUTS)
def test_an_environment_keeps_to_the_contract(cut):
    """A Gymnasium environment in double precision, its state set by the observation."""
    rows = data(4)
    small = Trajectories(
        0.05 * rows.observations, rows.actions, rows.next_observations, rows.terminals
    )
    check_simulator(cart_with_pole(), cut_of(small, cut))


def test_pendulum_follows_its_equation():
    """Pendulum-v1, state set from (cos, sin, speed): one step of its published equation for each
    mass and length, in single precision.
    """

    def set_state(env, row):
        env.state = np.array([np.arctan2(row[1], row[0]), row[2]])

    def set_parameters(env, values):
        env.m = values["m"]
        env.l = values["l"]

    env = gymnasium.make("Pendulum-v1").unwrapped
    parameters = [Parameter("m", 0.5, 2.0, "kg"), Parameter("l", 0.5, 2.0, "m")]
    simulator = EnvSimulator(env, parameters, set_state=set_state, set_parameters=set_parameters)
    rng = np.random.default_rng(1)
    values = np.array([[1.0, 1.0], [0.6, 1.4], [1.9, 0.7]])
    angle = rng.uniform(-3, 3, 12)
    speed = rng.uniform(-2, 2, 12)
    torque = rng.uniform(-2, 2, 12)
    rows = np.column_stack([np.cos(angle), np.sin(angle), speed])
    segments = Trajectories(rows, torque[:, None], rows, np.arange(12) == 11).segments()
    for (m, length), found in zip(values, simulator.predict(values, segments), strict=True):
        after = speed + 0.05 * (
            3 * 10.0 / (2 * length) * np.sin(angle) + 3.0 / (m * length**2) * torque
        )
        turned = angle + 0.05 * after
        np.testing.assert_allclose(
            found, np.column_stack([np.cos(turned), np.sin(turned), after]), atol=1e-6
        )


def test_discrete_actions():
    """CartPole-v1 takes 0 or 1: the numbers of the data become its choices, and each step is the
    environment's own.
    """

    def set_state(env, row):
        env.state = tuple(row)
        env.steps_beyond_terminated = None

    def set_parameters(env, values):
        env.length = values["length"]
        env.polemass_length = env.masspole * values["length"]

    env = gymnasium.make("CartPole-v1").unwrapped
    simulator = EnvSimulator(
        env,
        [Parameter("length", 0.2, 1.0, "m")],
        set_state=set_state,
        set_parameters=set_parameters,
        signals=["x", "v", "angle", "rate"],
    )
    rng = np.random.default_rng(2)
    rows = 0.02 * rng.normal(size=(10, 4))
    actions = rng.integers(0, 2, 10)
    found = simulator.predict(
        [[0.5], [0.9]], Trajectories(rows, actions[:, None], rows, np.arange(10) == 9).segments()
    )
    for k, length in enumerate((0.5, 0.9)):
        set_parameters(env, {"length": length})
        for row, action, mine in zip(rows, actions, found[k], strict=True):
            set_state(env, row)
            np.testing.assert_array_equal(mine, env.step(int(action))[0])
    assert [signal.name for signal in simulator.signals] == ["x", "v", "angle", "rate"]
