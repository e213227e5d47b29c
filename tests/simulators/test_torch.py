"""What every torch simulator inherits: the contract, tensors in and out, exact Jacobians, chains,
failures.
"""

import numpy as np
import pytest

from dropo.core.records.parameters import Parameter
from dropo.core.records.trajectories import Signal, Trajectories
from dropo.core.services.errors import Incompatible, SimulationFailed
from dropo.simulators.toy import SlidingBlock
from dropo.testing import check_simulator
from tests.models.cases import CUTS

torch = pytest.importorskip("torch")
from dropo.simulators.torch import TorchSimulator  # noqa: E402


class Block(TorchSimulator):
    """The sliding block of `dropo.simulators.toy`, in torch."""

    def __init__(self):
        super().__init__(
            SlidingBlock().space.parameters, [Signal("position", "m"), Signal("velocity", "m/s")]
        )

    def _advance(self, values, states, actions):
        mass, damping = values.unbind(-1)
        x, v = states.unbind(-1)
        decay = (-damping / mass * 0.05).exp()
        final = actions[:, 0] / damping
        return torch.stack(
            [
                x + final * 0.05 + (v - final) * (1 - decay) * mass / damping,
                final + (v - final) * decay,
            ],
            dim=-1,
        )


class Growth(TorchSimulator):
    """x -> exp(rate x): beyond the largest number within some steps where the rate is large."""

    def __init__(self):
        super().__init__([Parameter("rate", 0.1, 0.3)], ["x"])

    def _advance(self, values, states, actions):
        return (values * states).exp()


def data(seed=0, p=2):
    """Trajectories of 8, 6 and 4 unrelated rows."""
    rng = np.random.default_rng(seed)
    ends = np.isin(np.arange(18), [7, 13, 17])
    return Trajectories(
        rng.normal(size=(18, p)), rng.normal(size=(18, 1)), rng.normal(size=(18, p)), ends
    )


def segments(cut):
    """The data, cut in one of the ways of CUTS."""
    return data().segments(
        **CUTS[cut] | ({"set_columns": [True, False]} if "partial" in cut else {})
    )


def draws(count=4):
    """Parameter vectors of the block."""
    return np.random.default_rng(1).uniform([0.5, 0.1], [4.0, 3.0], (count, 2))


@pytest.mark.parametrize("cut", CUTS)
def test_agrees_with_the_numpy_simulator(cut):
    """Predictions, start offsets included, are those of the same equations in NumPy; the contract's
    checks are silent.
    """
    part = segments(cut)
    values = draws()
    offsets = 0.1 * np.random.default_rng(2).normal(size=(len(values), len(part), 2))
    for moved in (None, offsets):
        found, expected = (
            simulator.predict(values, part, offsets=moved)
            for simulator in (Block(), SlidingBlock())
        )
        np.testing.assert_allclose(found, expected, rtol=1e-13, atol=1e-14)
    check_simulator(Block(), part)


@pytest.mark.parametrize("cut", CUTS)
def test_gradients_by_values_and_offsets(cut):
    """Reverse-mode gradients of a weighted sum of predictions agree with differences, through
    chains and groups too.
    """
    part = segments(cut)
    values = draws()
    simulator = Block()
    offsets = 0.1 * np.random.default_rng(2).normal(size=(4, len(part), 2))
    weights = np.random.default_rng(3).normal(size=simulator.predict(values, part).shape)

    def total(values, offsets):
        return (simulator.predict(values, part, offsets=offsets) * torch.as_tensor(weights)).sum()

    leaves = torch.tensor(values, requires_grad=True), torch.tensor(offsets, requires_grad=True)
    assert torch.autograd.gradcheck(total, leaves, eps=1e-6, atol=1e-7, rtol=1e-6)
    by_group = torch.tensor(np.stack([values[:3], values[1:]]), requires_grad=True)
    assert torch.autograd.gradcheck(
        lambda v: simulator.predict(v, part), (by_group,), eps=1e-6, atol=1e-7, rtol=1e-6
    )


