"""The thesis' likelihood against its slow twin, a closed form, and its refusals."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from dropo.core.contracts.noise import Noise
from dropo.core.services.errors import BadArgument
from dropo.families.truncated_gaussian import SD, TruncatedGaussian
from dropo.likelihoods.monte_carlo import MonteCarlo
from dropo.likelihoods.support import sample_moments
from dropo.simulators.toy import LinearSimulator, simulate
from dropo.testing import check_likelihood
from tests.reference.densities import gaussian_one_by_one


def test_keeps_to_the_contract():
    """The checks that plug-in authors call are silent."""
    check_likelihood(MonteCarlo())


@pytest.mark.parametrize("p", [1, 3, 11])
def test_agrees_with_the_slow_twin(p, monkeypatch):
    """Rows in blocks of seven give scipy's densities of numpy's moments."""
    rng = np.random.default_rng(0)
    predictions = 100.0 + rng.normal(size=(40, 30, p)) @ rng.normal(size=(p, p))
    targets = predictions[0] + 0.1
    epsilon = rng.uniform(0.01, 0.1, p)
    monkeypatch.setattr(sample_moments, "BLOCK", 7 * 40 * p)
    found = MonteCarlo().log_density(predictions, targets, epsilon)
    np.testing.assert_allclose(found, gaussian_one_by_one(predictions, targets, epsilon), rtol=1e-9)


def test_fresh_draws_belong_to_the_point():
    """Every phi has draws of its own, the same whenever it is evaluated, in any order and after
    others; neighbours differ by the noise of K draws, which the fixed draws do not show.
    """
    simulator, segments, family = linear_problem()
    points = family.phi(np.array([1.0, -2.0]), np.array([0.4, 0.8])) * (
        1 + 1e-9 * np.arange(12)[:, None]
    )
    values = {}
    for redraw in (False, True):
        settings = MonteCarlo(20, redraw=redraw)
        bound = settings.bind(simulator, segments, family, 0.01, np.random.default_rng(3))
        values[redraw] = np.array([bound(point) for point in points])
        again = settings.bind(simulator, segments, family, 0.01, np.random.default_rng(3))
        assert [again(point) for point in points[::-1]] == values[redraw][::-1].tolist()
    assert values[True].std() > 0.5
    assert values[False].std() < 1e-3
    assert len(set(values[True])) == 12


def linear_problem():
    """Known moments: y = o + M(a) xi.

    Data of 25 transitions, each with its own draw from sd 0.4 and 0.8, noise variance 0.01.
    """
    rng = np.random.default_rng(5)
    simulator = LinearSimulator(rng.normal(size=(2, 3, 2)))
    values = [1.0, -2.0] + rng.normal(size=(25, 2)) * [0.4, 0.8]
    actions = rng.normal(size=(25, 1, 2))
    segments = simulate(
        simulator, values, actions, np.zeros(3), noise_variance=0.01, rng=rng
    ).segments()
    return simulator, segments, TruncatedGaussian(simulator.space)


def exact_log_likelihood(simulator, segments, mean, sd, epsilon):
    """The limit for K to infinity: N(o + M mean, M diag(sd^2) M' + epsilon I) at every row."""
    total = 0.0
    for start, action, target in zip(
        segments.starts, segments.actions[:, 0], segments.targets, strict=True
    ):
        matrix = np.einsum("q,qpd->pd", action, simulator.matrices)
        covariance = matrix @ np.diag(np.square(sd)) @ matrix.T + epsilon * np.eye(len(target))
        total += multivariate_normal(start + matrix @ mean, covariance).logpdf(target)
    return total


def test_linear_simulator_has_the_exact_likelihood():
    """Over 16 base sets of K = 2048, the mean log-likelihood is the exact one within 4.5 standard
    errors, themselves under 0.05 nat.

    The control: taking sigma for the standard deviation, without the factor 0.88 of the cut, is
    rejected.
    """
    simulator, segments, family = linear_problem()
    mean = np.array([1.0, -2.0])
    scale = np.array([0.5, 0.9])
    phi = family.phi(mean, scale)
    found = np.array(
        [
            MonteCarlo(2048).bind(simulator, segments, family, 0.01, rng)(phi)
            for rng in np.random.default_rng(0).spawn(16)
        ]
    )
    error = found.std(ddof=1) / np.sqrt(len(found))
    assert error < 0.05
    assert (
        abs(found.mean() - exact_log_likelihood(simulator, segments, mean, SD * scale, 0.01))
        < 4.5 * error
    )
    assert (
        abs(found.mean() - exact_log_likelihood(simulator, segments, mean, scale, 0.01))
        > 4.5 * error
    )


def test_log_likelihood_is_the_sum_of_rows_and_deterministic():
    """The same seed gives the same function of phi; another seed another one."""
    simulator, segments, family = linear_problem()
    phi = family.phi([1.0, -2.0], [0.5, 0.9])
    one, same, other = (
        MonteCarlo(20).bind(simulator, segments, family, 0.01, np.random.default_rng(seed))
        for seed in (1, 1, 2)
    )
    assert one(phi) == same(phi) == one(phi) == one.rows(phi).sum() != other(phi)


def test_learned_epsilon_is_an_unknown():
    """A learned epsilon adds one unknown, the factor on its shape, on a log scale; the likelihood
    is that of their product.
    """
    simulator, segments, family = linear_problem()
    phi = family.phi([1.0, -2.0], [0.5, 0.9])
    given = MonteCarlo(20).bind(simulator, segments, family, 0.03, np.random.default_rng(0))
    learned = MonteCarlo(20).bind(
        simulator, segments, family, Noise(np.full(3, 0.01), "factor"), np.random.default_rng(0)
    )
    assert learned.unknowns.names == (*family.unknowns.names, "epsilon")
    assert learned.unknowns["epsilon"].scale == "log"
    np.testing.assert_allclose(learned.epsilon(np.append(phi, 3.0)), np.full(3, 0.03))
    assert learned(np.append(phi, 3.0)) == pytest.approx(given(phi), rel=1e-12)


def test_singular_without_epsilon_names_row_and_way_out():
    """Only the third row is singular, and the first row's simulation failed: the message counts all
    rows.
    """
    predictions = np.random.default_rng(0).normal(size=(20, 5, 2))
    predictions[4, 0] = np.nan
    predictions[:, 2, 1] = predictions[:, 2, 0]
    with pytest.raises(
        BadArgument,
        match=r"K = 20 predictions at row 2 is singular in p = 2 signals.* Give epsilon > 0",
    ):
        MonteCarlo().log_density(predictions, np.zeros((5, 2)), np.zeros(2))


@pytest.mark.parametrize("seed", range(5))
def test_fewer_draws_than_signals_without_epsilon(seed):
    """K <= p has no density without epsilon, whatever rounding does to the factor; with epsilon it
    has.
    """
    predictions = 50 * np.random.default_rng(seed).normal(size=(5, 3, 11))
    with pytest.raises(BadArgument, match=r"K = 5 predictions at row 0 is singular in p = 11"):
        MonteCarlo().log_density(predictions, np.zeros((3, 11)), 0.0)
    assert np.isfinite(MonteCarlo().log_density(predictions, np.zeros((3, 11)), 1e-4)).all()


def test_a_covariance_beyond_rounding_fails_its_row_alone():
    """With epsilon > 0, a row whose factor is lost in rounding is -inf, and the others keep their
    densities.
    """
    predictions = np.random.default_rng(0).normal(size=(20, 4, 2))
    whole = MonteCarlo().log_density(predictions, np.zeros((4, 2)), 1e-6)
    predictions[:, 1, 0] *= 1e9
    predictions[:, 1, 1] = predictions[:, 1, 0]
    lost = MonteCarlo().log_density(predictions, np.zeros((4, 2)), 1e-6)
    assert lost[1] == -np.inf
    np.testing.assert_array_equal(np.delete(lost, 1), np.delete(whole, 1))


def test_refusals():
    """K below 2, epsilon of the wrong kind, size or sign."""
    simulator, segments, family = linear_problem()
    with pytest.raises(
        BadArgument, match=r"'draws' of MonteCarlo must be at least 2, to have a covariance. Got 1"
    ):
        MonteCarlo(draws=1)
    for epsilon, words in (
        ([0.1, 0.2], "one for each of 3 signals"),
        (-0.1, "not negative"),
        (np.nan, "finite"),
    ):
        with pytest.raises(BadArgument, match=words):
            MonteCarlo().bind(simulator, segments, family, epsilon, np.random.default_rng(0))
    with pytest.raises(
        BadArgument, match=r"'predictions' of MonteCarlo.log_density must be of shape \(any, 4, 2\)"
    ):
        MonteCarlo().log_density(np.zeros((9, 4, 3)), np.zeros((4, 2)), 0.1)
