"""What the emulated, linear and unscented likelihoods share: noise on both ends, long tails,
blocks, tensors, failures.
"""

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from dropo.core.contracts.estimator import Run
from dropo.core.contracts.noise import Noise, NoiseModel
from dropo.core.contracts.support.fisher_scoring import maximize_locally
from dropo.core.numerics import kept_rows
from dropo.core.records import segment_blocks
from dropo.core.records.parameters import Parameter
from dropo.core.services.errors import BadArgument, Incompatible, SimulationFailed
from dropo.core.services.registry import find
from dropo.estimators.support.trust_region import OuterIterations, TrustRegionSettings
from dropo.families.full_gaussian import FullGaussian
from dropo.families.point import Point
from dropo.families.truncated_gaussian import TruncatedGaussian
from dropo.likelihoods.emulated import Emulated
from dropo.likelihoods.linear import Linear
from dropo.likelihoods.support import axial
from dropo.likelihoods.support.axial import along_parameters, along_starts
from dropo.likelihoods.unscented import Unscented
from dropo.problems.hopper.data import TRUTH
from dropo.problems.hopper.data import simulate as hopper_transitions
from dropo.problems.hopper.problem import hopper_problem
from dropo.simulators.function import FunctionSimulator
from dropo.simulators.toy import LinearSimulator, SlidingBlock, simulate

LIKELIHOODS = {"emulated": Emulated(), "linear": Linear(), "unscented": Unscented()}
FAMILIES = ("truncated_gaussian", "full", "uniform", "log_normal", "point")
NOISES = {
    "known": 1e-3,
    "one factor": Noise(np.array([1e-3, 2e-3]), "factor"),
    "start, each": Noise(np.array([1e-3, 2e-3]), "each", start=True),
    "start, Student": Noise(np.array([1e-3, 2e-3]), "each", start=True, degrees=5.0),
}
CENTRE = np.array([1.5, 0.8])
WIDTH = np.array([0.25, 0.15])


def block_data(rows=12, length=5, seed=4):
    """A sliding block with another draw of mass and damping in every push of 5 steps."""
    rng = np.random.default_rng(seed)
    simulator = SlidingBlock(dt=0.2)
    values = CENTRE + np.array([0.2, 0.1]) * rng.standard_normal((rows, 2))
    actions = np.repeat(rng.normal(0.0, 3.0, (rows, 1, 1)), 5, axis=1)
    return simulator, simulate(
        simulator, values, actions, np.array([0.0, 1.0]), noise_variance=1e-4, rng=rng
    ).segments(length)


def built(kind, name="truncated_gaussian", noise=1e-3, **settings):
    """A likelihood of the block data around (1.5 kg, 0.8 N s/m), and phi near by."""
    simulator, segments = block_data(**settings)
    family = find("families", name)(simulator.space)
    local = LIKELIHOODS[kind].linearize_at(
        simulator, segments, family, noise, CENTRE, WIDTH, np.random.default_rng(0)
    )
    relative = CENTRE if name == "log_normal" else 1.0
    phi = family.phi([1.45, 0.85], None if name == "point" else np.array([0.17, 0.09]) / relative)
    if name == "full":
        phi[4] = 0.6
    return local, np.append(phi, np.array([1.3, 0.6])[: len(local.unknowns) - len(phi)])


# --- gradients, tensors


@pytest.mark.parametrize("noise", NOISES)
@pytest.mark.parametrize("name", FAMILIES)
@pytest.mark.parametrize("kind", LIKELIHOODS)
def test_gradient_is_that_of_the_value(kind, name, noise):
    """Central differences of the value, to 1e-6 of each component, for every family and noise."""
    local, phi = built(kind, name, NOISES[noise])

    def slope(i, h):
        step = h * np.eye(len(phi))[i]
        return (local(phi + step) - local(phi - step)) / (2 * h)

    by_difference = np.array(
        [(4 * slope(i, h / 2) - slope(i, h)) / 3 for i, h in enumerate(1e-4 * np.abs(phi))]
    )
    np.testing.assert_allclose(local.gradient(phi), by_difference, rtol=1e-6)
    assert local.value_score_information(phi)[0] == pytest.approx(local(phi), rel=1e-13)


