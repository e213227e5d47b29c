"""The emulated likelihood against closed forms, quadrature and brute force; its standard laws and
its inner solver.
"""

from dataclasses import replace
from itertools import product
from math import erf, exp, pi, sqrt

import numpy as np
import pytest
import scipy.optimize
from scipy import integrate, stats

from dropo.core.contracts.fisher_scoring import FisherScoringSettings, maximize_locally
from dropo.core.contracts.likelihood import LocalLogLikelihood
from dropo.core.contracts.noise import Noise
from dropo.core.contracts.problem import Problem
from dropo.core.numerics.standard_distributions import NORMAL, TRUNCATED_NORMAL, UNIFORM
from dropo.core.records.parameters import Parameter, ParameterSpace
from dropo.core.services.errors import BadArgument, Incompatible, SimulationFailed
from dropo.core.services.registry import find
from dropo.estimators.dropo import DROPO
from dropo.families.truncated_gaussian import SD, TruncatedGaussian
from dropo.likelihoods.emulated import Emulated
from dropo.likelihoods.support import blocks
from dropo.likelihoods.support.polynomials import (
    DESIGN,
    build,
    design_points,
    index_set,
    orders_for,
)
from dropo.simulators.function import FunctionSimulator
from dropo.simulators.toy import LinearSimulator, SlidingBlock, simulate
from dropo.testing import check_likelihood

FAMILIES = ("truncated_gaussian", "full", "uniform", "log_normal")
CORRELATION = 0.6
EPSILONS = {
    "fixed": 1e-3,
    "one": Noise(np.full(2, 1e-3), "factor"),
    "each": Noise(np.array([1e-3, 2e-3]), "each"),
}


def member(family, mean, scale):
    """phi; with correlation 0.6 of the first two parameters where the family has one."""
    phi = family.phi(mean, scale)
    if len(phi) > 2 * len(mean):
        phi[2 * len(mean)] = CORRELATION
    return phi


def built(likelihood, simulator, segments, family, epsilon, width, seed=0):
    """The likelihood around (1.5 kg, 0.8 N s/m)."""
    return likelihood.linearize_at(
        simulator,
        segments,
        family,
        epsilon,
        np.array([1.5, 0.8]),
        np.array(width),
        np.random.default_rng(seed),
    )


def block_data(rng, rows=12):
    """A sliding block with another draw of mass and damping in every push of 5 steps."""
    simulator = SlidingBlock(dt=0.2)
    values = np.array([1.5, 0.8]) + np.array([0.2, 0.1]) * rng.standard_normal((rows, 2))
    actions = np.repeat(rng.normal(0.0, 3.0, (rows, 1, 1)), 5, axis=1)
    data = simulate(simulator, values, actions, np.array([0.0, 1.0]), noise_variance=1e-4, rng=rng)
    return simulator, data.segments(5)


# --- the value


def test_keeps_to_the_contract():
    """The checks that plug-in authors call are silent."""
    check_likelihood(Emulated())


@pytest.mark.parametrize("name", ["truncated_gaussian", "full", "uniform"])
def test_linear_simulator_has_the_closed_form(name):
    """o + M(a) xi with covariance M S M' + diag(epsilon), to 1e-9; sigma in place of the sd of a
    cut Gaussian is rejected.
    """
    rng = np.random.default_rng(5)
    simulator = LinearSimulator(rng.normal(size=(2, 3, 2)))
    values = np.array([1.0, -2.0]) + rng.normal(size=(25, 2))
    actions = rng.normal(size=(25, 1, 2))
    data = simulate(simulator, values, actions, np.zeros(3), noise_variance=0.01, rng=rng)
    segments = data.segments()
    epsilon = np.array([0.01, 0.02, 0.05])
    family = find("families", name)(simulator.space)
    phi = member(family, [1.0, -2.0], [0.5, 0.9])
    local = Emulated().linearize_at(
        simulator, segments, family, epsilon, np.array([1.1, -1.9]), np.array([0.4, 0.7]), rng
    )

    def closed_form(sd):
        covariance = family.correlation(phi) * np.outer(sd, sd)
        rows = []
        for start, action, target in zip(
            segments.starts, segments.actions[:, 0], segments.targets, strict=True
        ):
            m = np.einsum("q,qpd->pd", action, simulator.matrices)
            rows.append(
                stats.multivariate_normal(
                    start + m @ family.mean(phi), m @ covariance @ m.T + np.diag(epsilon)
                ).logpdf(target)
            )
        return np.array(rows)

    np.testing.assert_allclose(local.rows(phi), closed_form(family.sd(phi)), rtol=0, atol=1e-9)
    assert local(phi) == pytest.approx(local.rows(phi).sum(), rel=1e-13)
    if name == "truncated_gaussian":
        assert abs(local(phi) - closed_form(family.scale(phi)).sum()) > 0.1


