"""A simulator's predictions as polynomials: their orders, their design, and what they leave."""

from dataclasses import replace

import numpy as np
import pytest

from dropo.core.records import segment_blocks
from dropo.core.records.parameters import Parameter, ParameterSpace
from dropo.core.services.errors import BadArgument, SimulationFailed
from dropo.likelihoods.support.polynomials import (
    DESIGN,
    build,
    design_points,
    index_set,
    orders_for,
)
from dropo.simulators.function import FunctionSimulator
from dropo.simulators.toy import LinearSimulator, simulate


class Fragile(LinearSimulator):
    """Diverges where x0 is above a limit."""

    limit = np.inf

    def _replay(self, value, starts, actions):
        good = super()._replay(value, starts, actions)
        return good if value[0] <= self.limit else np.full_like(good, np.nan)


def fragile(limit):
    simulator = Fragile(np.eye(2)[None])
    data = simulate(simulator, np.zeros((4, 2)), np.ones((4, 1, 1)), np.zeros(2))
    simulator.limit = limit
    return simulator, data.segments()


def test_diverging_design_points_are_left_out():
    """Some of the design points diverge; the linear function is found from the others."""
    simulator, segments = fragile(1.0)
    emulator = build(
        simulator, segments, np.zeros(2), np.ones(2), np.array([1, 1]), np.random.default_rng(0)
    )
    assert 0 < emulator.failed < 4
    values = np.array([[0.3, -0.2], [0.5, 0.7]])
    np.testing.assert_allclose(
        emulator.predict(values), np.broadcast_to(values[:, None], (2, 4, 2)), atol=1e-12
    )
    whole = fragile(np.inf)
    assert (
        build(*whole, np.zeros(2), np.ones(2), np.array([1, 1]), np.random.default_rng(0)).failed
        == 0
    )


def test_a_design_with_too_few_points_is_refused():
    """Nearly all points diverge: how many rows, the first with its parameters, what it means."""
    simulator, segments = fragile(-1.0)
    count = DESIGN.design_size(len(index_set(np.array([1, 1]))))
    design = design_points(
        simulator, np.zeros(2), np.ones(2), count, np.random.default_rng(0), False
    )
    bad = design[:, 0] > -1
    first = design[bad][0]
    with pytest.raises(SimulationFailed) as refusal:
        build(
            simulator, segments, np.zeros(2), np.ones(2), np.array([1, 1]), np.random.default_rng(0)
        )
    assert str(refusal.value) == (
        f"{4 * bad.sum()} of {4 * count} simulated rows diverged, the first at row 0 with "
        f"x0 = {first[0]:.6g}, x1 = {first[1]:.6g}."
        " The design around the estimate cannot be used."
    )


def late_failures(monkeypatch, size):
    """A design of two parameters on five segments, of which the last diverges at high x0; blocks of
    `size` bytes.
    """

    def function(value, starts, actions):
        out = starts[:, None] + np.exp(0.3 * value) * actions
        return np.where((starts[:, None, :1] > 3.5) & (value[0] > 1.0), np.nan, out)

    monkeypatch.setattr(segment_blocks, "DESIGN_BYTES", size)
    simulator = FunctionSimulator(
        function, [Parameter("x0", -9, 9), Parameter("x1", -9, 9)], ["a", "b"]
    )
    data = simulate(simulator, np.zeros((5, 2)), np.ones((5, 1, 1)), np.zeros(2))
    segments = replace(data, observations=np.repeat(np.arange(5.0)[:, None], 2, axis=1)).segments()
    return simulator, build(
        simulator, segments, np.zeros(2), np.ones(2), np.array([2, 2]), np.random.default_rng(0)
    )


