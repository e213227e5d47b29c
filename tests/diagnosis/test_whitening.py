"""Whitening against dense covariance matrices, and the noise by expectation-maximisation."""

import numpy as np
import pytest
from scipy.stats import multivariate_t

from dropo.diagnosis.search.whitening import DEGREES, Whitener, learn_noise

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
    return Whitener(loadings, scale, sigma), dense, rng.normal(size=(W, STEPS * P))


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
        Whitener(whitener.loadings, 2 * whitener.scale, whitener.sigma).log_likelihood(residuals),
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
            np.ones(P),
            np.full(P, 1e-9),
            np.full(2, 0.1),
            rounds=400,
            tolerance=1e-5,
        )

    runs = [np.concatenate(found(force)) for _ in range(8)]
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
            Whitener(np.concatenate([loadings, known], axis=2), scale, found)
            .log_likelihood(given)
            .sum()
        )

    runs = [
        learn_noise(
            loadings,
            residuals(),
            30 * sigma,
            np.full(P, 1e-9),
            known=known,
            rounds=400,
            tolerance=1e-6,
        )[0]
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
        now = learn_noise(loadings, given, now, np.full(P, 1e-9), known=known, rounds=1)[0]
    assert np.all(np.diff(values) > -1e-9 * np.abs(values[0]))


def test_the_least_noise_holds():
    """Residuals without any noise leave sigma at its floor, and everything finite."""
    loadings = np.tile(np.eye(P), (STEPS, 1))[None].repeat(20, 0)
    sigma, _ = learn_noise(
        loadings, np.zeros((20, STEPS * P)), np.full(P, 1e-3), np.full(P, 1e-7), rounds=200
    )
    np.testing.assert_allclose(sigma, 1e-7)
    assert np.isfinite(
        Whitener(loadings, sigma, sigma).log_likelihood(np.zeros((20, STEPS * P)))
    ).all()


def test_windows_whose_starts_are_known():
    """Without latent numbers residuals are in units of the noise, for any number of predictions."""
    whiten = Whitener(np.zeros((3, 4, 0)), np.zeros(0), np.array([0.5, 2.0]))
    residuals = np.random.default_rng(0).normal(size=(5, 3, 4))
    np.testing.assert_allclose(whiten(residuals), residuals / [0.5, 2.0, 0.5, 2.0])
    np.testing.assert_allclose(whiten(residuals[0]), residuals[0] / [0.5, 2.0, 0.5, 2.0])