@pytest.mark.parametrize("name", FAMILIES)
@pytest.mark.parametrize("kind", LIKELIHOODS)
def test_tensors_give_the_same_numbers_and_gradients(kind, name):
    """Rows and value to 1e-10, and autograd's gradient to 1e-6 of the largest component."""
    torch = pytest.importorskip("torch")
    local, phi = built(kind, name, NOISES["start, Student"])
    tensor = torch.tensor(phi, requires_grad=True)
    rows = local.rows(tensor)
    np.testing.assert_allclose(rows.detach().numpy(), local.rows(phi), rtol=1e-10)
    value = local(tensor)
    value.backward()
    assert value.item() == pytest.approx(local(phi), rel=1e-10)
    gradient = local.gradient(phi)
    np.testing.assert_allclose(
        tensor.grad.numpy(), gradient, rtol=0, atol=1e-6 * np.abs(gradient).max()
    )


@pytest.mark.parametrize("kind", LIKELIHOODS)
def test_tensors_of_another_shape_are_refused(kind):
    torch = pytest.importorskip("torch")
    local, phi = built(kind)
    with pytest.raises(BadArgument, match=r"'phi' .* of shape \(4,\)"):
        local(torch.ones(len(phi) + 1))


@pytest.mark.parametrize(
    ("kind", "noise"),
    [("linear", "start, Student"), ("unscented", "start, each"), ("unscented", "start, Student")],
)
def test_information_is_the_covariance_of_the_score(kind, noise):
    """Over 600 simulated data sets of 5 rows, Gaussian or Student: 4.5 standard errors; twice the
    information is rejected.
    """
    local, phi = built(kind, "full", NOISES[noise], rows=5)
    mean, sigma = local.moments(phi)
    root = np.linalg.cholesky(sigma)
    count = 600
    rng = np.random.default_rng(7)
    degrees = NOISES[noise].degrees
    scores = np.empty((count, len(phi)))
    for i in range(count):
        stretch = (
            1.0 if degrees is None else np.sqrt(degrees / rng.chisquare(degrees, (len(mean), 1)))
        )
        local.targets = mean + stretch * np.einsum(
            "rpq,rq->rp", root, rng.standard_normal(mean.shape)
        )
        scores[i] = local.gradient(phi)
    information = local.value_score_information(phi)[2]
    assert np.abs(scores.mean(axis=0) * np.sqrt(count) / scores.std(axis=0)).max() < 4.5
    products = scores[:, :, None] * scores[:, None]
    error = products.std(axis=0) / np.sqrt(count)
    assert (np.abs(products.mean(axis=0) - information) / error).max() < 4.5
    assert (np.abs(products.mean(axis=0) - 2 * information) / error).max() > 4.5


# --- blocks


@pytest.mark.parametrize("kind", LIKELIHOODS)
def test_blocks_change_nothing(kind, monkeypatch):
    """One row or one segment at a time gives the same rows, scores, information and design to
    1e-11.
    """
    whole, phi = built(kind, "full", NOISES["start, Student"])
    monkeypatch.setattr(kept_rows, "ROW_BYTES", 1)
    monkeypatch.setattr(segment_blocks, "DESIGN_BYTES", 1)
    pieces, _ = built(kind, "full", NOISES["start, Student"])
    assert len(pieces.blocks) == len(whole.targets) > len(whole.blocks)
    np.testing.assert_allclose(pieces.rows(phi), whole.rows(phi), rtol=1e-11)
    for one, other in zip(
        pieces.value_score_information(phi), whole.value_score_information(phi), strict=True
    ):
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-11 * np.abs(other).max())


