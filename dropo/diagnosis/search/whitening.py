"""Windows with a noisy start state, which is integrated out: whitened residuals, their likelihood,
and the noise by expectation-maximization.

A window's residual (n,) is r = B z + e, with e ~ N(0, diag(sigma^2)) in every step and latent
z ~ N(0, diag(scale^2)): the error of the measured start, and where wanted unexplained forces. With
A = diag(1 / sigma) B diag(scale), the covariance is diag(sigma) (I + A A') diag(sigma).
"""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.special import gammaln

from dropo.core.numerics.robust_statistics import student_t_weights
from dropo.core.services.validation import Array

DEGREES = 8.0
"""Degrees of freedom of the Student t, which limits the weight of windows across an impact."""


@dataclass(frozen=True, eq=False)
class Whitener:
    """The covariance of the residuals of W windows of n measurements.

    Attributes
    ----------
    loadings : (W, n, m) array
        B: the change of the residuals by each of the m latent numbers.
    scale : (m,) array
        Standard deviations of the latent numbers.
    sigma : (p,) array
        Standard deviations of the p signals; p divides n.
    """

    loadings: Array
    scale: Array
    sigma: Array

    @cached_property
    def rows(self) -> Array:
        """(n,) the standard deviation of each measurement of a window."""
        return np.tile(self.sigma, self.loadings.shape[1] // len(self.sigma))

    @cached_property
    def scaled(self) -> Array:
        """A (W, n, m), contiguous in this order, in which products of it are fast."""
        return np.ascontiguousarray(self.loadings * self.scale / self.rows[:, None])

    @cached_property
    def inner(self) -> Array:
        """(I + A' A)^-1 (W, m, m): the covariance of z / scale given the window."""
        identity = np.eye(self.scaled.shape[2])
        precision = identity + self.scaled.swapaxes(1, 2) @ self.scaled
        return np.asarray(np.linalg.inv(precision), dtype=float)

    @cached_property
    def log_root(self) -> Array:
        """(W,) half the logarithm of the covariance's determinant."""
        of_inner = np.linalg.slogdet(self.inner)[1]
        return np.asarray(np.log(self.rows).sum() - 0.5 * of_inner, dtype=float)

    def _latent(self, scaled: Array) -> Array:
        """The mean of z / scale (..., W, m) given residuals (..., W, n) in units of their noise."""
        mean = _windows_first(scaled) @ self.scaled @ self.inner
        return np.asarray(np.moveaxis(mean, 0, -2).reshape(*scaled.shape[:-1], mean.shape[-1]))

    def _explained(self, z: Array) -> Array:
        """A z (..., W, n), in units of the noise."""
        explained = _windows_first(z) @ self.scaled.swapaxes(1, 2)
        return np.asarray(np.moveaxis(explained, 0, -2).reshape(*z.shape[:-1], -1))

    def __call__(self, residuals: Array) -> Array:
        """Whiten residuals.

        Parameters
        ----------
        residuals : (..., W, n) array
            Residuals, or changes of predictions.

        Returns
        -------
        (..., W, n + m) array
            Its Euclidean length is the Mahalanobis length of the residuals.
        """
        scaled = residuals / self.rows
        z = self._latent(scaled)
        return np.concatenate([scaled - self._explained(z), z], axis=-1)

    def distances(self, residuals: Array) -> Array:
        """Return the squared Mahalanobis lengths (..., W) of residuals (..., W, n)."""
        return (self(residuals) ** 2).sum(axis=-1)

    def log_likelihood(self, residuals: Array) -> Array:
        """Evaluate the multivariate Student t whose scale matrix is the covariance.

        Parameters
        ----------
        residuals : (..., W, n) array
            Residuals.

        Returns
        -------
        (..., W) array
            Log densities [nats].
        """
        n = residuals.shape[-1]
        constant = (
            gammaln((DEGREES + n) / 2) - gammaln(DEGREES / 2) - 0.5 * n * np.log(DEGREES * np.pi)
        )
        excess = np.log1p(self.distances(residuals) / DEGREES)
        return constant - 0.5 * (DEGREES + n) * excess - self.log_root

    def weights(self, residuals: Array) -> Array:
        """Return the weights (..., W) of residuals (..., W, n): (nu + n) / (nu + d^2)."""
        return student_t_weights(self.distances(residuals), residuals.shape[-1], DEGREES)

    def moments(self, residuals: Array) -> tuple[Array, Array]:
        """Sum expected squares given the residuals, weighted, over windows and steps.

        Parameters
        ----------
        residuals : (W, n) array
            Residuals.

        Returns
        -------
        errors : (p,) array
            Of the noise e, by signal.
        latents : (m,) array
            Of the latent numbers z.
        """
        weights = self.weights(residuals)[:, None]
        scaled = residuals / self.rows
        z = self._latent(scaled)
        error = scaled - self._explained(z)
        error_variance = ((self.scaled @ self.inner) * self.scaled).sum(axis=2)
        latent_variance = np.einsum("wii->wi", self.inner)
        errors = (weights * error**2 + error_variance).sum(axis=0) * self.rows**2
        latents = ((weights * z**2) + latent_variance).sum(axis=0) * self.scale**2
        return errors.reshape(-1, len(self.sigma)).sum(axis=0), latents


def _windows_first(rows: Array) -> Array:
    """(W, K, n) of (..., W, n)."""
    first = np.ascontiguousarray(np.moveaxis(rows, -2, 0))
    count = math.prod(rows.shape[:-2])
    return first.reshape(rows.shape[-2], count, rows.shape[-1])


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
    """Estimate the noise, and unexplained forces, by over-relaxed expectation-maximization.

    The noise of the start and of all steps is the same.

    Parameters
    ----------
    loadings : (W, n, s p + k) array
        The first p columns are those of the start's error, the others up to s p have the same
        standard deviations; the last k = pieces nv are the forces', nv of each piece of the window
        in turn.
    residuals : (W, n) array
        Residuals of W windows of n / p steps.
    sigma : (p,) array
        First guess of the noise.
    floor : (p,) array
        Lower bound of the noise.
    forces : (nv,) array, optional
        First guess of the forces' standard deviations; None for no forces.
    pieces : int, optional
        Pieces of a window in which forces are drawn anew; each step is one if None.
    known : (W, n, e) array, optional
        Loadings of standard normal numbers beside these.
    rounds : int
        Iterations, at most.
    tolerance : float
        Relative change of all estimates at which iterations end.

    Returns
    -------
    sigma : (p,) array
        Standard deviations of the noise.
    forces : (nv,) array
        Standard deviations of the forces.
    """
    p = len(sigma)
    steps = residuals.shape[1] // p
    forces = np.zeros(0) if forces is None else forces
    pieces = steps if pieces is None else pieces
    impulses = pieces * len(forces)
    starts = (loadings.shape[2] - impulses) // p
    count = len(residuals) * (steps + starts)
    known = np.zeros((*residuals.shape, 0)) if known is None else known
    loadings = np.concatenate([loadings, known], axis=2)
    ones = np.ones(known.shape[2])
    for _ in range(rounds):
        scale = np.concatenate([np.tile(sigma, starts), np.tile(forces, pieces), ones])
        errors, latents = Whitener(loadings, scale, sigma).moments(residuals)
        # The noise: errors of the steps, and of the start.
        of_starts = latents[: starts * p].reshape(starts, p).sum(axis=0)
        ratio = np.sqrt((errors + of_starts) / count) / sigma
        new_sigma = np.maximum(sigma * ratio**1.5, floor)
        # The forces of all pieces.
        squares = latents[starts * p :][:impulses].reshape(pieces, -1).sum(axis=0)
        new_forces = np.sqrt(squares / (len(residuals) * pieces))
        old = np.concatenate([sigma, forces])
        change = np.abs(np.log(np.concatenate([new_sigma, new_forces]) / old))
        sigma = new_sigma
        forces = forces * (new_forces / forces) ** 1.5
        if np.max(change) < tolerance:
            break
    return sigma, forces
