"""Windows with a noisy start state, which is integrated out: whitened residuals, their likelihood.

A window's residual (n,) is r = B z + e, with e ~ N(0, diag(sigma^2)) in every step and latent
z ~ N(0, diag(scale^2)): the error of the measured start, and where wanted unexplained forces. With
A = diag(1 / sigma) B diag(scale), the covariance is diag(sigma) (I + A A') diag(sigma).

A sensor's errors may follow each other: e_k = rho e_(k-1) + w_k with white w of standard deviation
sigma sqrt(1 - rho^2). The start is measured by the same sensor, so that e_0 = -z there. Then the
differences r_k - rho r_(k-1), with r_0 = 0, are white but for latent numbers, whose loadings are
B_k - rho B_(k-1), with B_0 = 1 for the start's error: everything else stays as it is.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from dropo.core.numerics.robust_statistics import student_t_log_density, student_t_weights
from dropo.core.records.trajectories import Ints
from dropo.core.services.validation import Array

DEGREES = 8.0
"""Degrees of freedom of the Student t, which limits the weight of windows across an impact."""


@dataclass(frozen=True)
class WhitenessSettings:
    """When noise is not taken to be white.

    Attributes
    ----------
    z : float
        Standard errors over windows by which a score must differ from 0.
    clear : float
        Multiple of its lower bound below which the noise is none: what is left is no sensor's.
    timing : float
        First guess of how control steps differ in length, as a fraction of one.
    minimum_gain : float
        Nats that each kind of noise must gain over a simpler one.
    weak : float
        Autoregressive coefficient below which errors that follow each other hardly look like
        effects: a search goes on with those found before, and leaves what is none.
    """

    z: float = 3.0
    clear: float = 10.0
    timing: float = 0.05
    minimum_gain: float = 10.0
    weak: float = 0.3


SETTINGS = WhitenessSettings()
LARGEST_AUTOREGRESSION = 0.97
"""Largest autoregressive coefficient from one control step to the next."""


@dataclass(frozen=True, eq=False)
class WindowNoise:
    """The noise of p signals.

    Attributes
    ----------
    sigma : (p,) array
        Standard deviations, in the signals' units.
    rho : (p,) array
        Autoregressive coefficients from one control step to the next; 0 where it is white.
    timing : float
        Standard deviation of the control steps' lengths, as a fraction of one.
    """

    sigma: Array
    rho: Array
    timing: float = 0.0

    @property
    def numbers(self) -> Array:
        """(2 p + 1,) all of it, for a record; `noise_of` reads it."""
        return np.concatenate([self.sigma, self.rho, [self.timing]])

    @property
    def coloured(self) -> bool:
        """Whether that of any signal is."""
        return bool(np.any(self.rho))


def noise_of(numbers: Array) -> WindowNoise:
    """Read noise from its numbers.

    Parameters
    ----------
    numbers : (2 p + 1,) array
        As `WindowNoise.numbers` gives them.

    Returns
    -------
    WindowNoise
    """
    p = len(numbers) // 2
    return WindowNoise(numbers[:p], numbers[p : 2 * p], float(numbers[-1]))


def white(sigma: Array) -> WindowNoise:
    """Return noise without memory.

    Parameters
    ----------
    sigma : (p,) array
        Standard deviations, in the signals' units.

    Returns
    -------
    WindowNoise
        White in every signal.
    """
    return WindowNoise(sigma, np.zeros(len(sigma)))


@dataclass(frozen=True, eq=False)
class Whitener:
    """The covariance of the residuals of W windows of n measurements.

    Attributes
    ----------
    loadings : (W, n, m) array
        B: the change of the residuals by each of the m latent numbers, the errors of the p signals
        at the start first, where noise is coloured.
    scale : (m,) array
        Standard deviations of the latent numbers.
    noise : WindowNoise
        Of the p signals; p divides n.
    counted : int or None
        The residuals of a window that say something of the noise; all n if None.
    """

    loadings: Array
    scale: Array
    noise: WindowNoise
    counted: int | None = None

    @property
    def sigma(self) -> Array:
        """(p,) the standard deviations of the signals' noise."""
        return self.noise.sigma

    @cached_property
    def rows(self) -> Array:
        """(n,) the standard deviation of each measurement, given the one before it."""
        sd = self.sigma * np.sqrt(1 - self.noise.rho**2)
        return np.tile(sd, self.loadings.shape[1] // len(sd))

    @cached_property
    def scaled(self) -> Array:
        """A (W, n, m), contiguous in this order, in which products of it are fast."""
        loadings = self.loadings
        if self.noise.coloured:
            loadings = np.moveaxis(self._differences(np.moveaxis(loadings, 2, 0)), 0, 2)
            loadings[:, : len(self.sigma), : len(self.sigma)] -= np.diag(self.noise.rho)
        return np.ascontiguousarray(loadings * self.scale / self.rows[:, None])

    @cached_property
    def carried(self) -> Array:
        """(W, n, m) the change of the residuals by a standard deviation of each latent number, with
        the later errors that follow from the start's.
        """
        p = len(self.sigma)
        if not self.noise.coloured:
            return self.loadings * self.scale
        loadings = self.loadings.copy()
        by_step = loadings.reshape(len(loadings), -1, p, loadings.shape[2])
        step = 1 + np.arange(by_step.shape[1])
        by_step[:, :, np.arange(p), np.arange(p)] -= self.noise.rho ** step[:, None]
        return loadings * self.scale

    @property
    def deviations(self) -> Array:
        """(W, n) standard deviations of the residuals."""
        step = 1 + np.arange(self.loadings.shape[1] // len(self.sigma))
        own = self.sigma**2 * (1 - self.noise.rho ** (2 * step[:, None]))
        return np.asarray(np.sqrt((self.carried**2).sum(axis=2) + own.ravel()), dtype=float)

    def covariance(self, places: Ints) -> Array:
        """Return the covariance of some residuals.

        Parameters
        ----------
        places : (k,) int array
            Which of a window's residuals.

        Returns
        -------
        (W, k, k) array
            Of every window.
        """
        step, signal = np.divmod(places, len(self.sigma))
        same = signal[:, None] == signal
        rho = self.noise.rho[signal]
        apart = np.abs(step[:, None] - step)
        together = step[:, None] + step + 2
        own = self.sigma[signal] ** 2 * same * (rho**apart - rho**together)
        carried = self.carried[:, places]
        return np.asarray(carried @ carried.swapaxes(1, 2) + own, dtype=float)

    def _differences(self, values: Array) -> Array:
        """Values (..., n) less what of them follows from the step before."""
        if not self.noise.coloured:
            return values
        p = len(self.sigma)
        follow = np.array(values)
        follow[..., p:] -= np.tile(self.noise.rho, values.shape[-1] // p - 1) * values[..., :-p]
        return follow

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
        return _windows_last(mean, scaled.shape[:-1])

    def latent(self, residuals: Array) -> Array:
        """Return the expected latent numbers, given residuals.

        Parameters
        ----------
        residuals : (W, n) array
            Of every window.

        Returns
        -------
        (W, m) array
        """
        return self._latent(self._differences(residuals) / self.rows) * self.scale

    def _explained(self, z: Array) -> Array:
        """A z (..., W, n), in units of the noise."""
        explained = _windows_first(z) @ self.scaled.swapaxes(1, 2)
        return _windows_last(explained, z.shape[:-1])

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
        return self.given(residuals).whitened

    def given(self, residuals: Array) -> "Given":
        """Return what residuals say of the latent numbers and of the noise.

        Parameters
        ----------
        residuals : (..., W, n) array
            Of every window.

        Returns
        -------
        Given
        """
        scaled = self._differences(residuals) / self.rows
        z = self._latent(scaled)
        return Given(self, residuals, scaled - self._explained(z), z)

    def distances(self, residuals: Array) -> Array:
        """Return the squared Mahalanobis lengths of residuals.

        Parameters
        ----------
        residuals : (..., W, n) array
            Of every window.

        Returns
        -------
        (..., W) array
        """
        return self.given(residuals).distances

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
        return self.given(residuals).log_likelihood

    def weights(self, residuals: Array) -> Array:
        """Return the weights of residuals under a Student t.

        Parameters
        ----------
        residuals : (..., W, n) array
            Of every window.

        Returns
        -------
        (..., W) array
            (nu + n) / (nu + d^2), with d their Mahalanobis length.
        """
        return self.given(residuals).weights


@dataclass(frozen=True, eq=False)
class Given:
    """What residuals say under a covariance; each part is computed once.

    Attributes
    ----------
    whitener : Whitener
        The covariance.
    residuals : (..., W, n) array
        Residuals.
    error : (..., W, n) array
        The noise that is expected, in units of its standard deviation.
    z : (..., W, m) array
        The latent numbers that are expected, in units of theirs.
    """

    whitener: Whitener
    residuals: Array
    error: Array
    z: Array

    @cached_property
    def whitened(self) -> Array:
        """(..., W, n + m) residuals whose Euclidean length is their Mahalanobis length."""
        return np.concatenate([self.error, self.z], axis=-1)

    @cached_property
    def distances(self) -> Array:
        """(..., W) squared Mahalanobis lengths."""
        return (self.whitened**2).sum(axis=-1)

    @cached_property
    def weights(self) -> Array:
        """(..., W) (nu + n) / (nu + d^2)."""
        return student_t_weights(self.distances, self._count, DEGREES)

    @property
    def log_likelihood(self) -> Array:
        """(..., W) log densities of the multivariate Student t [nats]."""
        density = student_t_log_density(self.distances, self._count, DEGREES)
        return density - self.whitener.log_root

    @property
    def _count(self) -> int:
        """n, or as many of a window's residuals as say something of the noise."""
        counted = self.whitener.counted
        return self.residuals.shape[-1] if counted is None else counted

    def neighbours(self) -> tuple[Array, Array]:
        """Expect products of errors that follow each other, weighted, from residuals (W, n).

        Returns
        -------
        products : (W, p) array
            Sums over a window's steps of each signal's error times that before it, that of the
            start before the first.
        squares : (W, p) array
            Sums of the squares of both.
        """
        own = self.whitener
        p = len(own.sigma)
        count, n, m = own.loadings.shape
        at_start = np.broadcast_to(np.eye(p, m), (count, p, m))
        scaled = np.concatenate([at_start, own.loadings], axis=1) * own.scale
        measured = np.concatenate([np.zeros((count, p)), self.residuals], axis=1)
        error = measured - (scaled @ self.z[:, :, None])[:, :, 0]
        spread = scaled @ own.inner
        weights = self.weights[:, None]
        square = weights * error**2 + (spread * scaled).sum(axis=2)
        product = weights * error[:, p:] * error[:, :-p]
        product += (spread[:, p:] * scaled[:, :-p]).sum(axis=2)
        squares = square[:, p:] + square[:, :-p]
        by_signal = (count, n // p, p)
        return product.reshape(by_signal).sum(axis=1), squares.reshape(by_signal).sum(axis=1)


def _windows_first(rows: Array) -> Array:
    """(W, K, n) of (..., W, n)."""
    count = math.prod(rows.shape[:-2])
    stacked = rows.reshape(count, *rows.shape[-2:])
    return np.ascontiguousarray(stacked.transpose(1, 0, 2))


def _windows_last(first: Array, shape: tuple[int, ...]) -> Array:
    """(*shape, n) of (W, K, n), where the shape ends with W."""
    return first.transpose(1, 0, 2).reshape(*shape, first.shape[-1])


def coloured_noise(
    whitener: Whitener, residuals: Array, floor: Array, settings: WhitenessSettings = SETTINGS
) -> WindowNoise | None:
    """Test whether errors of a sensor follow each other: the score test of rho = 0.

    Parameters
    ----------
    whitener : Whitener
        The covariance with white noise.
    residuals : (W, n) array
        Residuals.
    floor : (p,) array
        Lower bound of the noise's standard deviations.
    settings : WhitenessSettings
        When they do.

    Returns
    -------
    WindowNoise or None
        A first guess of the noise, coloured in the signals that ask for it; None if none does.
    """
    products, squares = whitener.given(residuals).neighbours()
    error = products.std(axis=0) * np.sqrt(len(products))
    follow = np.abs(products.sum(axis=0)) > settings.z * error
    follow &= whitener.sigma > settings.clear * floor
    if not follow.any():
        return None
    largest = LARGEST_AUTOREGRESSION
    rho = np.clip(2 * products.sum(axis=0) / squares.sum(axis=0), -largest, largest)
    return WindowNoise(whitener.sigma, np.where(follow, rho, 0.0))


def uneven_steps(
    whitener: Whitener, residuals: Array, clocks: Array, settings: WhitenessSettings = SETTINGS
) -> bool:
    """Test whether control steps differ in length: the score test that they do not.

    Parameters
    ----------
    whitener : Whitener
        The covariance where they do not.
    residuals : (W, n) array
        Residuals.
    clocks : (W, n, L) array
        Their change by each step's length.
    settings : WhitenessSettings
        When they do.

    Returns
    -------
    bool
    """
    along = whitener(np.moveaxis(clocks, 2, 0))
    given = whitener.given(residuals)
    squares = (along * given.whitened).sum(axis=2) ** 2
    excess = given.weights * squares - (along**2).sum(axis=2)
    by_window = excess.sum(axis=0)
    error = by_window.std() * np.sqrt(len(by_window))
    return bool(by_window.sum() > settings.z * error)