def test_segments_are_cut_between_chains_alone():
    """Blocks of segments cover all in order; those that go on from each other stay together; rows
    are counted.
    """
    data = block_data(rows=4)[1].trajectories
    chained = data.segments(1, reset="partial", set_columns=[True, False])
    parts = list(
        segment_blocks.segment_blocks(chained, segment_blocks.DESIGN_BYTES // 7)
    )  # 7 rows a block, 5 segments a chain
    assert [len(part) for part, _, _ in parts] == [5, 5, 5, 5]
    assert [(rows.start, rows.stop) for _, rows, _ in parts] == [
        (0, 5),
        (5, 10),
        (10, 15),
        (15, 20),
    ]
    free = data.segments(1)
    parts = list(segment_blocks.segment_blocks(free, segment_blocks.DESIGN_BYTES // 7))
    assert [len(part) for part, _, _ in parts] == [7, 7, 6]
    assert np.concatenate([places for *_, places in parts]).tolist() == list(range(20))
    every = data.segments(5, every_step=True)  # 5 rows a segment: two do not fit
    assert [
        rows.stop
        for _, rows, _ in segment_blocks.segment_blocks(every, segment_blocks.DESIGN_BYTES // 7)
    ] == [
        5,
        10,
        15,
        20,
    ]
    np.testing.assert_array_equal(parts[1][0].targets, free.targets[parts[1][1]])


@pytest.mark.parametrize("kind", LIKELIHOODS)
def test_memory_does_not_grow_with_rows_times_unknowns(kind, monkeypatch):
    """Per further row `expand` takes below 50 numbers, the 16 scores in blocks and together among
    them; in one block above 200.
    """
    rng = np.random.default_rng(0)
    simulator = LinearSimulator(rng.normal(size=(2, 6, 8)))
    family = TruncatedGaussian(simulator.space)

    def peak(rows):
        data = simulate(
            simulator,
            np.ones((rows, 8)),
            rng.normal(size=(rows, 1, 2)),
            np.zeros(6),
            noise_variance=0.01,
            rng=rng,
        )
        linearize_at = LIKELIHOODS[kind].linearize_at
        local = linearize_at(
            simulator,
            data.segments(),
            family,
            0.01,
            np.ones(8),
            np.full(8, 0.02),
            np.random.default_rng(0),
        )
        phi = family.phi(np.ones(8), np.full(8, 0.02))
        tracemalloc.start()
        local.value_score_information(phi)
        most = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return most

    monkeypatch.setattr(kept_rows, "ROW_BYTES", 1 << 19)
    assert (peak(3000) - peak(1000)) / 2000 / 8 < 50
    monkeypatch.setattr(kept_rows, "ROW_BYTES", 1 << 40)
    assert (peak(3000) - peak(1000)) / 2000 / 8 > 200


def test_memory_of_a_design_is_bounded(monkeypatch):
    """An emulator's predictions are held for a block of segments: eight times the rows, the same
    beyond what is kept.
    """
    rng = np.random.default_rng(0)
    simulator = LinearSimulator(rng.normal(size=(2, 3, 6)))

    def peak(rows):
        data = simulate(
            simulator, np.ones((rows, 6)), rng.normal(size=(rows, 1, 2)), np.zeros(3)
        ).segments()
        tracemalloc.start()
        built = Emulated(order=2).linearize_at(
            simulator,
            data,
            TruncatedGaussian(simulator.space),
            0.01,
            np.ones(6),
            np.full(6, 0.02),
            rng,
        )
        most = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return most - built.emulator.coefficients.nbytes - built.emulator.residual.nbytes

    monkeypatch.setattr(segment_blocks, "DESIGN_BYTES", 1 << 20)
    assert peak(8000) < 2 * peak(1000)
    monkeypatch.setattr(segment_blocks, "DESIGN_BYTES", 1 << 40)
    assert peak(8000) > 5 * peak(1000)


# --- long tails


def test_student_density_is_scipys():
    """Row by row scipy's multivariate t with Sigma as its scale matrix."""
    local, phi = built("emulated", noise=Noise(1e-3, degrees=4.0))
    mean, sigma = local.moments(phi)
    by_hand = [
        stats.multivariate_t(m, s, df=4.0).logpdf(y)
        for m, s, y in zip(mean, sigma, local.targets, strict=True)
    ]
    np.testing.assert_allclose(local.rows(phi), by_hand, rtol=1e-9)


@pytest.mark.parametrize("kind", LIKELIHOODS)
def test_outliers_lose_their_pull(kind):
    """5 % of rows off by 30 noises to one side: a Student t stays within 4 standard errors of the
    truth, a Gaussian is pulled off by 10.
    """
    rng = np.random.default_rng(3)
    simulator = LinearSimulator(rng.normal(size=(2, 3, 2)))
    truth = np.array([1.0, -2.0])
    actions = rng.uniform(0.5, 1.5, (400, 1, 2))
    data = simulate(
        simulator,
        np.repeat(truth[None], 400, axis=0),
        actions,
        np.zeros(3),
        noise_variance=1e-4,
        rng=rng,
    )
    following = data.next_observations.copy()
    following[::20] += 0.3
    segments = replace(data, next_observations=following).segments()
    family = Point(simulator.space)

    def z(noise):
        local = LIKELIHOODS[kind].linearize_at(
            simulator,
            segments,
            family,
            noise,
            truth + 0.1,
            np.array([0.5, 0.5]),
            np.random.default_rng(0),
        )
        found = maximize_locally(local, np.append(truth + 0.02, np.ones(len(local.unknowns) - 2)))
        assert found.converged
        error = np.sqrt(np.diagonal(np.linalg.inv(local.value_score_information(found.phi)[2])))
        return np.abs((found.phi[:2] - truth) / error[:2]).max()

    assert z(Noise(1e-4, degrees=4.0)) < 4
    assert z(Noise(1e-4, "factor", degrees=4.0)) < 4
    assert z(Noise(1e-4)) > 10


# --- noise on the start states


class Shift(LinearSimulator):
    """o_{t+1} = B o_t + M(a_t) xi: the start's noise comes out as B n."""

    matrix = np.array([[1.0, 0.5, 0.0], [0.0, 4.0, 0.0], [0.3, 0.0, 1.0]])

    def _replay(self, value, starts, actions):
        moved = np.einsum("nlq,qpd,d->nlp", actions, self.matrices, value)
        out = np.empty_like(moved)
        state = starts
        for j in range(moved.shape[1]):
            state = state @ self.matrix.T + moved[:, j]
            out[:, j] = state
        return out


@pytest.mark.parametrize("length", [1, 3])
@pytest.mark.parametrize("kind", LIKELIHOODS)
def test_start_noise_has_the_closed_form(kind, length):
    """Sigma = M S M' + diag(epsilon) + B^L diag(epsilon) B^L' for segments of L steps, of every
    step where all are compared.
    """
    rng = np.random.default_rng(5)
    simulator = Shift(rng.normal(size=(2, 3, 2)))
    data = simulate(
        simulator,
        rng.normal(size=(10, 2)),
        rng.normal(size=(10, 6, 2)),
        np.ones(3),
        noise_variance=0.01,
        rng=rng,
    )
    segments = data.segments(length, every_step=length > 1)
    family = FullGaussian(simulator.space)
    epsilon = np.array([0.01, 0.02, 0.05])
    linearize_at = LIKELIHOODS[kind].linearize_at
    centre = np.zeros(2)
    width = np.full(2, 0.3)
    noisy, quiet = (
        linearize_at(
            simulator,
            segments,
            family,
            Noise(epsilon, start=start),
            centre,
            width,
            np.random.default_rng(0),
        )
        for start in (True, False)
    )
    phi = family.phi([0.1, 0.2], [0.4, 0.3])
    powers = np.stack([np.linalg.matrix_power(Shift.matrix, k) for k in range(1, length + 1)])[
        segments.rows[1] if length > 1 else 0
    ]
    expected = quiet.moments(phi)[1] + powers * epsilon @ powers.swapaxes(-1, -2)
    np.testing.assert_allclose(noisy.moments(phi)[1], expected, rtol=1e-7, atol=1e-9)
    np.testing.assert_allclose(noisy.mean(phi), quiet.mean(phi), atol=1e-9)


def test_start_noise_goes_through_the_curvature():
    """f = o^2: noise of variance v at o gives the mean o^2 + v and the variance 4 o^2 v + 2 v^2,
    exactly.
    """
    simulator = FunctionSimulator(
        lambda value, starts, actions: (starts**2 + value)[:, None], [Parameter("x", -5, 5)], ["y"]
    )
    starts = np.linspace(0.5, 2.0, 8)
    data = simulate(simulator, np.zeros((8, 1)), np.ones((8, 1, 1)), np.zeros(1))
    data = replace(data, observations=starts[:, None])
    variance = 1e-4
    centre = np.zeros(1)
    width = np.ones(1)
    family = Point(simulator.space)
    noise = Noise(variance, start=True)
    local = Linear().linearize_at(
        simulator, data.segments(), family, noise, centre, width, np.random.default_rng(0)
    )
    mean, sigma = local.moments(np.zeros(1))
    np.testing.assert_allclose(mean[:, 0], starts**2 + variance, rtol=1e-9)
    np.testing.assert_allclose(
        sigma[:, 0, 0], variance + 4 * starts**2 * variance + 2 * variance**2, rtol=1e-7
    )


def test_segments_that_go_on_from_each_other_are_moved_one_at_a_time():
    """`partial` resets: moving a segment's own start moves its set columns alone; what came before
    stays where it was.
    """
    rng = np.random.default_rng(5)
    simulator = Shift(rng.normal(size=(2, 3, 2)))
    data = simulate(simulator, rng.normal(size=(3, 2)), rng.normal(size=(3, 4, 2)), np.ones(3))
    segments = data.segments(1, reset="partial", set_columns=[True, False, True])
    found = along_starts(simulator, segments, np.zeros(2), NoiseModel(0.01, 3)).slope
    first = segments.previous < 0
    np.testing.assert_allclose(found[first], np.broadcast_to(Shift.matrix, (3, 3, 3)), atol=1e-8)
    np.testing.assert_allclose(
        found[~first], np.broadcast_to(Shift.matrix * [1, 0, 1], (9, 3, 3)), atol=1e-8
    )


def test_start_noise_is_not_taken_for_spread():
    """Noise on both ends: with it the mean is within 3.5 standard errors and the scale at its
    bound; without, one above 0.1 is found.
    """
    rng = np.random.default_rng(2)
    simulator = Shift(rng.normal(size=(2, 3, 2)))
    truth = np.array([1.0, -2.0])
    variance = 0.01
    data = simulate(
        simulator,
        np.repeat(truth[None], 300, axis=0),
        rng.uniform(0.5, 1.5, (300, 1, 2)),
        np.ones(3),
        noise_variance=variance,
        rng=rng,
    )
    measured = data.observations + np.sqrt(variance) * rng.standard_normal(data.observations.shape)
    segments = replace(data, observations=measured).segments()
    family = TruncatedGaussian(simulator.space)

    def fitted(noise):
        local = Linear().linearize_at(
            simulator, segments, family, noise, truth, np.full(2, 0.5), rng
        )
        return local, maximize_locally(
            local, np.append(family.phi(truth, [0.2, 0.2]), np.ones(len(local.unknowns) - 4))
        )

    local, found = fitted(Noise(np.full(3, variance), "factor", start=True))
    error = np.sqrt(np.diagonal(np.linalg.inv(local.value_score_information(found.phi)[2][:2, :2])))
    assert (np.abs(found.phi[:2] - truth) < 3.5 * error).all()
    assert found.phi[4] == pytest.approx(
        1.0, abs=0.15
    )  # 1800 numbers: its standard error is near 0.04
    at_bound = lambda maximum: (
        (maximum.phi[2:4] == local.unknowns.low[2:4]) & (maximum.score[2:4] < 0)
    )
    assert at_bound(found).any()
    assert found.phi[2:4].max() < 0.06
    assert fitted(Noise(variance))[1].phi[2:4].max() > 0.1


def hopper_fitted(noise, seed=2):
    """The rounds' maximum for 1000 transitions of the hopper with noise of variance 1e-5 on both
    ends, and the true masses.
    """
    variance = 1e-5
    rng = np.random.default_rng(100 + seed)
    data, _ = hopper_transitions(500, 2, rng=np.random.default_rng(seed), noise_variance=variance)
    data = replace(
        data,
        observations=data.observations
        + np.sqrt(variance) * rng.standard_normal(data.observations.shape),
    )
    problem = hopper_problem("both ends", data, variance)
    family = TruncatedGaussian(problem.space)
    run = Run(problem, np.random.default_rng(0))
    settings = TrustRegionSettings(max_iterations=15)
    rng = np.random.default_rng(0)
    search = OuterIterations(problem, run, family, Linear(), noise, rng, settings=settings)
    local, found = search.fit((problem.space.low + problem.space.high) / 2)
    return local, found.point, np.array(list(TRUTH.values()))


@pytest.mark.study
def test_hopper_with_noise_on_both_ends():
    """Every mass within 1 % and 3.5 standard errors, all scales at their bound; without propagation
    they run away. The noise comes out larger than it is, since to first order starts just above the
    ground do not touch it.
    """
    local, phi, truth = hopper_fitted(Noise(np.full(11, 1e-5), "factor", start=True))
    error = np.sqrt(np.diagonal(np.linalg.inv(local.value_score_information(phi)[2][:4, :4])))
    assert np.abs(phi[:4] / truth - 1).max() < 0.01
    assert (np.abs(phi[:4] - truth) / error).max() < 3.5
    np.testing.assert_allclose(phi[4:8], 1e-5, rtol=1e-6)
    assert (local.gradient(phi)[4:8] < 0).all()
    assert 1.0 < phi[8] < 1.2
    assert hopper_fitted(1e-5)[1][4:8].max() > 0.5


# --- bad input


def test_start_noise_needs_the_signals_coordinates():
    class Odd(SlidingBlock):
        start_size = 5

    simulator = Odd(dt=0.2)
    (_, segments) = block_data()
    with pytest.raises(Incompatible) as refusal:
        Linear().bind(
            simulator,
            segments,
            Point(simulator.space),
            Noise(1e-3, start=True),
            np.random.default_rng(0),
        )
    assert str(refusal.value) == (
        "Noise on the start states needs a simulator whose start has the coordinates of "
        "its 2 signals. Odd has 5 there."
        " Leave Noise(start=True) out."
    )


def test_other_likelihoods_can_refuse_this_noise():
    assert NoiseModel(0.1, 2).plain("X").shape.tolist() == [0.1, 0.1]
    for noise in (Noise(0.1, start=True), Noise(0.1, degrees=4.0)):
        with pytest.raises(
            Incompatible, match="X knows no noise on the start states and no Student t"
        ):
            NoiseModel(noise, 2).plain("X")


@pytest.mark.parametrize("kind", LIKELIHOODS)
def test_signals_that_never_change(kind):
    """A constant signal tells nothing and does no harm: the same gradient as without it."""
    wide = lambda value, starts, actions: (
        starts[:, None] + actions * np.array([np.sin(value[0]), 0.0])
    )
    simulator = FunctionSimulator(wide, [Parameter("x", 0.1, 2.0)], ["a", "b"])
    one = FunctionSimulator(lambda *given: wide(*given)[..., :1], [Parameter("x", 0.1, 2.0)], ["a"])
    rng = np.random.default_rng(0)
    actions = rng.normal(size=(30, 1, 1))
    data = simulate(simulator, np.ones((30, 1)), actions, np.zeros(2))
    only = simulate(one, np.ones((30, 1)), actions, np.zeros(1))
    make = lambda s, d, noise: LIKELIHOODS[kind].linearize_at(
        s,
        d.segments(),
        TruncatedGaussian(s.space),
        noise,
        np.array([0.9]),
        np.array([0.1]),
        np.random.default_rng(0),
    )
    phi = np.array([0.95, 0.1])
    np.testing.assert_allclose(
        make(simulator, data, 1e-4).gradient(phi), make(one, only, 1e-4).gradient(phi), rtol=1e-6
    )
    for noise in (
        Noise(np.array([1e-4, 1e-30]), "each"),
        Noise(np.array([1e-4, 1e-30]), "each", start=True),
    ):
        value, scores, _ = make(simulator, data, noise).value_score_information(
            np.append(phi, [1.0, 1.0])
        )
        assert np.isfinite(value)
        assert np.isfinite(scores).all()


def test_a_covariance_without_an_inverse_is_named():
    """A huge spread against a tiny epsilon: which row, and what to do; NumPy and tensors alike."""
    torch = pytest.importorskip("torch")
    simulator = LinearSimulator(np.ones((1, 2, 1)))
    segments = simulate(simulator, np.zeros((3, 1)), np.ones((3, 1, 1)), np.zeros(2)).segments()
    family = TruncatedGaussian(simulator.space)
    local = Linear().linearize_at(
        simulator, segments, family, 1e-30, np.zeros(1), np.ones(1), np.random.default_rng(0)
    )
    for phi in (np.array([0.0, 1.0]), torch.tensor([0.0, 1.0])):
        with pytest.raises(
            BadArgument,
            match=r"covariance of row 0 is not positive definite: .* Give a larger epsilon",
        ):
            local.rows(phi)


@pytest.mark.parametrize("kind", ["linear", "unscented"])
def test_a_simulation_that_diverges_around_the_estimate_is_named(kind, monkeypatch):
    """Row, parameters and meaning; rows are counted over the blocks; the same for start states."""

    def function(value, starts, actions):
        out = starts[:, None] + actions * value[0]
        return np.where((starts[:, None] > 6.5) & (value[0] > 1.0), np.nan, out)

    monkeypatch.setattr(segment_blocks, "DESIGN_BYTES", 1)
    simulator = FunctionSimulator(function, [Parameter("x", 0.1, 2.0)], ["a"])
    data = simulate(simulator, np.full((10, 1), 0.9), np.ones((10, 1, 1)), np.zeros(1))
    segments = replace(data, observations=np.arange(10.0)[:, None]).segments()
    family = TruncatedGaussian(simulator.space)
    linearize_at = LIKELIHOODS[kind].linearize_at
    with pytest.raises(
        SimulationFailed,
        match=r"^1 of 3 simulated rows diverged, the first at row 7 with x = .* No slopes can be"
        " taken",
    ):
        linearize_at(
            simulator,
            segments,
            family,
            1e-3,
            np.array([0.95]),
            np.array([0.5]),
            np.random.default_rng(0),
        )
    assert np.isfinite(
        linearize_at(
            simulator,
            segments,
            family,
            1e-3,
            np.array([0.5]),
            np.array([0.1]),
            np.random.default_rng(0),
        ).gradient([0.5, 0.1])
    ).all()


def test_steps_stay_within_what_is_possible():
    """At a bound the second step goes to the other side, twice as far: slopes and curvatures of a
    parabola are exact still.
    """
    parabola = lambda value, starts, actions: (
        starts[:, None] + actions * (3 * value[0] + 2 * value[0] ** 2)
    )
    seen = []

    def spying(value, starts, actions):
        seen.append(value[0])
        return parabola(value, starts, actions)

    simulator = FunctionSimulator(spying, [Parameter("x", 0.0, 1.0, upper=1.0)], ["a"])
    segments = simulate(simulator, np.full((3, 1), 0.5), np.ones((3, 1, 1)), np.zeros(1)).segments()
    for centre in (0.0, 0.01, 0.5, 1.0):
        found = along_parameters(simulator, segments, np.array([centre]), np.array([0.1]))
        np.testing.assert_allclose(found.slope.ravel(), 3 + 4 * centre, rtol=1e-9)
        np.testing.assert_allclose(found.curvature.ravel(), 4.0, rtol=1e-9)
    assert min(seen) >= 0
    assert max(seen) <= 1
    assert axial.STEPS.least > 0
    tiny = along_parameters(simulator, segments, np.array([0.5]), np.zeros(1))
    np.testing.assert_allclose(tiny.slope.ravel(), 5.0, rtol=1e-6)