def cubic(values, starts, actions):
    """Two polynomials of total degree 3 in the parameters (or in their logarithms), scaled by the
    action.
    """
    x, y = values
    return starts[:, None] + actions * np.array([x**3 - 2 * x * y + y, 1 + x * y**2 + 0.5 * y**2])


def cubic_of_logarithms(values, starts, actions):
    return cubic(np.log(values), starts, actions)


def quadrature(name, mean, scale):
    """Tensor nodes (Q, 2), for the law's values or their logarithms, and weights (Q,), from scipy's
    rules and densities.
    """
    if name in ("full", "log_normal"):
        z, w = np.polynomial.hermite_e.hermegauss(12)
        w = w / w.sum()
    else:
        z, w = np.polynomial.legendre.leggauss(60)
        w = w / 2
        if name == "truncated_gaussian":
            z, w = 2 * z, w * np.exp(-2 * z**2)
            w = w / w.sum()
    nodes = np.array(list(product(z, z)))
    weights = np.prod(list(product(w, w)), axis=1)
    if name == "full":
        nodes = nodes @ np.linalg.cholesky(np.array([[1, CORRELATION], [CORRELATION, 1]])).T
    centre = np.log(mean) - np.square(scale) / 2 if name == "log_normal" else np.asarray(mean)
    return centre + np.asarray(scale) * nodes, weights


@pytest.mark.parametrize("name", FAMILIES)
def test_moments_of_a_polynomial_are_exact(name):
    """A cubic function's mean and covariance agree with tensor quadrature to 1e-10, around a centre
    that is not the mean.
    """
    mean = [1.2, 0.9]
    scale = [0.15, 0.2]
    logarithmic = name == "log_normal"
    simulator = FunctionSimulator(
        cubic_of_logarithms if logarithmic else cubic,
        [Parameter("x", 0.1, 4.0), Parameter("y", 0.1, 4.0)],
        ["a", "b"],
    )
    rng = np.random.default_rng(0)
    data = simulate(simulator, np.full((6, 2), 1.1), rng.uniform(0.5, 2, (6, 1, 2)), np.zeros(2))
    segments = data.segments()
    family = find("families", name)(simulator.space)
    local = Emulated(order=3).linearize_at(
        simulator, segments, family, 1e-12, np.array([1.1, 1.0]), np.array([0.2, 0.1]), rng
    )
    found, sigma = local.moments(member(family, mean, scale))
    nodes, weights = quadrature(name, mean, scale)
    exact = np.stack(
        [cubic(x, np.zeros((len(segments), 2)), segments.actions)[:, 0] for x in nodes]
    )  # (Q, R, p)
    first = np.einsum("q,qrp->rp", weights, exact)
    second = np.einsum("q,qrp,qrs->rps", weights, exact - first, exact - first)
    np.testing.assert_allclose(found, segments.starts + first, rtol=0, atol=1e-10)
    np.testing.assert_allclose(sigma, second, rtol=0, atol=1e-10)


def z_of_moments(local, family, phi, simulator, segments, draws):
    """How many standard errors the means, variances and covariances of emulator and simulations are
    apart, (R, 5).
    """
    values = family.map(phi, np.random.default_rng(3).random((draws, 2)))
    simulated = simulator.predict(values, segments)
    mean, sigma = local.moments(phi)
    centred = simulated - simulated.mean(axis=0)
    products = np.stack(
        [centred[..., 0] ** 2, centred[..., 1] ** 2, centred[..., 0] * centred[..., 1]], axis=-1
    )
    claimed = np.stack([sigma[:, 0, 0], sigma[:, 1, 1], sigma[:, 0, 1]], axis=-1) - [
        *local.epsilon(phi),
        0.0,
    ]
    both = np.concatenate([simulated - mean, products - claimed], axis=2)  # (K, R, 5), of mean 0
    return both.mean(axis=0) * np.sqrt(draws) / both.std(axis=0)


