"""Whitening against dense covariance matrices, and the noise by expectation-maximisation."""

import numpy as np
import pytest
from scipy.stats import multivariate_t

from dropo.diagnosis.search.noise_learning import learn_noise
from dropo.diagnosis.search.whitening import (
    DEGREES,
    Whitener,
    WindowNoise,
    coloured_noise,
    white,
)

W = 7
STEPS = 4
P = 3
M = 5


@pytest.fixture
def case():
    """A whitener with random loadings, its dense covariances (W, n, n) and residuals (W, n)."""
    rng = np.random.default_rng(1)
    loadings = rng.normal(size=(W, STEPS * P, M))
    scale = rng.uniform(0.1, 2, M)
    sigma = rng.uniform(0.2, 1, P)
    dense = np.diag(np.tile(sigma**2, STEPS)) + loadings @ np.diag(scale**2) @ loadings.swapaxes(
        1, 2
    )
    return Whitener(loadings, scale, white(sigma)), dense, rng.normal(size=(W, STEPS * P))


def test_lengths_and_densities_are_those_of_the_dense_covariance(case):
    """Mahalanobis lengths, inner products of whitened residuals, and the multivariate t's log
    density, to rounding.
    """
    whitener, dense, residuals = case
    white = whitener(residuals)
    other = np.random.default_rng(2).normal(size=residuals.shape)
    inverse = np.linalg.inv(dense)
    np.testing.assert_allclose(
        (white * whitener(other)).sum(axis=1),
        np.einsum("wi,wij,wj->w", residuals, inverse, other),
        rtol=1e-10,
    )
    wanted = [
        multivariate_t.logpdf(r, shape=cov, df=DEGREES)
        for r, cov in zip(residuals, dense, strict=True)
    ]
    np.testing.assert_allclose(whitener.log_likelihood(residuals), wanted, rtol=1e-10)
    assert not np.allclose(
        Whitener(whitener.loadings, 2 * whitener.scale, whitener.noise).log_likelihood(residuals),
        wanted,
    )


def test_noise_and_forces_are_recovered():
    """sigma and the forces' sd within four standard errors over data sets; where there are no
    forces they vanish beside the noise.
    """
    rng = np.random.default_rng(3)
    sigma = np.array([0.5, 0.1, 0.2])
    force = np.array([0.7, 0.3])
    count = 300
    loadings = np.concatenate(
        [
            np.tile(np.eye(P), (STEPS, 1))[None].repeat(count, 0),
            rng.normal(size=(count, STEPS * P, 2 * STEPS)),
        ],
        axis=2,
    )

    def found(force):
        latent = np.concatenate(
            [
                sigma * rng.normal(size=(count, P)),
                np.tile(force, STEPS) * rng.normal(size=(count, 2 * STEPS)),
            ],
            axis=1,
        )
        errors = np.tile(sigma, STEPS) * rng.normal(size=(count, STEPS * P))
        # the t's scale matrix is the covariance of what is drawn over sqrt(gamma): windows differ
        # in size as the t has it
        size = np.sqrt(DEGREES / rng.chisquare(DEGREES, count))[:, None]
        residuals = size * (np.einsum("wnm,wm->wn", loadings, latent) + errors)
        return learn_noise(
            loadings,
            residuals,
            white(np.ones(P)),
            np.full(P, 1e-9),
            np.full(2, 0.1),
            rounds=400,
            tolerance=1e-5,
        )

    runs = [np.concatenate([noise.sigma, of]) for noise, of in map(found, 8 * [force])]
    mean = np.mean(runs, axis=0)
    error = np.std(runs, axis=0, ddof=1) / np.sqrt(len(runs))
    truth = np.concatenate([sigma, force])
    assert np.all(np.abs(mean - truth) < 4 * error + 0.005 * truth)
    assert np.all(np.abs(mean - 1.3 * truth) > 4 * error)  # the control
    assert np.all(found(np.zeros(2))[1] < 0.1 * force)


