"""The noise of windows, and forces that nothing explains: those that make the windows most likely.

All that the likelihood asks for of a window are sums over its steps: products of the loadings and
residuals of each signal, and where its errors follow each other, of each step's with those of the
step before. With these an iteration takes p m^2 products a window in place of n m^2.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from dropo.core.numerics.robust_statistics import student_t_log_density, student_t_weights
from dropo.core.services.validation import Array
from dropo.diagnosis.search.whitening import (
    DEGREES,
    LARGEST_AUTOREGRESSION,
    WindowNoise,
    white,
)

SMALLEST = 1e-300
"""Stands for a standard deviation of 0, which has no logarithm."""


@dataclass(frozen=True)
class NoiseSearchSettings:
    """How far a search for the noise may go.

    Attributes
    ----------
    near : float
        Logarithm of the ratio to the first guess within which the gradient is followed.
    to_nothing : float
        Logarithm of the ratio by which a force may fall, which is to nothing.
    """

    near: float = 4.6
    to_nothing: float = 20.0


SEARCH = NoiseSearchSettings()


def learn_noise(
    loadings: Array,
    residuals: Array,
    noise: WindowNoise,
    floor: Array,
    forces: Array | None = None,
    *,
    pieces: int | None = None,
    known: Array | None = None,
    counted: int | None = None,
    rounds: int = 60,
    tolerance: float = 1e-3,
) -> tuple[WindowNoise, Array]:
    """Estimate the noise, and unexplained forces, by over-relaxed expectation-maximization.

    The noise of the start and of all steps is the same. Where the first guess is not white, the
    likelihood's gradient is followed instead, rho of the signals that have one among the unknowns.

    Parameters
    ----------
    loadings : (W, n, s p + k) array
        The first p columns are those of the start's error, the others up to s p have the same
        standard deviations; the last k = pieces nv are the forces', nv of each piece of the window
        in turn.
    residuals : (W, n) array
        Residuals of W windows of n / p steps.
    noise : WindowNoise
        First guess of the noise of p signals.
    floor : (p,) array
        Lower bound of its standard deviations.
    forces : (nv,) array, optional
        First guess of the forces' standard deviations; None for no forces.
    pieces : int, optional
        Pieces of a window in which forces are drawn anew; each step is one if None.
    known : (W, n, e) array, optional
        Loadings of standard normal numbers beside these.
    counted : int, optional
        The residuals of a window that say something of the noise; all n if None.
    rounds : int
        Iterations, at most.
    tolerance : float
        Relative change of all estimates at which over-relaxed iterations end.

    Returns
    -------
    noise : WindowNoise
    forces : (nv,) array
        Standard deviations of the forces.
    """
    p = len(noise.sigma)
    forces = np.zeros(0) if forces is None else forces
    pieces = residuals.shape[1] // p if pieces is None else pieces
    starts = (loadings.shape[2] - pieces * len(forces)) // p
    if known is not None:
        loadings = np.concatenate([loadings, known], axis=2)
    sums = _Sums(loadings, residuals, noise.rho != 0, counted)
    learning = _Learning(sums, floor, starts, pieces, rounds, tolerance)
    if noise.coloured or noise.timing:
        return learning.by_gradient(noise, forces)
    return learning.white(noise.sigma, forces)


@dataclass(frozen=True, eq=False)
class _Products:
    """Sums over the steps of W windows of s signals, with loadings b (m,) and residuals r.

    Attributes
    ----------
    loadings : (s, W, m, m) array
        Of b b'.
    mixed : (s, W, m) array
        Of b r.
    residuals : (s, W) array
        Of r^2.
    """

    loadings: Array
    mixed: Array
    residuals: Array

    def combined(self, factors: Array) -> tuple[Array, Array, Array]:
        """Sums over the signals, times a factor each: (W, m, m), (W, m) and (W,)."""
        loadings = np.tensordot(factors, self.loadings, 1)
        mixed = np.tensordot(factors, self.mixed, 1)
        return loadings, mixed, factors @ self.residuals

    def expected(self, mean: Array, covariance: Array, weights: Array) -> Array:
        """Squares of the errors r - b' z that are expected, by signal (s,).

        mean, covariance: of z, (W, m) and (W, m, m), where a window's residuals and mean count by
        its weight (W,).
        """
        weighted = weights[:, None] * mean
        spread = covariance + weighted[:, :, None] * mean[:, None]
        of_latents = self.loadings.reshape(len(self.loadings), -1) @ spread.ravel()
        of_both = self.mixed.reshape(len(self.mixed), -1) @ weighted.ravel()
        return np.asarray(self.residuals @ weights - 2 * of_both + of_latents)


def _products(loadings: Array, residuals: Array) -> _Products:
    """Those of loadings (s, W, T, m) and residuals (s, W, T) with themselves."""
    squares = loadings.swapaxes(2, 3) @ loadings
    mixed = (residuals[:, :, None] @ loadings)[:, :, 0]
    return _Products(squares, mixed, (residuals**2).sum(axis=2))


def _either_way(first: tuple[Array, Array], other: tuple[Array, Array]) -> _Products:
    """Those of loadings and residuals with others, and of the others with them."""
    (loadings, residuals), (across, measured) = first, other
    squares = loadings.swapaxes(2, 3) @ across
    mixed = measured[:, :, None] @ loadings + residuals[:, :, None] @ across
    both = 2 * (residuals * measured).sum(axis=2)
    return _Products(squares + squares.swapaxes(2, 3), mixed[:, :, 0], both)


@dataclass(frozen=True, eq=False)
class _Expected:
    """What is expected of W windows under some noise, and how likely they are.

    Attributes
    ----------
    log_likelihood : float
        Of all windows under the multivariate Student t [nats].
    errors : (p,) array
        Squares of the steps' errors, each in units of its spread given the one before.
    latents : (m,) array
        Squares of the latent numbers.
    products, squares : (f,) array
        Of signals whose errors follow each other, those of each error and the one before, and of
        the squares of both.
    """

    log_likelihood: float
    errors: Array
    latents: Array
    products: Array
    squares: Array


class _Sums:
    """Sums of products over the steps of windows, as far as their likelihood asks for them.

    Parameters
    ----------
    loadings : (W, n, m) array
        The change of the residuals by each latent number, errors of the p signals at the start
        first.
    residuals : (W, n) array
        Of windows of n / p steps.
    follow : (p,) bool array
        Signals whose errors may follow each other.
    counted : int or None
        The residuals of a window that say something of the noise; all if None.
    """

    def __init__(
        self,
        loadings: Array,
        residuals: Array,
        follow: NDArray[np.bool_],
        counted: int | None,
    ) -> None:
        p = len(follow)
        count, n, m = loadings.shape
        self.steps = n // p
        self.counted = n if counted is None else counted
        self.follow = np.flatnonzero(follow)
        by_signal = np.ascontiguousarray(
            loadings.reshape(count, self.steps, p, m).transpose(2, 0, 1, 3)
        )
        measured = np.ascontiguousarray(residuals.reshape(count, self.steps, p).transpose(2, 0, 1))
        self.same = _products(by_signal, measured)
        if not len(self.follow):
            return
        own = by_signal[self.follow], measured[self.follow]
        before = np.zeros_like(own[0]), np.zeros_like(own[1])
        before[0][:, :, 1:] = own[0][:, :, :-1]
        before[1][:, :, 1:] = own[1][:, :, :-1]
        # The start is measured by the same sensor: its error is that before the first step's.
        before[0][np.arange(len(self.follow)), :, 0, self.follow] = 1.0
        self.between = _either_way(own, before)
        self.before = _products(*before)

    def expected(self, noise: WindowNoise, scale: Array) -> _Expected:
        """Return what is expected under some noise.

        Parameters
        ----------
        noise : WindowNoise
            Of the signals.
        scale : (m,) array
            Standard deviations of the latent numbers.

        Returns
        -------
        _Expected
        """
        rho = noise.rho[self.follow]
        variance = noise.sigma**2 * (1 - noise.rho**2)
        factors = 1 / variance
        gram, mixed, squares = self.same.combined(factors)
        if len(self.follow):
            own = factors[self.follow]
            for products, part in ((self.between, -rho * own), (self.before, rho**2 * own)):
                for total, more in zip(
                    (gram, mixed, squares), products.combined(part), strict=True
                ):
                    total += more
        precision = np.eye(len(scale)) + gram * np.outer(scale, scale)
        inner = np.linalg.inv(precision)
        moment = mixed * scale
        mean = (inner @ moment[:, :, None])[:, :, 0]
        distances = np.maximum(squares - (moment * mean).sum(axis=1), 0.0)
        weights = student_t_weights(distances, self.counted, DEGREES)
        carried = mean * scale, inner * np.outer(scale, scale), weights
        errors = self.same.expected(*carried)
        together, earlier = np.zeros((2, len(rho)))
        if len(self.follow):
            together = self.between.expected(*carried)
            earlier = self.before.expected(*carried)
        recent = errors[self.follow]
        errors[self.follow] += rho**2 * earlier - rho * together
        latents = weights @ mean**2 + np.einsum("wii->i", inner)
        log_roots = 0.5 * np.linalg.slogdet(precision)[1]
        log_roots += 0.5 * self.steps * np.log(variance).sum()
        return _Expected(
            float((student_t_log_density(distances, self.counted, DEGREES) - log_roots).sum()),
            errors * factors,
            latents * scale**2,
            0.5 * together,
            recent + earlier,
        )


@dataclass(frozen=True, eq=False)
class _Learning:
    """What `learn_noise` learns from."""

    sums: _Sums
    floor: Array
    starts: int
    pieces: int
    rounds: int
    tolerance: float

    def white(self, sigma: Array, forces: Array) -> tuple[WindowNoise, Array]:
        """White noise and the forces, from first guesses of their standard deviations."""
        for _ in range(self.rounds):
            of_noise, of_forces = self._mean_squares(white(sigma), forces)[1:]
            new_sigma = np.maximum(sigma * (np.sqrt(of_noise) / sigma) ** 1.5, self.floor)
            new_forces = np.sqrt(of_forces)
            old = np.concatenate([sigma, forces])
            change = np.abs(np.log(np.concatenate([new_sigma, new_forces]) / old))
            sigma = new_sigma
            forces = forces * (new_forces / forces) ** 1.5
            if np.max(change) < self.tolerance:
                break
        return white(sigma), forces

    def by_gradient(self, noise: WindowNoise, forces: Array) -> tuple[WindowNoise, Array]:
        """The most likely noise and forces, from first guesses."""
        p = len(noise.sigma)
        follow = self.sums.follow
        log_forces = np.log(np.maximum(forces, SMALLEST))
        first = np.concatenate([np.log(noise.sigma), noise.rho[follow], log_forces])
        lowest = np.maximum(first[:p] - SEARCH.near, np.log(self.floor))
        bounds = [
            *zip(lowest, first[:p] + SEARCH.near, strict=True),
            *(len(follow) * [(-LARGEST_AUTOREGRESSION, LARGEST_AUTOREGRESSION)]),
            *((guess - SEARCH.to_nothing, guess + SEARCH.near) for guess in log_forces),
        ]
        found = minimize(
            self._loss,
            first,
            jac=True,
            method="L-BFGS-B",
            bounds=bounds,
            options={"maxiter": self.rounds},
        )
        return self._unpacked(found.x)

    def _unpacked(self, values: Array) -> tuple[WindowNoise, Array]:
        """The noise and forces that numbers stand for."""
        p = len(self.floor)
        follow = self.sums.follow
        sigma, coefficients, forces = np.split(values, (p, p + len(follow)))
        rho = np.zeros(p)
        rho[follow] = coefficients
        return WindowNoise(np.exp(sigma), rho), np.exp(forces)

    def _loss(self, values: Array) -> tuple[float, Array]:
        """Less the log-likelihood, and its gradient by the logarithms of noise and forces, and by
        what follows: that expected of errors and forces.
        """
        noise, forces = self._unpacked(values)
        sums = self.sums
        expected, of_noise, of_forces = self._mean_squares(noise, forces)
        count = len(sums.same.residuals[0])
        rho = noise.rho[sums.follow]
        left = 1 - rho**2
        by_rho = expected.products * (1 + rho**2) - rho * expected.squares
        by_rho = by_rho / (noise.sigma[sums.follow] * left) ** 2 + count * sums.steps * rho / left
        gradient = [
            count * (sums.steps + self.starts) * (of_noise / noise.sigma**2 - 1),
            by_rho,
            count * self.pieces * (of_forces / forces**2 - 1),
        ]
        return -expected.log_likelihood, -np.concatenate(gradient)

    def _mean_squares(self, noise: WindowNoise, forces: Array) -> tuple[_Expected, Array, Array]:
        """What is expected, and from it mean squares of the noise (p,) and of the forces."""
        p = len(noise.sigma)
        of_forces = np.tile(forces, self.pieces)
        numbers = self.starts * p + len(of_forces)
        ones = np.ones(self.sums.same.mixed.shape[2] - numbers)
        scale = np.concatenate([np.tile(noise.sigma, self.starts), of_forces, ones])
        expected = self.sums.expected(noise, scale)
        windows = self.sums.same.residuals.shape[1]
        # The noise: errors of the steps, and of the start; the forces of all pieces.
        starts, pieces, _ = np.split(expected.latents, [self.starts * p, numbers])
        squares = expected.errors * noise.sigma**2 + starts.reshape(self.starts, p).sum(axis=0)
        by_force = pieces.reshape(self.pieces, len(forces)).sum(axis=0)
        steps = windows * (self.sums.steps + self.starts)
        return expected, squares / steps, by_force / (windows * self.pieces)
