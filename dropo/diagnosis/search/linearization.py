"""A simulator with every effect at hand, held against windows: residuals, how the start's noise
reaches them, slopes.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from dropo.core.contracts.effect import EffectInstance
from dropo.core.contracts.simulator import Simulator
from dropo.core.numerics.finite_differences import axial_design
from dropo.core.records.trajectories import Ints
from dropo.core.services.validation import Array
from dropo.diagnosis.search.whitening import Whitener, learn_noise
from dropo.diagnosis.search.windows import Windows

LOST = 1e3  # a window that diverges is this many standard deviations off


@dataclass(eq=False)
class Library:
    """The simulator whose parameters are the d declared ones, then the sizes of all atoms; and
    where each atom's stand.
    """

    simulator: Simulator
    instances: Sequence[EffectInstance]
    declared: int
    places: dict[str, np.ndarray] = field(init=False)

    def __post_init__(self) -> None:
        ends = self.declared + np.cumsum([len(instance.quantities) for instance in self.instances])
        self.places = {
            a.label: np.arange(end - len(a.quantities), end)
            for a, end in zip(self.instances, ends.tolist(), strict=True)
        }

    @property
    def steps(self) -> Array:
        """(m,) half widths of differences: a share of the smallest probe; of declared parameters a
        thousandth of their interval.
        """
        space = self.simulator.space
        own = 1e-3 * (space.high - space.low)[: self.declared]
        rest = [
            0.1 * min(abs(probe) for probe in q.probes)
            for instance in self.instances
            for q in instance.quantities
        ]
        return np.concatenate([own, rest])

    def predict(self, values: Array, windows: Windows, offsets: Array | None = None) -> Array:
        """(K, m) -> (K, W, n)."""
        return self.simulator.predict(values, windows.segments, offsets=offsets).reshape(
            len(values), len(windows), -1
        )

    def slopes(self, theta: Array, free: np.ndarray, windows: Windows, share: float = 1.0) -> Array:
        """D prediction / d theta (f, W, n) in the free numbers, by central differences within the
        bounds; share: of `steps`.
        """
        space = self.simulator.space
        width = share * self.steps[free]
        up, down = (
            np.clip(theta[free] + sign * width, space.low[free], space.high[free])
            for sign in (1, -1)
        )
        values = np.repeat(theta[None], 2 * len(free), axis=0)
        values[np.arange(len(free)), free], values[len(free) + np.arange(len(free)), free] = (
            up,
            down,
        )
        found = self.predict(values, windows)
        return np.nan_to_num((found[: len(free)] - found[len(free) :]) / (up - down)[:, None, None])


@dataclass(frozen=True, eq=False)
class LinearizedWindows:
    """Windows under theta (m,) and sigma (p,): residuals (W, n), the curvature's part of the
    predictions (W, n), and the whitener. `lost` (W,) are those that diverge.
    """

    windows: Windows
    theta: Array
    residuals: Array
    shift: Array
    whiten: Whitener
    lost: np.ndarray

    @property
    def predicted(self) -> Array:
        """(W, n) what was simulated from the measured starts; of lost windows nothing."""
        return np.where(
            self.lost[:, None], np.nan, self.windows.measured - self.residuals - self.shift
        )

    @property
    def loadings(self) -> Array:
        """(W, n, 2 p) those of starts that are off by noise alone."""
        return self.whiten.loadings[:, :, : 2 * len(self.whiten.sigma)]

    @property
    def doubts(self) -> Array:
        """(W, n, e) the loadings of e standard normal numbers: what starts of late signals are off
        by beside noise.
        """
        return self.whiten.loadings[:, :, 2 * len(self.whiten.sigma) :]

    @property
    def log_likelihood(self) -> Array:
        """(W,) [nats]."""
        return self.whiten.log_likelihood(self.residuals)

    def take(self, index: Ints) -> "LinearizedWindows":
        """Some of the windows."""
        whiten = Whitener(self.whiten.loadings[index], self.whiten.scale, self.whiten.sigma)
        return LinearizedWindows(
            self.windows.take(index),
            self.theta,
            self.residuals[index],
            self.shift[index],
            whiten,
            self.lost[index],
        )

    def flat(self, residuals: Array) -> Array:
        """(..., W (n + m)) residuals (..., W, n) whitened and weighted as the likelihood does; lost
        windows count for nothing.
        """
        weights = np.sqrt(self.whiten.weights(self.residuals) * ~self.lost)[:, None]
        return (weights * self.whiten(residuals)).reshape(*residuals.shape[:-2], -1)

    def of(self, predictions: Array) -> Array:
        """(..., W) log densities under other predictions (..., W, n), the noise and the curvature's
        part as they are.
        """
        residuals = np.nan_to_num(self.windows.measured - predictions - self.shift, nan=LOST)
        residuals[..., self.lost, :] = self.residuals[self.lost]
        return self.whiten.log_likelihood(residuals)


def linearize(library: Library, windows: Windows, theta: Array, sigma: Array) -> LinearizedWindows:
    """Simulates the windows from their measured starts and, for the noise's way, from starts moved
    by sigma either way.

    To second order in each signal's error z, f + J z + H z^2 / 2 (without mixed terms): the mean of
    the last part shifts the predictions, and its spread, of variance (H sigma^2)^2 / 2, is a column
    of its own. So windows that begin close to an impact count less.
    """
    p = len(sigma)
    offsets = np.repeat(axial_design(sigma, -sigma)[:, None], len(windows), axis=1)
    found = library.predict(np.repeat(theta[None], 2 * p + 1, axis=0), windows, offsets)
    lost = np.asarray(~np.isfinite(found).all(axis=(0, 2)))
    found[:, lost] = 0.0
    curved = (
        0.5 * (found[1 : p + 1] + found[p + 1 :]) - found[0]
    )  # (p, W, n), half the second derivative times sigma^2
    linear = 0.5 * (found[1 : p + 1] - found[p + 1 :])
    loadings = np.moveaxis(
        np.concatenate([linear, np.sqrt(2) * curved]) / np.tile(sigma, 2)[:, None, None], 0, 2
    )
    shift = curved.sum(axis=0)
    residuals = windows.measured - found[0] - shift
    residuals[lost] = LOST * np.tile(sigma, windows.length)
    return LinearizedWindows(
        windows, theta, residuals, shift, whitener(library, windows, theta, sigma, loadings), lost
    )


def moved(
    library: Library, seen: LinearizedWindows, theta: Array, sigma: Array
) -> LinearizedWindows:
    """A look at another theta and noise that takes the start noise's way from `seen`: one
    simulation a window.
    """
    predictions = library.predict(theta[None], seen.windows)[0]
    lost = np.logical_or(seen.lost, ~np.isfinite(predictions).all(axis=1))
    residuals = seen.windows.measured - predictions - seen.shift
    residuals[lost] = LOST * np.tile(sigma, seen.windows.length)
    whiten = whitener(library, seen.windows, theta, sigma, seen.loadings)
    return LinearizedWindows(seen.windows, theta, residuals, seen.shift, whiten, lost)


def whitener(
    library: Library, windows: Windows, theta: Array, sigma: Array, loadings: Array
) -> Whitener:
    """Of noisy starts: those of signals that are seen late are in doubt by more than noise, a
    latent number more for each.
    """
    doubt = library.simulator.extra_start_sd(theta, windows.segments)
    late = np.flatnonzero(doubt.any(axis=0))
    more = loadings[:, :, late] * doubt[:, None, late]
    return Whitener(
        np.concatenate([loadings, more], axis=2),
        np.concatenate([np.tile(sigma, 2), np.ones(len(late))]),
        sigma,
    )


def noise_of(seen: LinearizedWindows, sigma: Array, floor: Array, rounds: int = 60) -> Array:
    """Sigma (p,) that the windows are most likely under, at the theta of a look."""
    good = ~seen.lost
    return learn_noise(
        seen.loadings[good],
        seen.residuals[good],
        sigma,
        floor,
        known=seen.doubts[good],
        rounds=rounds,
    )[0]
