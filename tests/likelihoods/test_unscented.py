"""The unscented likelihood: exact moments of axial parabolas, and what it leaves out."""

import numpy as np
import pytest

from dropo.core.records.parameters import Parameter
from dropo.core.services.errors import Incompatible
from dropo.core.services.registry import find
from dropo.families.truncated_gaussian import TruncatedGaussian
from dropo.likelihoods.linear import Linear
from dropo.likelihoods.unscented import Unscented
from dropo.simulators.function import FunctionSimulator
from dropo.simulators.toy import LinearSimulator, simulate
from dropo.testing import check_likelihood

FAMILIES = ("truncated_gaussian", "full", "uniform", "log_normal")
CENTRE = np.array([1.1, 1.0])
MEAN = [1.2, 0.9]
SCALE = [0.15, 0.2]


def axial_parabola(value, starts, actions):
    """Two signals that are parabolas along each axis, without a crossed term."""
    x, y = value
    return starts[:, None] + actions * np.array(
        [x**2 - 2 * y + y**2, 1 + x - 3 * y**2 + 0.5 * x**2]
    )


def of_logarithms(value, starts, actions):
    """The same of the parameters' logarithms."""
    return axial_parabola(np.log(value), starts, actions)


def crossed(value, starts, actions):
    """With a crossed term."""
    return axial_parabola(value, starts, actions) + actions * 4 * value[0] * value[1]


def built(function, name, likelihood, epsilon=1e-12):
    """The likelihood of six rows, its simulator, segments, family and phi; phi has correlation 0.6
    where the family has one.
    """
    simulator = FunctionSimulator(
        function, [Parameter("x", 0.1, 4.0), Parameter("y", 0.1, 4.0)], ["a", "b"]
    )
    rng = np.random.default_rng(0)
    segments = simulate(
        simulator, np.full((6, 2), 1.1), rng.uniform(0.5, 2, (6, 1, 2)), np.zeros(2)
    ).segments()
    family = find("families", name)(simulator.space)
    phi = family.phi(MEAN, SCALE)
    if name == "full":
        phi[4] = 0.6
    return (
        likelihood.linearize_at(
            simulator, segments, family, epsilon, CENTRE, np.array([0.2, 0.1]), rng
        ),
        simulator,
        segments,
        family,
        phi,
    )


def z_of_moments(local, simulator, segments, family, phi, draws=8_000):
    """How many standard errors the means, variances and covariances of likelihood and simulations
    are apart, (R, 5).
    """
    simulated = simulator.predict(
        family.map(phi, np.random.default_rng(3).random((draws, 2))), segments
    )
    mean, sigma = local.moments(phi)
    centred = simulated - simulated.mean(axis=0)
    products = np.stack(
        [centred[..., 0] ** 2, centred[..., 1] ** 2, centred[..., 0] * centred[..., 1]], axis=-1
    )
    claimed = np.stack([sigma[:, 0, 0], sigma[:, 1, 1], sigma[:, 0, 1]], axis=-1)
    both = np.concatenate([simulated - mean, products - claimed], axis=2)
    return np.abs(both.mean(axis=0) * np.sqrt(draws) / both.std(axis=0)).max()


def test_keeps_to_the_contract():
    """The checks that plug-in authors call are silent."""
    check_likelihood(Unscented())


@pytest.mark.parametrize("name", FAMILIES)
def test_moments_of_axial_parabolas_are_exact(name):
    """8,000 simulations have its moments within 4.5 standard errors, away from the centre too; the
    linear ones are rejected.
    """
    function = of_logarithms if name == "log_normal" else axial_parabola
    assert z_of_moments(*built(function, name, Unscented())) < 4.5
    assert z_of_moments(*built(function, name, Linear())) > 4.5


def test_crossed_curvature_is_left_out():
    """x y has none along the axes: here correlations give it a mean that is missed."""
    assert z_of_moments(*built(crossed, "full", Unscented()), draws=30_000) > 4.5


def test_fourth_moments_are_the_laws_own():
    """Of one parabola under a uniform law: variance 4/45 of the squares, not a Gaussian's 2/9."""
    simulator = FunctionSimulator(
        lambda value, starts, actions: (starts + value**2)[:, None],
        [Parameter("x", -2.0, 2.0)],
        ["a"],
    )
    segments = simulate(simulator, np.zeros((1, 1)), np.ones((1, 1, 1)), np.zeros(1)).segments()
    for name, variance in (("uniform", 4 / 45), ("full", 2.0)):
        family = find("families", name)(simulator.space)
        local = Unscented().linearize_at(
            simulator, segments, family, 1e-12, np.zeros(1), np.ones(1), np.random.default_rng(0)
        )
        mean, sigma = local.moments(family.phi([0.0], [1.0]))
        assert sigma.item() == pytest.approx(variance, rel=1e-8)
        assert mean.item() == pytest.approx(1 / 3 if name == "uniform" else 1.0, rel=1e-9)


def test_equals_the_linear_one_where_nothing_curves():
    """For a linear simulator both are the same to rounding, value, scores and information."""
    rng = np.random.default_rng(5)
    simulator = LinearSimulator(rng.normal(size=(2, 3, 2)))
    data = simulate(
        simulator,
        rng.normal(size=(10, 2)),
        rng.normal(size=(10, 2, 2)),
        np.zeros(3),
        noise_variance=0.01,
        rng=rng,
    )
    family = TruncatedGaussian(simulator.space)
    one, other = (
        likelihood.linearize_at(
            simulator, data.segments(), family, 0.01, np.zeros(2), np.full(2, 0.5), rng
        )
        for likelihood in (Linear(), Unscented())
    )
    phi = family.phi([0.1, 0.2], [0.4, 0.3])
    for a, b in zip(
        one.value_score_information(phi), other.value_score_information(phi), strict=True
    ):
        np.testing.assert_allclose(a, b, rtol=1e-8, atol=1e-8)
    values = rng.normal(size=(4, 2))
    np.testing.assert_allclose(one.predict(values), other.predict(values), atol=1e-9)


def test_predicts_by_the_parabolas():
    local, simulator, segments, *_ = built(axial_parabola, "uniform", Unscented())
    values = np.array([[0.5, 1.5], [2.0, 0.3], [1.0, 1.0]])
    np.testing.assert_allclose(
        local.predict(values), simulator.predict(values, segments), atol=1e-10
    )


def test_a_family_without_a_standard_law_is_refused():
    class Nameless(TruncatedGaussian):
        standard = None

    with pytest.raises(Incompatible) as refusal:
        Unscented().linearize_at(
            *[None] * 2, Nameless(LinearSimulator(np.ones((1, 1, 1))).space), *[None] * 4
        )
    assert str(refusal.value) == (
        "The family Nameless names no standard distribution, so its fourth moments are not known. "
        "Use likelihood 'linear'."
    )