def test_noise_of_curved_starts_is_recovered():
    """Numbers beside the start's error that are as large as sigma count for it: within four
    standard errors over data sets, and every round of the search makes windows more likely, here
    from sigma that is far too high.
    """
    rng = np.random.default_rng(4)
    sigma = np.array([0.5, 0.1, 0.2])
    count = 200
    loadings = rng.normal(size=(count, STEPS * P, 2 * P))
    known = rng.normal(size=(count, STEPS * P, 1))

    def residuals():
        latent = np.concatenate(
            [np.tile(sigma, 2) * rng.normal(size=(count, 2 * P)), rng.normal(size=(count, 1))],
            axis=1,
        )
        drawn = np.einsum("wnm,wm->wn", np.concatenate([loadings, known], axis=2), latent)
        size = np.sqrt(DEGREES / rng.chisquare(DEGREES, count))[:, None]
        return size * (drawn + np.tile(sigma, STEPS) * rng.normal(size=drawn.shape))

    def likely(found, given):
        scale = np.concatenate([np.tile(found, 2), [1.0]])
        return (
            Whitener(np.concatenate([loadings, known], axis=2), scale, white(found))
            .log_likelihood(given)
            .sum()
        )

    runs = [
        learn_noise(
            loadings,
            residuals(),
            white(30 * sigma),
            np.full(P, 1e-9),
            known=known,
            rounds=400,
            tolerance=1e-6,
        )[0].sigma
        for _ in range(8)
    ]
    mean = np.mean(runs, axis=0)
    error = np.std(runs, axis=0, ddof=1) / np.sqrt(len(runs))
    assert np.all(np.abs(mean - sigma) < 4 * error)
    assert np.all(np.abs(mean - 1.3 * sigma) > 4 * error)  # the control
    given = residuals()
    now = 30 * sigma
    values = []
    for _ in range(20):
        values.append(likely(now, given))
        found, _ = learn_noise(loadings, given, white(now), np.full(P, 1e-9), known=known, rounds=1)
        now = found.sigma
    assert np.all(np.diff(values) > -1e-9 * np.abs(values[0]))


def test_the_least_noise_holds():
    """Residuals without any noise leave sigma at its floor, and everything finite."""
    loadings = np.tile(np.eye(P), (STEPS, 1))[None].repeat(20, 0)
    noise, _ = learn_noise(
        loadings, np.zeros((20, STEPS * P)), white(np.full(P, 1e-3)), np.full(P, 1e-7), rounds=200
    )
    sigma = noise.sigma
    np.testing.assert_allclose(sigma, 1e-7)
    assert np.isfinite(
        Whitener(loadings, sigma, noise).log_likelihood(np.zeros((20, STEPS * P)))
    ).all()


def test_windows_whose_starts_are_known():
    """Without latent numbers residuals are in units of the noise, for any number of predictions."""
    whiten = Whitener(np.zeros((3, 4, 0)), np.zeros(0), white(np.array([0.5, 2.0])))
    residuals = np.random.default_rng(0).normal(size=(5, 3, 4))
    np.testing.assert_allclose(whiten(residuals), residuals / [0.5, 2.0, 0.5, 2.0])
    np.testing.assert_allclose(whiten(residuals[0]), residuals[0] / [0.5, 2.0, 0.5, 2.0])


RHO = np.array([0.9, 0.0, -0.4])


def dense_with_colour(whitener):
    """(W, n, n) the covariance from that of each sensor's errors, the start's first."""
    whole = np.zeros((len(whitener.loadings), STEPS * P, STEPS * P))
    for signal, (sigma, rho) in enumerate(zip(whitener.sigma, whitener.noise.rho, strict=True)):
        apart = np.abs(np.subtract.outer(np.arange(STEPS + 1), np.arange(STEPS + 1)))
        errors = sigma**2 * np.where(apart > 0, float(rho) ** apart, 1.0)
        by_errors = np.zeros((len(whole), STEPS * P, STEPS + 1))
        by_errors[:, :, 0] = -whitener.loadings[:, :, signal]
        by_errors[:, np.arange(STEPS) * P + signal, np.arange(STEPS) + 1] = 1
        whole += by_errors @ errors @ by_errors.swapaxes(1, 2)
    rest = whitener.loadings[:, :, P:] * whitener.scale[P:]
    return whole + rest @ rest.swapaxes(1, 2)


