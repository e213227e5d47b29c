"""The emulated likelihood against closed forms, quadrature and brute force."""

from itertools import product

import numpy as np
import pytest
from scipy import stats

from dropo.core.contracts.noise import Noise
from dropo.core.contracts.problem import Problem
from dropo.core.records.parameters import Parameter
from dropo.core.services.errors import Incompatible
from dropo.core.services.registry import find
from dropo.estimators.dropo import DROPO
from dropo.families.truncated_gaussian import TruncatedGaussian
from dropo.likelihoods.emulated import Emulated
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
