"""Windows with a noisy start state, integrated out: whitened residuals, their likelihood, and the
noise by expectation-maximisation.

A window's residual (n,) is r = B z + e, with e ~ N(0, diag(sigma^2)) in every step and latent z ~
N(0, diag(scale^2)): the error of the measured start, and where wanted unexplained forces. With the
loadings A = diag(1 / sigma) B diag(scale), the covariance is diag(sigma) (I + A A') diag(sigma).
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.special import gammaln

from dropo.core.numerics.robust_statistics import student_t_weights
from dropo.core.services.validation import Array

DEGREES = 8.0  # of freedom of the Student t that keeps windows across an impact from ruling


@dataclass(frozen=True, eq=False)
class Whitener:
    """loadings: B (W, n, m); scale: (m,) standard deviations of the latent numbers; sigma: (p,) of
    the signals, p divides n.
    """

    loadings: Array
    scale: Array
    sigma: Array

    @cached_property
    def rows(self) -> Array:
        """(n,) the standard deviation of each entry of a window."""
        return np.tile(self.sigma, self.loadings.shape[1] // len(self.sigma))

    @cached_property
    def scaled(self) -> Array:
        """A (W, n, m), in that order in memory, which products of it want."""
        return np.ascontiguousarray(self.loadings * self.scale / self.rows[:, None])

    @cached_property
    def inner(self) -> Array:
        """(I + A' A)^-1 (W, m, m): the covariance of z / scale given the window."""
        m = self.scaled.shape[2]
        return np.asarray(
            np.linalg.inv(np.eye(m) + self.scaled.swapaxes(1, 2) @ self.scaled), dtype=float
        )

    @cached_property
    def log_root(self) -> Array:
        """(W,) half the logarithm of the covariance's determinant."""
        return np.asarray(
            np.log(self.rows).sum() - 0.5 * np.linalg.slogdet(self.inner)[1], dtype=float
        )

    def _latent(self, scaled: Array) -> Array:
        """The mean of z / scale (..., W, m) given residuals (..., W, n) in units of their noise."""
        return np.asarray(
            np.moveaxis(_first(scaled) @ self.scaled @ self.inner, 0, -2).reshape(
                *scaled.shape[:-1], -1
            )
        )

    def __call__(self, residuals: Array) -> Array:
        """Whitened residuals (..., W, n + m) of (..., W, n), with the Mahalanobis length of the
        originals.
        """
        scaled = residuals / self.rows
        z = self._latent(scaled)
        return np.concatenate([scaled - self._reach(z), z], axis=-1)

    def _reach(self, z: Array) -> Array:
        """A z (..., W, n)."""
        return np.asarray(
            np.moveaxis(_first(z) @ self.scaled.swapaxes(1, 2), 0, -2).reshape(*z.shape[:-1], -1)
        )

    def distances(self, residuals: Array) -> Array:
        """Squared Mahalanobis lengths (..., W)."""
        return (self(residuals) ** 2).sum(axis=-1)

    def log_likelihood(self, residuals: Array) -> Array:
        """(..., W) log densities of residuals (..., W, n) by the multivariate t with the covariance
        as its scale matrix [nats].
        """
        n = residuals.shape[-1]
        constant = (
            gammaln((DEGREES + n) / 2) - gammaln(DEGREES / 2) - 0.5 * n * np.log(DEGREES * np.pi)
        )
        return (
            constant
            - 0.5 * (DEGREES + n) * np.log1p(self.distances(residuals) / DEGREES)
            - self.log_root
        )

    def weights(self, residuals: Array) -> Array:
        """(W,) how much each window counts: (nu + n) / (nu + d^2)."""
        return student_t_weights(self.distances(residuals), residuals.shape[-1], DEGREES)

    def moments(self, residuals: Array) -> tuple[Array, Array]:
        """Expected squares given residuals (W, n), weighted and summed over windows and steps: of e
        by signal (p,), of z (m,).
        """
        w = self.weights(residuals)
        p = len(self.sigma)
        scaled = residuals / self.rows
        z = self._latent(scaled)
        error = scaled - self._reach(z)
        spread = ((self.scaled @ self.inner) * self.scaled).sum(axis=2)
        errors = (w[:, None] * error**2 + spread).sum(axis=0) * self.rows**2
        latents = ((w[:, None] * z**2) + np.einsum("wii->wi", self.inner)).sum(
            axis=0
        ) * self.scale**2
        return errors.reshape(-1, p).sum(axis=0), latents


def _first(rows: Array) -> Array:
    """(W, K, n) of (..., W, n)."""
    return np.ascontiguousarray(np.moveaxis(rows, -2, 0)).reshape(
        rows.shape[-2], -1, rows.shape[-1]
    )


def learn_noise(
    loadings: Array,
    residuals: Array,
    sigma: Array,
    floor: Array,
    forces: Array | None = None,
    *,
    pieces: int | None = None,
    known: Array | None = None,
    rounds: int = 60,
    tolerance: float = 1e-3,
) -> tuple[Array, Array]:
    """Sigma (p,), tied between the start and all steps, and the sd of unexplained forces (nv,), by
    over-relaxed EM.

    loadings: (W, n, s p + k), the first p columns those of the start's error, others beside it as
    large as sigma too; forces: (nv,) first guesses, where the last k = pieces nv columns are
    impulses, nv of each piece of the window in turn (None: of each step).
    known: (W, n, e) loadings of standard normal numbers beside these. floor: (p,) the least sigma.
    """
    p = len(sigma)
    steps = residuals.shape[1] // len(sigma)
    forces = np.zeros(0) if forces is None else forces
    pieces = steps if pieces is None else pieces
    pushes = pieces * len(forces)
    start = (loadings.shape[2] - pushes) // p
    count = len(residuals) * (steps + start)
    known = np.zeros((*residuals.shape, 0)) if known is None else known
    loadings = np.concatenate([loadings, known], axis=2)
    ones = np.ones(known.shape[2])
    for _ in range(rounds):
        scale = np.concatenate([np.tile(sigma, start), np.tile(forces, pieces), ones])
        errors, latents = Whitener(loadings, scale, sigma).moments(residuals)
        ratio = (
            np.sqrt((errors + latents[: start * p].reshape(start, p).sum(axis=0)) / count) / sigma
        )
        new = np.maximum(sigma * ratio**1.5, floor)
        squares = latents[start * p :][:pushes].reshape(pieces, -1).sum(axis=0)
        pushed = np.sqrt(squares / (len(residuals) * pieces))
        moved = np.max(
            np.abs(np.log(np.concatenate([new, pushed]) / np.concatenate([sigma, forces])))
        )
        sigma = new
        forces = forces * (pushed / forces) ** 1.5
        if moved < tolerance:
            break
    return sigma, forces