def test_errors_that_follow_each_other_against_the_dense_covariance(case):
    """Lengths, densities, covariances and deviations where the start's error goes on in those
    after it, to rounding; white noise of the same size is another covariance.
    """
    plain, dense_white, residuals = case
    scale = np.concatenate([plain.sigma, plain.scale[P:]])
    whitener = Whitener(plain.loadings, scale, WindowNoise(plain.sigma, RHO))
    dense = dense_with_colour(whitener)
    wanted = [
        multivariate_t.logpdf(r, shape=cov, df=DEGREES)
        for r, cov in zip(residuals, dense, strict=True)
    ]
    np.testing.assert_allclose(whitener.log_likelihood(residuals), wanted, rtol=1e-10)
    places = np.array([0, 4, 7, 11])
    np.testing.assert_allclose(
        whitener.covariance(places), dense[:, places[:, None], places], rtol=1e-10, atol=1e-12
    )
    variances = np.diagonal(dense, axis1=1, axis2=2)
    np.testing.assert_allclose(whitener.deviations**2, variances, rtol=1e-10)
    same_size = Whitener(plain.loadings, scale, white(plain.sigma))
    assert not np.allclose(same_size.log_likelihood(residuals), wanted)
    np.testing.assert_allclose(plain.covariance(np.arange(STEPS * P)), dense_white, rtol=1e-10)


def coasting(rho, rng, count=150, steps=8, size=(1e-3, 1e-2)):
    """Loadings and residuals of windows of a body that coasts, its position and velocity measured
    with errors that follow each other.
    """
    jacobian = np.stack([[[1, 0.01 * k], [0, 1]] for k in range(1, steps + 1)])
    errors = np.empty((count, steps + 1, 2))
    errors[:, 0] = rng.standard_normal((count, 2))
    for k in range(steps):
        fresh = rng.standard_normal((count, 2))
        errors[:, k + 1] = rho * errors[:, k] + np.sqrt(1 - rho**2) * fresh
    errors *= size
    residuals = errors[:, 1:] - np.einsum("kij,wj->wki", jacobian, errors[:, 0])
    loadings = np.repeat(jacobian.reshape(1, 2 * steps, 2), count, axis=0)
    return loadings, residuals.reshape(count, -1)


def test_colour_of_noise_is_recovered():
    """Coefficients and standard deviations within four standard errors over data sets (sigma of
    the t a few per cent below that of Gaussian errors); the same of noise half as coloured are not.
    """
    rho = np.array([0.8, 0.4])
    size = np.array([1e-3, 1e-2])
    runs = []
    for seed in range(10):
        loadings, residuals = coasting(rho, np.random.default_rng(seed))
        plain, _ = learn_noise(loadings, residuals, white(size), 1e-6 * size)
        asked = coloured_noise(Whitener(loadings, plain.sigma, plain), residuals, 1e-6 * size)
        found, _ = learn_noise(loadings, residuals, asked, 1e-6 * size)
        runs.append(np.concatenate([found.rho, found.sigma / size]))
    mean = np.mean(runs, axis=0)
    error = np.std(runs, axis=0, ddof=1) / np.sqrt(len(runs))
    assert np.all(np.abs(mean - [0.8, 0.4, 1, 1]) < 4 * error + [0, 0, 0.06, 0.06])
    assert np.all(np.abs(mean[:2] - 0.5 * rho) > 4 * error[:2])  # the control


def asked(rho, count, floor):
    """Of so many data sets, those in which some signal's noise is not taken to be white."""
    size = np.array([1e-3, 1e-2])
    found = []
    for seed in range(count):
        loadings, residuals = coasting(np.full(2, rho), np.random.default_rng(seed))
        plain, _ = learn_noise(loadings, residuals, white(size), floor * size)
        whitener = Whitener(loadings, plain.sigma, plain)
        found.append(coloured_noise(whitener, residuals, floor * size) is not None)
    return sum(found)


def test_white_noise_asks_for_no_colour():
    """In at most 3 of 60 data sets of two signals, of which the level of three standard errors
    has 0.3 on average; nor does coloured noise near its lower bound, which is none. Coloured noise
    asks for it in all (the control).
    """
    assert asked(0.0, 60, 1e-6) <= 3
    assert asked(0.9, 3, 1.0) == 0
    assert asked(0.4, 3, 1e-6) == 3


@pytest.mark.parametrize("off", [1e-3, 30.0])
def test_coloured_noise_from_a_guess_that_is_far_off(off):
    """The same noise as from the true one, in two goes: the first ends within a factor of 100."""
    size = np.array([1e-3, 1e-2])
    rho = np.array([0.8, 0.4])
    loadings, residuals = coasting(rho, np.random.default_rng(0))
    near, _ = learn_noise(loadings, residuals, WindowNoise(size, rho), 1e-9 * size)
    found = WindowNoise(off * size, np.full(2, 0.9))
    for _ in range(2):
        found, _ = learn_noise(loadings, residuals, found, 1e-9 * size)
    np.testing.assert_allclose(found.rho, near.rho, atol=0.01)
    np.testing.assert_allclose(found.sigma, near.sigma, rtol=0.02)