@pytest.mark.parametrize("name", FAMILIES)
def test_moments_agree_with_brute_force(name):
    """On a sliding block, 5,000 simulations (10,000 of the skewed law) have its means and
    covariances within 4.5 standard errors; a linear emulator is rejected.
    """
    simulator, segments = block_data(np.random.default_rng(1))
    family = find("families", name)(simulator.space)
    scale = np.array([0.25, 0.15]) / (np.array([1.5, 0.8]) if name == "log_normal" else 1)
    phi = member(family, [1.5, 0.8], scale)
    around = lambda order: built(
        Emulated(order=order), simulator, segments, family, 1e-6, [0.2, 0.12]
    )
    draws = 10_000 if name == "log_normal" else 5_000
    z = lambda order: z_of_moments(around(order), family, phi, simulator, segments, draws)
    assert np.abs(z(5)).max() < 4.5
    assert np.abs(z(1)).max() > 4.5


def test_rows_sum_and_their_order_does_not_matter():
    """The log-likelihood is the sum of its rows, and turned data give turned rows."""
    simulator, segments = block_data(np.random.default_rng(2))
    family = TruncatedGaussian(simulator.space)
    phi = family.phi([1.4, 0.8], [0.2, 0.1])
    make = lambda part: built(Emulated(), simulator, part, family, 1e-4, [0.2, 0.1])
    turn = np.random.default_rng(0).permutation(len(segments))
    one = make(segments)
    turned = make(segments.take(turn))
    assert one(phi) == pytest.approx(one.rows(phi).sum(), rel=1e-14)
    assert one.rows(phi).shape == (len(segments),)
    np.testing.assert_allclose(turned.rows(phi), one.rows(phi)[turn], rtol=1e-9)


def test_point_family_has_no_spread():
    """A point's rows are normal around the emulated prediction, with epsilon and the polynomials'
    misfit alone.
    """
    simulator, segments = block_data(np.random.default_rng(2))
    family = find("families", "point")(simulator.space)
    local = built(Emulated(), simulator, segments, family, 1e-4, [0.05, 0.05])
    phi = np.array([1.52, 0.78])
    sigma = local.emulator.residual + 1e-4 * np.eye(2)
    mean = local.emulator.predict(phi[None])[0]
    by_hand = [
        stats.multivariate_normal(m, s).logpdf(y)
        for m, s, y in zip(mean, sigma, segments.targets, strict=True)
    ]
    np.testing.assert_allclose(local.rows(phi), by_hand, rtol=1e-9)
    np.testing.assert_allclose(
        local.mean(phi), simulator.predict(phi[None], segments)[0], atol=1e-5
    )


# --- gradient and information


@pytest.mark.parametrize("kind", EPSILONS)
@pytest.mark.parametrize("name", [*FAMILIES, "point"])
def test_gradient_is_that_of_the_value(name, kind):
    """Central differences of the value, to 1e-5 of each component; for every family, epsilon fixed,
    one factor and each its own.
    """
    simulator, segments = block_data(np.random.default_rng(4))
    family = find("families", name)(simulator.space)
    local = built(Emulated(), simulator, segments, family, EPSILONS[kind], [0.25, 0.15])
    own = local.unknowns.names[len(family.unknowns) :]
    assert own == {"fixed": (), "one": ("epsilon",), "each": ("epsilon[0]", "epsilon[1]")}[kind]
    relative = np.array([1.5, 0.8]) if name == "log_normal" else 1.0
    phi = np.append(
        member(family, [1.45, 0.85], np.array([0.17, 0.09]) / relative),
        np.array([1.3, 0.6])[: len(own)],
    )
    half = 1e-4 * np.abs(phi)

    def slope(i, h):
        step = h * np.eye(len(phi))[i]
        return (local(phi + step) - local(phi - step)) / (2 * h)

    by_difference = np.array(
        [(4 * slope(i, h / 2) - slope(i, h)) / 3 for i, h in enumerate(half)]
    )  # Richardson: truncation ~ h^4
    np.testing.assert_allclose(local.gradient(phi), by_difference, rtol=1e-5)
    assert local.value_score_information(phi)[0] == pytest.approx(local(phi), rel=1e-13)
    assert local.has_gradients