def test_jacobians_are_exact_where_differences_round():
    """Against the closed form of one step's velocity to 1e-13; central differences of the NumPy
    twin err by more than 1e-12.
    """
    part = data().segments()
    value = np.array([1.3, 0.7])
    mass, damping = value
    decay = np.exp(-damping / mass * 0.05)
    v = part.starts[:, 1]
    u = part.actions[:, 0, 0]
    by_mass = (v - u / damping) * decay * damping / mass**2 * 0.05
    by_damping = -u / damping**2 * (1 - decay) - (v - u / damping) * decay * 0.05 / mass
    expected = np.stack([by_mass, by_damping], axis=-1)
    np.testing.assert_allclose(
        Block().linearize(value, part)[1][:, 1], expected, rtol=1e-13, atol=1e-14
    )
    assert np.abs(SlidingBlock().linearize(value, part)[1][:, 1] - expected).max() > 1e-12
    np.testing.assert_array_equal(Block().jacobian(value, part), Block().linearize(value, part)[1])


def test_slopes_in_starts():
    """Those of the NumPy twin, to the error of its differences."""
    part = data().segments()
    mine, theirs = (
        simulator.linearize_starts([1.3, 0.7], part, step=[0.1, 0.1])[1]
        for simulator in (Block(), SlidingBlock())
    )
    np.testing.assert_allclose(mine, theirs, rtol=1e-10, atol=1e-12)


def test_a_given_step_asks_for_differences():
    """Sensitivities over a wide step are those differences, not the derivative."""
    part = data().segments()
    value = np.array([1.3, 0.7])
    step = np.array([0.3, 0.3])
    found, expected = (
        simulator.linearize(value, part, step=step)[1] for simulator in (Block(), SlidingBlock())
    )
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-14)
    assert np.abs(found - Block().jacobian(value, part)).max() > 1e-4


def test_steps_are_counted():
    """K draws of N segments cost K times their steps; a linearization costs d draws."""
    simulator = Block()
    part = data().segments(2)
    simulator.predict(draws(4), part)
    assert simulator.steps == 4 * 18
    simulator.linearize(draws(1)[0], part)
    assert simulator.steps == (4 + 2) * 18


def test_failures_are_nan_rows_of_their_own():
    """A draw that overflows has NaN where it did, and is counted; other draws keep their numbers;
    linearizing there is refused.
    """
    part = data(p=1).segments(reset="start")
    simulator = Growth()
    values = np.array([[0.2], [3.0], [0.3]])
    found = simulator.predict(values, part)
    assert np.isnan(found[1]).any()
    assert not np.isnan(found[1]).all()
    assert simulator.failures > 0
    np.testing.assert_array_equal(found[[0, 2]], simulator.predict(values[[0, 2]], part))
    tensor = simulator.predict(torch.tensor(values), part)
    np.testing.assert_array_equal(tensor, found)
    with pytest.raises(
        SimulationFailed, match=r"simulated rows diverged, the first at row .* with rate = 3"
    ):
        simulator.linearize([3.0], part)


def test_a_simulator_without_gradients_refuses_tensors():
    """The message names the simulator and both ways out."""
    part = data().segments()
    with pytest.raises(
        Incompatible,
        match=(
            r"SlidingBlock gives no gradients, so it takes no tensors. Use "
            r"likelihood 'emulated'.*'cma-es'"
        ),
    ):
        SlidingBlock().predict(torch.tensor(draws()), part)


class Forgets(Block):
    """Gives tensors without their history."""

    def _predict(self, values, segments, offsets):
        found = super()._predict(values, segments, offsets)
        return found if isinstance(found, np.ndarray) else found.detach()


class Rounds(Block):
    """Other numbers for tensors."""

    def _predict(self, values, segments, offsets):
        found = super()._predict(values, segments, offsets)
        return found if isinstance(found, np.ndarray) else found * (1 + 1e-7)


class HalfDetached(Block):
    """No gradient by the damping; its differences are sound."""

    def _advance(self, values, states, actions):
        return super()._advance(
            torch.cat([values[..., :1], values[..., 1:].detach()], dim=-1), states, actions
        )

    def linearize(self, values, segments, *, step=None, offsets=None):
        width = 1e-5 * np.ones(2)
        return super().linearize(values, segments, step=width)


@pytest.mark.parametrize(
    ("broken", "words"),
    [
        (
            Forgets,
            "Forgets has gradients, but of a tensor its predict gives no tensor with a history",
        ),
        (Rounds, "Rounds.predict gives other numbers for a tensor than for an array"),
        (
            HalfDetached,
            (
                "HalfDetached: the gradient of a weighted sum of predictions by damping is 0, "
                "its Jacobian gives"
            ),
        ),
    ],
)
def test_broken_gradients_are_caught(broken, words):
    """The shipped check meets simulators whose gradients are broken on purpose."""
    with pytest.raises(AssertionError, match=words):
        check_simulator(broken(), data().segments())
