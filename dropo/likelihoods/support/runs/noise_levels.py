"""How noisy each sensor is: restricted estimates, which allow for what starts and parameters took.

Standard deviation, memory from instant to instant (AR(1)) and long tails (Student t) of each
signal. Every piece of the data has its start and parameters of its own here, so that parameters
that differ from run to run do not pass for noise.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from dropo.core.numerics.tails import student_log_density
from dropo.core.services.validation import Array
from dropo.likelihoods.support.runs.linearization import LinearizedInstants


@dataclass(frozen=True)
class NoiseLevelSettings:
    """How noise levels are estimated, and when a sensor's noise is more than white.

    Attributes
    ----------
    gain : float
        Memory or long tails are kept where they raise the restricted log-likelihood by more than
        this [nats].
    fewest : int
        Numbers of a signal below which its noise is taken as white and normal.
    memory : (float, float)
        Ends of the interval in which the correlation of neighbouring instants is searched.
    degrees : tuple of float
        Degrees of freedom of a Student t that are tried.
    sweeps : int
        Rounds over the signals in which memory is looked for, as what one signal's memory is
        depends on the others'.
    steady : float
        The rounds over the signals end where no correlation changes by more than this.
    inner : int
        Passes over the standard deviations for each memory that is tried.
    passes : int
        Passes over the standard deviations, at most.
    tolerance : float
        The passes over the standard deviations end where no variance changes by more than this
        fraction.
    free : float
        Least fraction of a residual's variance that starts and parameters leave: below it a
        residual says nothing of the noise.
    rounding : float
        Least standard deviation, as a fraction of the signal's spread.
    """

    gain: float = 4.0
    fewest: int = 40
    memory: tuple[float, float] = (-0.7, 0.995)
    degrees: tuple[float, ...] = (2.0, 2.5, 3.0, 4.0, 6.0, 10.0, 20.0)
    sweeps: int = 10
    steady: float = 5e-3
    inner: int = 6
    passes: int = 40
    tolerance: float = 1e-4
    free: float = 0.05
    rounding: float = 1e-9


@dataclass(frozen=True, eq=False)
class NoiseDistribution:
    """The noise of m signals.

    Attributes
    ----------
    sd : (m,) array
        Standard deviations, of a Student t its scale [signal unit].
    memory : (m,) array
        Correlations of neighbouring instants; 0: white.
    degrees : (m,) array
        Degrees of freedom of a Student t for what is new at an instant; infinite: Gaussian.
    """

    sd: Array
    memory: Array
    degrees: Array

    @property
    def information(self) -> Array:
        """(m,) Fisher information of a number, in units of sd^-2: (nu + 1) / (nu + 3)."""
        finite = np.isfinite(self.degrees)
        nu = np.where(finite, self.degrees, 1.0)
        return np.where(finite, (nu + 1) / (nu + 3), 1.0)

    @property
    def news(self) -> Array:
        """(m,) scale of what is new at an instant: sd sqrt(1 - rho^2)."""
        return np.asarray(self.sd * np.sqrt(1 - self.memory**2))

    @property
    def variance(self) -> Array:
        """(m,) variances; of a Student t with at most 2 degrees of freedom that of its core."""
        has_variance = self.degrees > 2
        safe = np.where(np.isinf(self.degrees) | ~has_variance, 3.0, self.degrees)
        factor = np.where(np.isinf(self.degrees) | ~has_variance, 1.0, safe / (safe - 2))
        return self.sd**2 * factor

    def weights(self, squares: Array) -> Array:
        """Weigh numbers by how well they fit: (nu + 1) / (nu + z^2), 1 where Gaussian.

        Parameters
        ----------
        squares : (T, m) array
            Squared whitened residuals.

        Returns
        -------
        (T, m) array
        """
        finite = np.isfinite(self.degrees)
        nu = np.where(finite, self.degrees, 1.0)
        return np.where(finite, (nu + 1) / (nu + squares), 1.0)


def white(sd: Array, degrees: float | None = None) -> NoiseDistribution:
    """Make the distribution of noise without memory.

    Parameters
    ----------
    sd : (m,) array
    degrees : float, optional
        Of a Student t.

    Returns
    -------
    NoiseDistribution
    """
    nu = np.inf if degrees is None else degrees
    return NoiseDistribution(sd, np.zeros_like(sd), np.full_like(sd, nu))


def whiten(columns: LinearizedInstants, noise: NoiseDistribution) -> Array:
    """Take memory and size out of all columns, along each piece.

    Parameters
    ----------
    columns : LinearizedInstants
    noise : NoiseDistribution

    Returns
    -------
    (T, m, c) array
        z_t = (n_t - rho n_(t-1)) / (sd sqrt(1 - rho^2)), of a piece's first instant n_t / sd.
    """
    matrix = columns.matrix
    out = matrix.copy()
    if noise.memory.any():
        rho = noise.memory[:, None]
        after = (matrix[1:] - rho * matrix[:-1]) / np.sqrt(1 - rho**2)
        out[1:] = np.where(follows(columns)[1:, :, None], after, matrix[1:])
    return np.asarray(out / noise.sd[:, None])


def follows(columns: LinearizedInstants) -> NDArray[np.bool_]:
    """Tell which numbers have one of the same signal and piece just before them.

    Parameters
    ----------
    columns : LinearizedInstants
        T instants of m signals, in pieces.

    Returns
    -------
    (T, m) array of bool
        False at the first instant of a piece, and where either is missing.
    """
    same = np.append(False, columns.piece[1:] == columns.piece[:-1])
    before = np.roll(columns.valid, 1, axis=0)
    return np.asarray(same[:, None] & before & columns.valid)


@dataclass(frozen=True, eq=False)
class _Solution:
    """All pieces solved: inverse (P, k, k), v (P, k + 1) with residual = z v, value [nats]."""

    inverse: Array
    v: Array
    value: float


class RestrictedEstimates:
    """Noise levels of given columns.

    Parameters
    ----------
    columns : LinearizedInstants
    prior : (s + d,) array
        Information of the prior on every piece's start and parameters.
    settings : NoiseLevelSettings
    """

    def __init__(self, columns: LinearizedInstants, prior: Array, settings: NoiseLevelSettings):
        self.columns = columns
        self.prior = np.diag(prior)
        self.settings = settings
        first = np.append(True, columns.piece[1:] != columns.piece[:-1])
        self.bounds = np.append(np.flatnonzero(first), len(columns.piece))
        self.counts = columns.valid.sum(axis=0)
        self.followers = follows(columns).sum(axis=0)
        spread = np.sqrt(np.mean(columns.residuals**2, axis=0))
        self.lowest = np.maximum(settings.rounding * spread, 1e-150)

    def levels(self, noise: NoiseDistribution) -> NoiseDistribution:
        """Estimate the standard deviations, with memory and tails as they are.

        Parameters
        ----------
        noise : NoiseDistribution

        Returns
        -------
        NoiseDistribution
        """
        unit = whiten(self.columns, replace(noise, sd=np.ones_like(noise.sd)))
        grams = self._grams(unit)
        tailed = np.isfinite(noise.degrees)
        sd = noise.sd
        for _ in range(self.settings.passes):
            now = replace(noise, sd=sd)
            if tailed.any():
                new = self._scaled_by_weights(now, unit, grams)
            else:
                new = self._scaled_by_leverage(now, grams)
            new = np.maximum(new, self.lowest)
            change = np.max(np.abs(new**2 / sd**2 - 1))
            sd = new
            if change < self.settings.tolerance:
                break
        return replace(noise, sd=sd)

    def choose(self, noise: NoiseDistribution) -> NoiseDistribution:
        """Find the signals whose noise has memory or long tails.

        Parameters
        ----------
        noise : NoiseDistribution
            White noise.

        Returns
        -------
        NoiseDistribution
            With memory and degrees of freedom where they gain.
        """
        noise = self.levels(noise)
        enough = np.flatnonzero(self.counts >= self.settings.fewest).tolist()
        for _ in range(self.settings.sweeps):
            before = noise.memory
            for j in enough:
                noise = self._with_memory(noise, j)
            noise = self.levels(noise)
            if np.max(np.abs(noise.memory - before)) < self.settings.steady:
                break
        return self.levels(self._with_tails(noise))

    # --- white noise and memory: the restricted likelihood

    def _grams(self, unit: Array) -> Array:
        """(P, m, c, c) products of whitened columns (T, m, c)."""
        parts = []
        for first, last in zip(self.bounds[:-1], self.bounds[1:], strict=True):
            own = unit[first:last].swapaxes(0, 1)  # (m, t, c)
            parts.append(own.swapaxes(1, 2) @ own)
        return np.stack(parts)

    def _solve(self, noise: NoiseDistribution, grams: Array) -> _Solution:
        """Starts and parameters of every piece, and the restricted log-likelihood."""
        total = np.tensordot(grams, noise.information / noise.sd**2, axes=([1], [0]))  # (P, c, c)
        known = total[:, :-1, :-1] + self.prior
        right = total[:, :-1, -1]
        inverse = np.linalg.inv(known)
        solved = np.asarray((inverse @ right[:, :, None])[:, :, 0], dtype=float)
        v: Array = np.concatenate([-solved, np.ones((len(solved), 1))], axis=1)
        left = total[:, -1, -1].sum() - np.sum(right * solved)
        value = -np.sum(self.counts * np.log(noise.sd)) - 0.5 * left
        value -= 0.5 * np.sum(self.followers * np.log1p(-(noise.memory**2)))
        value -= 0.5 * np.linalg.slogdet(known)[1].sum()
        return _Solution(np.asarray(inverse, dtype=float), v, float(value))

    def _scaled_by_leverage(self, noise: NoiseDistribution, grams: Array) -> Array:
        """(m,) sum of squares over numbers less leverages, of every signal."""
        found = self._solve(noise, grams)
        squares = np.einsum("pa,pmab,pb->m", found.v, grams, found.v)
        leverage = np.einsum("pab,pmba->m", found.inverse, grams[:, :, :-1, :-1]) / noise.sd**2
        left = np.maximum(self.counts - leverage, self.settings.free * self.counts)
        return np.asarray(np.sqrt(np.maximum(squares, 0.0) / np.maximum(left, 1.0)))

    def _with_memory(self, noise: NoiseDistribution, j: int) -> NoiseDistribution:
        """The distribution with memory of signal j, if that gains enough."""
        columns = replace(
            self.columns,
            matrix=self.columns.matrix[:, [j]],
            valid=self.columns.valid[:, [j]],
        )
        grams = self._grams(whiten(self.columns, replace(noise, sd=np.ones_like(noise.sd))))

        def fitted(rho: float) -> tuple[NoiseDistribution, float]:
            """The one with that memory and the sd that it needs, and its log-likelihood."""
            one = NoiseDistribution(np.ones(1), np.array([rho]), np.full(1, np.inf))
            grams[:, [j]] = self._grams(whiten(columns, one))
            memory = noise.memory.copy()
            memory[j] = rho
            own = replace(noise, memory=memory)
            for _ in range(self.settings.inner):
                sd = np.maximum(self._scaled_by_leverage(own, grams), self.lowest)
                own = replace(own, sd=sd)
            return own, self._solve(own, grams).value

        found = minimize_scalar(
            lambda rho: -fitted(rho)[1],
            bounds=self.settings.memory,
            method="bounded",
            options={"xatol": 1e-3},
        )
        gained = fitted(float(found.x))
        plain = fitted(0.0)
        return gained[0] if gained[1] - plain[1] > self.settings.gain else plain[0]

    # --- tails: the likelihood of residuals corrected for their leverage

    def _corrected(
        self, noise: NoiseDistribution, unit: Array, grams: Array
    ) -> tuple[Array, NDArray[np.bool_]]:
        """(T, m) residuals in standard deviations, and which of them say something."""
        weighted = grams
        if np.isfinite(noise.degrees).any():
            # One pass of weights at the present residuals.
            rough = self._residuals(self._solve(noise, grams), unit) / noise.sd
            weights = noise.weights(rough**2) / noise.information
            weighted = self._grams(unit * np.sqrt(weights)[:, :, None])
        found = self._solve(noise, grams)
        v = self._solve(noise, weighted).v
        e = self._residuals(replace(found, v=v), unit) / noise.sd
        share = np.empty_like(e)
        for p, (first, last) in enumerate(zip(self.bounds[:-1], self.bounds[1:], strict=True)):
            own = unit[first:last, :, :-1]
            share[first:last] = np.einsum("tma,ab,tmb->tm", own, found.inverse[p], own)
        share *= noise.information / noise.sd**2
        telling = self.columns.valid & (share < 1 - self.settings.free)
        return e / np.sqrt(np.maximum(1 - share, self.settings.free)), telling

    def _residuals(self, found: _Solution, unit: Array) -> Array:
        """(T, m) what starts and parameters of every piece leave."""
        label = np.repeat(np.arange(len(self.bounds) - 1), np.diff(self.bounds))
        return np.einsum("tmc,tc->tm", unit, found.v[label])

    def _scaled_by_weights(self, noise: NoiseDistribution, unit: Array, grams: Array) -> Array:
        """(m,) the scales that make weighted squares 1 on average."""
        z, telling = self._corrected(noise, unit, grams)
        weighted = np.where(telling, noise.weights(z**2) * z**2, 0.0).sum(axis=0)
        return np.asarray(noise.sd * np.sqrt(weighted / np.maximum(telling.sum(axis=0), 1)))

    def _with_tails(self, noise: NoiseDistribution) -> NoiseDistribution:
        """The distribution with a Student t for every signal where that gains enough."""
        unit = whiten(self.columns, replace(noise, sd=np.ones_like(noise.sd)))
        z, telling = self._corrected(noise, unit, self._grams(unit))
        degrees = noise.degrees.copy()
        sd = noise.sd.copy()
        for j in np.flatnonzero(self.counts >= self.settings.fewest):
            own = z[telling[:, j], j]
            if len(own) < self.settings.fewest:
                continue
            gaussian = -0.5 * len(own) * float(np.log(2 * np.pi * np.mean(own**2)) + 1)
            tried = [(*_scale_of_t(own, nu), nu) for nu in self.settings.degrees]
            value, scale, nu = max(tried)
            if value - gaussian > self.settings.gain:
                degrees[j] = nu
                sd[j] *= scale
        return replace(noise, sd=sd, degrees=degrees)


def _scale_of_t(z: Array, nu: float) -> tuple[float, float]:
    """The log-likelihood of a Student t at its best scale, and that scale."""
    square = float(np.median(z**2))
    for _ in range(100):
        new = float(np.mean((nu + 1) / (nu + z**2 / square) * z**2))
        done = abs(new / square - 1) < 1e-8
        square = new
        if done:
            break
    scale = float(np.sqrt(square))
    return float((student_log_density(z / scale, nu) - np.log(scale)).sum()), scale