def test_information_is_the_covariance_of_the_score(monkeypatch):
    """Over 1500 simulated data sets, the score's mean is 0 and its covariance the information,
    within 4.5 standard errors.

    The controls: information 1.2 times as large, and the score at a mean half a scale away, are
    rejected.
    """
    simulator, segments = block_data(np.random.default_rng(4), rows=5)
    family = find("families", "full")(simulator.space)
    local = built(Emulated(), simulator, segments, family, EPSILONS["each"], [0.2, 0.1])
    phi = np.append(member(family, [1.5, 0.8], [0.2, 0.1]), [1.0, 1.0])
    count = 1500
    rng = np.random.default_rng(7)
    mean, sigma = local.moments(phi)
    root = np.linalg.cholesky(sigma)
    away = phi + 0.1 * np.eye(len(phi))[0]
    own = [local._own(at) for at in (phi, away)]
    slopes = {tuple(one): local._member_slopes(one) for one in own}  # the same for all data
    monkeypatch.setattr(local, "_member_slopes", lambda one: slopes[tuple(one)])
    scores = np.empty((count, len(phi)))
    others = np.empty((count // 5, len(phi)))
    for i in range(count):
        local.targets = mean + np.einsum("rpq,rq->rp", root, rng.standard_normal(mean.shape))
        scores[i] = local.gradient(phi)
        if i < len(others):
            others[i] = local.gradient(away)
    information = local.value_score_information(phi)[2]
    z_of_mean = lambda s: s.mean(axis=0) * np.sqrt(len(s)) / s.std(axis=0)
    assert np.abs(z_of_mean(scores)).max() < 4.5 < np.abs(z_of_mean(others)).max()
    products = scores[:, :, None] * scores[:, None]
    error = products.std(axis=0) / np.sqrt(count)
    assert (np.abs(products.mean(axis=0) - information) / error).max() < 4.5
    assert (np.abs(products.mean(axis=0) - 1.2 * information) / error).max() > 4.5


# --- the design


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

    monkeypatch.setattr(blocks, "DESIGN_BYTES", size)
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


def test_draws_that_would_leave_what_is_possible_are_told():
    """A law that reaches below 0, where no draw may go, is named with its share; one well above 0
    is not.
    """
    simulator = FunctionSimulator(
        lambda value, starts, actions: starts[:, None] + actions * value,
        [Parameter("x", 0.0, 4.0)],
        ["a"],
    )

    def warnings(mean, sd):
        rng = np.random.default_rng(0)
        values = np.abs(rng.normal(mean, sd, (200, 1)))
        data = simulate(
            simulator, values, np.ones((200, 1, 1)), np.zeros(1), noise_variance=1e-4, rng=rng
        )
        return [
            w
            for w in DROPO(epsilon=1e-4).fit(Problem("x", simulator, data)).warnings
            if w.startswith("draws of x (")
        ]

    assert len(warnings(0.0, 1.0)) == 1
    assert warnings(2.0, 0.2) == []


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


def test_a_family_without_a_standard_law_is_refused():
    class Nameless(TruncatedGaussian):
        standard = None

    simulator, segments = block_data(np.random.default_rng(1))
    with pytest.raises(Incompatible) as refusal:
        Emulated().bind(
            simulator, segments, Nameless(simulator.space), 1e-4, np.random.default_rng(0)
        )
    expected = (
        "The family Nameless names no standard distribution, so its moments are not known. Use "
        "likelihood 'monte-carlo'."
    )
    assert str(refusal.value) == expected


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
    are 4; a first look stops at 2.
    """
    space = ParameterSpace(tuple(Parameter(name, 0.0, 2.0) for name in "abcd"))
    width = 2 * np.array([1e-3, 5e-3, 0.02, 0.1])
    assert orders_for(width, space, None, rough=False).tolist() == [1, 2, 3, 4]
    assert orders_for(width, space, None, rough=True).tolist() == [1, 2, 2, 2]
    assert orders_for(width, space, 3, rough=False).tolist() == [3, 3, 3, 3]


# --- standard laws


LAWS = {
    "normal": (NORMAL, stats.norm(), 9.0),
    "uniform": (UNIFORM, stats.uniform(-1, 2), 1.0),
    "truncated normal": (TRUNCATED_NORMAL, stats.truncnorm(-2, 2), 2.0),
}


@pytest.mark.parametrize("name", LAWS)
def test_polynomials_are_orthonormal(name):
    """Degrees 0 to 5, by adaptive integration against scipy's density; the normal's polynomials
    under another law are not.
    """
    distribution, reference, reach = LAWS[name]
    x = np.linspace(-reach, reach, 40_001)
    gram = lambda own: integrate.simpson(
        np.einsum("xi,xj,x->xij", own.orthonormal(x, 5), own.orthonormal(x, 5), reference.pdf(x)),
        x=x,
        axis=0,
    )
    np.testing.assert_allclose(gram(distribution), np.eye(6), atol=1e-8)
    other = UNIFORM if distribution is NORMAL else NORMAL
    assert np.abs(gram(other) - np.eye(6)).max() > 0.1


@pytest.mark.parametrize("name", LAWS)
def test_rule_and_quantiles_are_those_of_the_law(name):
    """The Gauss rule's first eight moments, and the quantiles, are scipy's."""
    distribution, reference, _ = LAWS[name]
    assert distribution.weights.sum() == pytest.approx(1.0, rel=1e-13)
    for k in range(1, 9):
        assert distribution.weights @ distribution.nodes**k == pytest.approx(
            reference.moment(k), rel=1e-8, abs=1e-10
        )
    base = np.linspace(0.01, 0.99, 99)
    np.testing.assert_allclose(distribution.quantile(base), reference.ppf(base), atol=1e-12)


def test_a_normal_cut_at_two_has_sd_0_8796():
    """sqrt(1 - 2 c phi(c) / (2 Phi(c) - 1)) at c = 2: the published remark's factor, and the rule's
    second moment.
    """
    by_hand = sqrt(1 - 4 * exp(-2) / sqrt(2 * pi) / erf(sqrt(2)))
    assert by_hand == pytest.approx(0.8796, abs=5e-5)
    assert pytest.approx(by_hand, rel=1e-13) == SD
    assert np.sqrt(TRUNCATED_NORMAL.weights @ TRUNCATED_NORMAL.nodes**2) == pytest.approx(
        by_hand, rel=1e-12
    )


# --- Fisher scoring


class Textbook(LocalLogLikelihood):
    """A log-likelihood from a function to its value, score and information."""

    def __init__(self, value_score_information, *parameters):
        self.unknowns = ParameterSpace(parameters)
        self._expand = value_score_information

    def value_score_information(self, phi):
        value, score, information = self._expand(phi)
        return value, score[None], information

    def predict(self, values):
        raise NotImplementedError

    def _rows(self, phi):
        return np.array([self._expand(phi)[0]])

    def epsilon(self, phi):
        return np.zeros(0)

    def mean(self, phi):
        return np.zeros((1, 0))


def regression(low, high):
    """Normal linear regression: a concave quadratic with correlated unknowns."""
    rng = np.random.default_rng(0)
    x = rng.normal(size=(40, 3)) @ np.array([[1, 0.8, 0], [0, 1, 0.5], [0, 0, 1]])
    y = x @ [1.0, -2.0, 0.5] + rng.normal(size=40)
    value_score_information = lambda b: (
        -0.5 * float(np.sum((y - x @ b) ** 2)),
        x.T @ (y - x @ b),
        x.T @ x,
    )
    return Textbook(
        value_score_information, *(Parameter(f"b{i}", low, high) for i in range(3))
    ), scipy.optimize.lsq_linear(x, y, (low, high), tol=1e-14).x


def logistic(low, high):
    """Logistic regression; the answer by scipy's bounded quasi-Newton method."""
    rng = np.random.default_rng(1)
    x = np.column_stack([np.ones(200), rng.normal(size=(200, 2))])
    y = rng.random(200) < 1 / (1 + np.exp(-x @ [0.3, 1.0, -1.5]))

    def value_score_information(b):
        chance = 1 / (1 + np.exp(-x @ b))
        value = float(np.sum(np.where(y, np.log(chance), np.log1p(-chance))))
        return value, x.T @ (y - chance), (x * (chance * (1 - chance))[:, None]).T @ x

    cost = lambda b: (-value_score_information(b)[0], -value_score_information(b)[1])
    answer = scipy.optimize.minimize(
        cost, np.zeros(3), jac=True, bounds=[(low, high)] * 3, options={"ftol": 1e-15, "gtol": 1e-9}
    ).x
    return Textbook(
        value_score_information, *(Parameter(f"b{i}", low, high) for i in range(3))
    ), answer


def schools(effects):
    """Random effects y_i ~ N(mean, error_i^2 + scale^2), Rubin's (1981) eight schools' standard
    errors; the answer by profiling.
    """
    error = np.array([15.0, 10, 16, 11, 9, 11, 10, 18])
    y = np.array(effects, dtype=float)

    def value_score_information(phi):
        variance = error**2 + phi[1] ** 2
        score = np.array(
            [
                np.sum((y - phi[0]) / variance),
                phi[1] * np.sum((y - phi[0]) ** 2 / variance**2 - 1 / variance),
            ]
        )
        information = np.diag([np.sum(1 / variance), 2 * phi[1] ** 2 * np.sum(1 / variance**2)])
        return (
            -0.5 * float(np.sum((y - phi[0]) ** 2 / variance + np.log(variance))),
            score,
            information,
        )

    def best_mean(scale):
        weight = 1 / (error**2 + scale**2)
        return weight @ y / weight.sum()

    profile = scipy.optimize.minimize_scalar(
        lambda s: -value_score_information(np.array([best_mean(s), s]))[0],
        bounds=(0, 60),
        method="bounded",
        options={"xatol": 1e-10},
    )
    scale = max(1e-5, profile.x)
    if value_score_information(np.array([best_mean(1e-5), 1e-5]))[0] >= -profile.fun:
        scale = 1e-5
    space = Parameter("mean.effect", -100, 100), Parameter("scale.effect", 1e-5, 60, scale="log")
    return Textbook(value_score_information, *space), np.array([best_mean(scale), scale])


def noise_variance():
    """A normal variance, searched in logarithms: the answer is the mean square."""
    y = np.random.default_rng(2).normal(0.0, 0.02, 300)
    value_score_information = lambda v: (
        -0.5 * float(np.sum(y**2) / v[0] + len(y) * np.log(v[0])),
        np.array([0.5 * (np.sum(y**2) / v[0] ** 2 - len(y) / v[0])]),
        np.array([[0.5 * len(y) / v[0] ** 2]]),
    )
    return Textbook(
        value_score_information, Parameter("epsilon", 1e-8, 1e4, scale="log")
    ), np.array([np.mean(y**2)])


PROBLEMS = {
    "regression, inside": lambda: regression(-5.0, 5.0),
    "regression, on bounds": lambda: regression(-1.5, 0.2),
    "logistic, inside": lambda: logistic(-5.0, 5.0),
    "logistic, on bounds": lambda: logistic(-1.0, 0.5),
    "eight schools, no spread": lambda: schools([28, 8, -3, 7, -1, 1, 18, 12]),
    "eight schools, tripled": lambda: schools([84, 24, -9, 21, -3, 3, 54, 36]),
    "variance": noise_variance,
}


@pytest.mark.parametrize("name", PROBLEMS)
def test_scoring_finds_the_textbook_answer(name):
    """From the middle, both corners and five random starts; the same answer as scipy's, inside and
    on bounds.
    """
    problem, answer = PROBLEMS[name]()
    width = problem.unknowns.high - problem.unknowns.low
    units = [np.full(len(answer), u) for u in (0.5, 0.0, 1.0)] + list(
        np.random.default_rng(0).random((5, len(answer)))
    )
    for unit in units:
        start = problem.unknowns.from_unit(unit)
        found = maximize_locally(problem, start)
        assert found.converged, (name, start)
        assert found.value >= problem.value_score_information(answer)[0] - 1e-8
        np.testing.assert_allclose(
            found.phi,
            answer,
            atol=2e-5 * width.max(),
            rtol=2e-3 if "schools" in name or name == "variance" else 0,
        )


def test_eight_schools_have_a_certified_spread_of_zero():
    """The published effects have their maximum at scale 0 with the weighted mean 7.686; tripled, at
    a positive one.
    """
    problem, answer = PROBLEMS["eight schools, no spread"]()
    found = maximize_locally(problem, np.array([0.0, 20.0]))
    assert found.phi[0] == pytest.approx(7.686, abs=5e-4)
    assert found.phi[1] == problem.unknowns.low[1] == answer[1]
    assert found.score[1] < 0  # in the variance: the likelihood falls as it leaves 0
    assert PROBLEMS["eight schools, tripled"]()[1][1] > 10


def test_scoring_without_rounds_says_so():
    problem, _ = PROBLEMS["logistic, inside"]()
    assert not maximize_locally(
        problem, np.full(3, 4.0), FisherScoringSettings(evaluations=2)
    ).converged