def test_a_point_that_diverges_in_a_late_block_is_left_out_of_all(monkeypatch):
    """One segment a block gives what a single block gives, to rounding; the first four are
    simulated again, without it.
    """
    whole, one = late_failures(monkeypatch, 1 << 30)
    pieces, other = late_failures(monkeypatch, 1)
    assert one.failed == other.failed > 0
    np.testing.assert_allclose(other.coefficients, one.coefficients, rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(other.residual, one.residual, rtol=1e-10, atol=1e-14)
    points = DESIGN.design_size(6)
    assert whole.steps == 5 * points
    assert pieces.steps == 5 * points + 4 * (points - other.failed)


def test_points_beyond_what_is_possible_are_mirrored():
    """A mean near the bound of 0: the design stays inside and apart, and the regression exact; put
    on the bound, many points coincide.
    """
    simulator = FunctionSimulator(
        lambda value, starts, actions: starts[:, None] + actions * (2 * value + value**2),
        [Parameter("x", 0.0, 4.0)],
        ["a"],
    )
    segments = simulate(simulator, np.ones((3, 1)), np.ones((3, 1, 1)), np.zeros(1)).segments()
    centre = np.array([0.05])
    width = np.array([0.4])
    points = design_points(simulator, centre, width, 64, np.random.default_rng(0), False)
    assert points.min() > 0
    assert len(np.unique(points)) == 64
    emulator = build(simulator, segments, centre, width, np.array([3]), np.random.default_rng(0))
    values = np.linspace(0, 1, 7)[:, None]
    np.testing.assert_allclose(
        emulator.predict(values), simulator.predict(values, segments), atol=1e-10
    )


def test_a_singular_design_is_refused():
    """A parameter that can hardly vary, and a width of 0: named, with a way out."""
    simulator = FunctionSimulator(
        lambda value, starts, actions: starts[:, None] + actions * value.sum(),
        [Parameter("x", 0.0, 1.0), Parameter("y", 0.0, 1e-9, lower=0.0, upper=1e-9)],
        ["a"],
    )
    segments = simulate(simulator, np.zeros((3, 2)), np.ones((3, 1, 1)), np.zeros(1)).segments()
    centre = np.array([0.5, 5e-10])
    with pytest.raises(
        BadArgument,
        match=(
            "design around the estimate is singular: its points do not vary enough in 'y' to "
            "tell 6 polynomials"
        ),
    ):
        build(
            simulator,
            segments,
            centre,
            np.array([0.1, 1e3]),
            np.array([2, 2]),
            np.random.default_rng(0),
        )
    with pytest.raises(
        BadArgument,
        match=r"The 'width' of an emulator must be positive for every parameter. Got \[0.1, 0.0\]",
    ):
        build(
            simulator,
            segments,
            centre,
            np.array([0.1, 0.0]),
            np.array([2, 2]),
            np.random.default_rng(0),
        )


def test_what_the_polynomials_leave_is_an_unbiased_covariance():
    """White noise in place of a simulator, over 3000 rows: its covariance, times Hartlap's factor
    free / (free - p - 1).

    4.5 standard errors, themselves below 2 %; the maximum-likelihood covariance, divided by N, is
    rejected.
    """
    rng = np.random.default_rng(0)
    p = 2
    root = np.array([[1.0, 0.0], [0.6, 0.8]])
    noisy = lambda value, starts, actions: rng.standard_normal((*actions.shape[:2], p)) @ root.T
    simulator = FunctionSimulator(noisy, [Parameter("x", -9, 9), Parameter("y", -9, 9)], ["a", "b"])
    actions = np.ones((3000, 1, 1))
    segments = simulate(simulator, np.zeros((3000, 2)), actions, np.zeros(p)).segments()
    emulator = build(
        simulator, segments, np.zeros(2), np.ones(2), np.array([2, 2]), np.random.default_rng(1)
    )
    terms = len(emulator.indices)
    points = DESIGN.design_size(terms)
    free = points - terms
    found = emulator.residual[:, [0, 1, 0], [0, 1, 1]] * (free - p - 1) / free
    error = found.std(axis=0) / np.sqrt(len(found))
    exact = (root @ root.T)[[0, 1, 0], [0, 1, 1]]
    assert (error < 0.02).all()
    assert (np.abs(found.mean(axis=0) - exact) < 4.5 * error).all()
    assert (np.abs(found.mean(axis=0) * free / points - exact) > 4.5 * error).all()


def test_index_set_is_anisotropic():
    """sum_i j_i / orders_i <= 1 and the pairs of orders above 1; by degree, the constant first; the
    rows are different and of full rank.
    """
    assert index_set(np.array([3, 1])).tolist() == [[0, 0], [1, 0], [0, 1], [2, 0], [3, 0]]
    assert index_set(np.array([3, 2])).tolist() == [
        [0, 0],
        [1, 0],
        [0, 1],
        [2, 0],
        [1, 1],
        [0, 2],
        [3, 0],
    ]
    assert len(index_set(np.array([2, 2, 2, 2]))) == 15  # a full quadratic in 4 parameters
    assert len(index_set(np.array([4, 4, 4, 4]))) == 70  # binomial(8, 4)
    assert index_set(np.array([1, 1, 1])).tolist() == [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]
    many = np.array([4, 3, 2, 1])
    kept = index_set(many)
    assert len(np.unique(kept, axis=0)) == len(kept)
    assert (kept.max(axis=0) == many).all()


def test_beyond_ten_parameters_there_are_own_powers_alone():
    """Pairs are crossed with 10 parameters and not with 11, whose terms are the constant and each
    one's powers.
    """
    assert len(index_set(np.full(10, 2))) == 1 + 10 + 10 + 45
    kept = index_set(np.full(11, 2))
    assert len(kept) == 1 + 2 * 11
    assert (np.count_nonzero(kept, axis=1) <= 1).all()
    orders = np.array([1] * 11 + [3])
    assert len(index_set(orders)) == 1 + 12 + 2


def test_many_parameters_are_emulated():
    """Twelve parameters with squares: exact, from 1.7 M + 6 simulations."""
    rng = np.random.default_rng(0)
    weights = rng.normal(size=(12, 2))
    function = lambda value, starts, actions: (
        starts[:, None] + actions * (value @ weights + value**2 @ weights)
    )
    simulator = FunctionSimulator(
        function, [Parameter(f"x{i}", -1.0, 1.0) for i in range(12)], ["a", "b"]
    )
    segments = simulate(simulator, np.zeros((3, 12)), np.ones((3, 1, 1)), np.zeros(2)).segments()
    emulator = build(simulator, segments, np.zeros(12), np.full(12, 0.3), np.full(12, 2), rng)
    values = rng.uniform(-0.5, 0.5, (4, 12))
    np.testing.assert_allclose(
        emulator.predict(values), simulator.predict(values, segments), atol=1e-10
    )
    assert len(emulator.indices) == 25


def test_orders_follow_the_width():
    """Shares of the search interval up to 0.2, 1.3 and 3.3 % are orders 1, 2 and 3; all wider ones
    are 4; a first look stops at 2, and at 1 below 1 %.
    """
    space = ParameterSpace(tuple(Parameter(name, 0.0, 2.0) for name in "abcd"))
    width = 2 * np.array([1e-3, 5e-3, 0.02, 0.1])
    assert orders_for(width, space, None, rough=False).tolist() == [1, 2, 3, 4]
    assert orders_for(width, space, None, rough=True).tolist() == [1, 1, 2, 2]
    assert orders_for(width, space, 3, rough=False).tolist() == [3, 3, 3, 3]
