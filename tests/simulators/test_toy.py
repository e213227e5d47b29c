"""The toy simulators against what their closed forms claim."""

import numpy as np
import pytest

from dropo.core.services.errors import BadArgument
from dropo.simulators.toy import LinearSimulator, SlidingBlock, simulate
from dropo.testing import check_simulator
from tests.models.cases import CUTS


def sliding():
    """Six pushes of a block, each with its own mass and damping, 10 steps long."""
    rng = np.random.default_rng(0)
    values = rng.uniform([0.5, 0.1], [4.0, 3.0], (6, 2))
    return values, simulate(
        SlidingBlock(), values, rng.normal(size=(6, 10, 1)), np.array([0.3, -0.2])
    )


def linear():
    """Two parameters, three signals, two actions; 6 trajectories of 10 steps."""
    rng = np.random.default_rng(1)
    simulator = LinearSimulator(rng.normal(size=(2, 3, 2)))
    return simulator, simulate(
        simulator, rng.normal(size=(6, 2)), rng.normal(size=(6, 10, 2)), np.zeros(3)
    )


@pytest.mark.parametrize("cut", CUTS)
@pytest.mark.parametrize("which", ["block", "linear"])
def test_keeps_to_the_contract(which, cut):
    """The checks that plug-in authors call are silent."""
    simulator, data = (SlidingBlock(), sliding()[1]) if which == "block" else linear()
    partly = {"set_columns": np.arange(len(simulator.signals)) == 1} if "partial" in cut else {}
    check_simulator(simulator, data.segments(**CUTS[cut], **partly))


def fine_steps(value, state, force, dt, steps=2000):
    """One control step of m dv/dt = u - c v in many midpoint steps."""
    (mass, damping), (x, v), h = value, state, dt / steps
    for _ in range(steps):
        middle = v + h / 2 * (force - damping * v) / mass
        x = x + h * middle
        v = v + h * (force - damping * middle) / mass
    return np.array([x, v])


def test_sliding_block_solves_its_equation():
    """Each control step is what 2000 midpoint steps give, to their own error of 1e-9 [m, m/s]; the
    control is 1 % more damping.
    """
    values, data = sliding()
    simulator = SlidingBlock(dt=0.05)
    for i, value in enumerate(values):
        mine = data.select([i]).head(3)
        found = simulator.predict([value, value * [1, 1.01]], mine.segments())
        expected = np.array(
            [
                fine_steps(value, o, a[0], 0.05)
                for o, a in zip(mine.observations, mine.actions, strict=True)
            ]
        )
        np.testing.assert_allclose(found[0], expected, atol=1e-9)
        assert np.abs(found[1] - expected).max() > 1e-7


def test_sliding_block_comes_to_its_final_speed():
    """Pushed for long it moves at u / c; without a push it stops after m v / c."""
    simulator = SlidingBlock()
    pushed = simulate(
        simulator, np.array([[1.0, 2.0]]), np.full((1, 400, 1), 3.0), np.zeros(2)
    ).next_observations
    assert pushed[-1, 1] == pytest.approx(1.5, rel=1e-12)
    left = simulate(
        simulator, np.array([[1.0, 2.0]]), np.zeros((1, 400, 1)), np.array([1.0, 4.0])
    ).next_observations
    np.testing.assert_allclose(left[-1], [3.0, 0.0], atol=1e-12)


def test_linear_simulator_is_linear():
    """Steps add up M(a) xi, and the Jacobian is the sums of M(a), whatever xi."""
    simulator, data = linear()
    segments = data.segments(3, every_step=True)
    moved = np.einsum("nlq,qpd->nlpd", segments.actions, simulator.matrices).cumsum(
        axis=1
    )  # (N, L, p, d)
    for value in np.random.default_rng(2).normal(size=(3, 2)):
        prediction, slopes = simulator.linearize(value, segments)
        np.testing.assert_allclose(
            prediction, (segments.starts[:, None] + moved @ value).reshape(-1, 3), atol=1e-12
        )
        np.testing.assert_allclose(slopes, moved.reshape(-1, 3, 2), atol=1e-8)


@pytest.mark.parametrize("cut", ["transition", "partial"])
def test_slopes_in_starts_are_those_of_the_closed_form(cut):
    """A block's position after n steps slopes by 1 in its start and by tau (1 - e^(-n dt / tau)) in
    its speed, tau = m / c. In chains only a segment's own start counts, not those before it."""
    value = np.array([2.0, 1.5])
    step = np.array([0.1, 0.2])
    partly = {"reset": cut, "set_columns": [True, False]} if cut == "partial" else {}
    segments = sliding()[1].segments(3, **partly, every_step=True)
    simulator = SlidingBlock(dt=0.05)
    prediction, jacobian = simulator.linearize_starts(value, segments, step=step)
    segment, place = segments.rows
    tau = value[0] / value[1]
    decay = np.exp(-0.05 * (1 + place) / tau)
    own = (
        segments.previous[segment] < 0
    )  # the others take their speed from where a simulation ended
    slopes = [np.ones_like(decay), own * tau * (1 - decay), np.zeros_like(decay), own * decay]
    expected = np.stack(slopes, axis=-1).reshape(-1, 2, 2)
    np.testing.assert_allclose(jacobian, expected, atol=1e-12)
    np.testing.assert_array_equal(prediction, simulator.predict([value], segments)[0])


def test_simulated_data_are_the_simulators_own():
    """Each trajectory follows its own parameters from the given start; without noise every
    transition is exact.
    """
    values, data = sliding()
    assert data.spans == [(10 * i, 10 * i + 10) for i in range(6)]
    np.testing.assert_array_equal(data.group, np.repeat(np.arange(6), 10))
    np.testing.assert_array_equal(data.observations[::10], np.tile([0.3, -0.2], (6, 1)))
    np.testing.assert_array_equal(data.observations[1:10], data.next_observations[:9])
    found = SlidingBlock().predict(values[None], data.segments())[0]
    np.testing.assert_allclose(found, data.next_observations, atol=1e-15)


def test_noise_is_on_the_next_observations_alone():
    """Of the given variances, one for each signal, and independent of the motion."""
    values, quiet = sliding()
    many = np.repeat(values, 200, axis=0)
    actions = np.repeat(quiet.actions.reshape(6, 10, 1), 200, axis=0)
    rng = np.random.default_rng(3)
    variance = np.array([1e-4, 4e-2])
    clean = simulate(SlidingBlock(), many, actions, np.array([0.3, -0.2]))
    noisy = simulate(
        SlidingBlock(), many, actions, np.array([0.3, -0.2]), noise_variance=variance, rng=rng
    )
    np.testing.assert_array_equal(noisy.observations, clean.observations)
    noise = (noisy.next_observations - clean.next_observations) / np.sqrt(variance)
    assert (np.abs(noise.var(axis=0) - 1) < 4.5 * np.sqrt(2 / len(noise))).all()
    assert (np.abs(noise.mean(axis=0)) < 4.5 / np.sqrt(len(noise))).all()


def test_refusals():
    """Matrices of another shape, and a time step that is none."""
    with pytest.raises(
        BadArgument,
        match=(
            r"^The 'matrices' of LinearSimulator must be of shape \(any, "
            r"any, any\). Got \(3, 2\) instead.$"
        ),
    ):
        LinearSimulator(np.ones((3, 2)))
    with pytest.raises(
        BadArgument, match=r"^The 'dt' of SlidingBlock must be positive \[s\]. Got 0.0 instead.$"
    ):
        SlidingBlock(dt=0.0)
