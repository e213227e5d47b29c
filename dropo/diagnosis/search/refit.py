"""Fitting some of theta to windows: robust Gauss-Newton, with the noise learned in between."""

from dataclasses import dataclass, field, replace

import numpy as np

from dropo.core.numerics.gauss_newton import GaussNewtonSettings, damped_step, maximize
from dropo.core.records.trajectories import Ints
from dropo.core.services.validation import Array
from dropo.diagnosis.search.linearization import (
    Library,
    LinearizedWindows,
    linearize,
    shift_linearization,
    estimate_noise,
    whitener,
)

NONE = np.zeros(0, dtype=np.int64)


@dataclass(frozen=True)
class RefitSettings:
    """How theta and the noise are fitted to windows.

    Attributes
    ----------
    steps : GaussNewtonSettings
        Steps under a fixed noise; gains in nats.
    close : float
        Fraction of the usual half widths of differences, where predictions bend within those.
    renewals : int
        How often at most the effect of the start's noise is found anew in a fit.
    renewal_gain : float
        From this many nats on, finding it anew has changed something.
    noiseless : float
        Data whose noise is below this multiple of its lower bound are without noise.
    other_noise : float
        Ratio of two noises from which the effect of the start's noise is found anew.
    scan : tuple of float
        Multiples of a magnitude that are tried where predictions are not smooth in it.
    """

    steps: GaussNewtonSettings = field(default_factory=GaussNewtonSettings)
    close: float = 0.02
    renewals: int = 4
    renewal_gain: float = 3.0
    noiseless: float = 10.0
    other_noise: float = 1.3
    scan: tuple[float, ...] = (0.05, 0.15, 0.3, 0.5, 0.7, 0.85, 1.15, 1.4, 1.8, 2.5, 4.0)


DEFAULTS = RefitSettings()


def refit(
    library: Library,
    linearized: LinearizedWindows,
    free: np.ndarray,
    floor: Array,
    *,
    rounds: int = 4,
    rough: Ints = NONE,
    renewals: int | None = None,
    settings: RefitSettings = DEFAULTS,
) -> LinearizedWindows:
    """Fit windows by some numbers of theta and by the noise.

    The effect of the start's noise is found anew at the new theta, and where that matters the fit
    goes on. Data without noise are fitted with narrow differences in the end.

    Parameters
    ----------
    library : Library
        The simulator with every effect.
    seen : Look
        The windows at the first theta.
    free : (f,) int array
        Which numbers of theta are fitted.
    floor : (p,) array
        Lower bound of the noise.
    rounds : int
        Rounds of fitting theta and the noise in turn.
    rough : int array
        Numbers in which predictions are not smooth: a line scan finds them first.
    renewals : int, optional
        In place of the settings'.
    settings : RefitSettings
        How it is done.

    Returns
    -------
    Look
        The windows at the most likely theta and noise.
    """
    linearized = settle(library, linearized, free, floor, rounds=rounds, rough=rough, settings=settings)
    for _ in range(settings.renewals if renewals is None else renewals):
        renewed = linearize(library, linearized.windows, linearized.theta, linearized.whiten.sigma)
        change = float(renewed.log_likelihood.sum() - linearized.log_likelihood.sum())
        if abs(change) < settings.renewal_gain:
            linearized = renewed
            break
        linearized = settle(library, renewed, free, floor, settings=settings)
    if np.median(linearized.whiten.sigma / floor) < settings.noiseless:
        return settle(library, linearized, free, floor, close=True, settings=settings)
    return linearized


def with_noise(
    library: Library, linearized: LinearizedWindows, floor: Array, settings: RefitSettings = DEFAULTS
) -> LinearizedWindows:
    """Give windows the noise that their residuals have.

    Parameters
    ----------
    library, seen, floor, settings
        As of `refit`.

    Returns
    -------
    Look
        The windows at the same theta; the effect of the start's noise is found anew where the
        noise is quite another.
    """
    sigma = estimate_noise(linearized, linearized.whiten.sigma, floor)
    ratios = np.abs(np.log(sigma / linearized.whiten.sigma))
    if np.any(ratios > np.log(settings.other_noise)):
        return linearize(library, linearized.windows, linearized.theta, sigma)
    return shift_linearization(library, linearized, linearized.theta, sigma)


def settle(
    library: Library,
    linearized: LinearizedWindows,
    free: np.ndarray,
    floor: Array,
    *,
    rounds: int = 2,
    rough: Ints = NONE,
    known: Array | None = None,
    close: bool = False,
    settings: RefitSettings = DEFAULTS,
) -> LinearizedWindows:
    """Fit windows with the effect of the start's noise as it is, enough to compare candidates.

    Parameters
    ----------
    library, seen, free, floor, rounds, rough, settings
        As of `refit`.
    known : (k, W, n) array, optional
        Jacobian by the first k free numbers that may stand for theirs at any theta near by.
    close : bool
        Whether to differentiate by narrow differences.

    Returns
    -------
    Look
    """
    problem = _Steps(library, free, known, settings)
    jacobian = None
    for _ in range(rounds):
        before = float(linearized.log_likelihood.sum())
        for number in rough:
            linearized = _scan(library, linearized, int(number), settings)
            jacobian = None
        rough = NONE
        if len(free):
            linearized, jacobian = maximize(problem, linearized, settings.steps, jacobian=jacobian, close=close)
        sigma = estimate_noise(linearized, linearized.whiten.sigma, floor)
        linearized = shift_linearization(library, linearized, linearized.theta, sigma)
        if abs(float(linearized.log_likelihood.sum()) - before) < settings.steps.tolerance:
            break
    return linearized


@dataclass(frozen=True, eq=False)
class _Steps:
    """Gauss-Newton steps of the free numbers with the noise as it is, within their bounds."""

    library: Library
    free: np.ndarray
    known: Array | None
    settings: RefitSettings

    def differentiate(self, linearized: LinearizedWindows, close: bool) -> Array:
        """(f, W, n) by the free numbers; those known are not found anew, unless closer by."""
        if close:
            close_by = self.settings.close
            return self.library.jacobian(linearized.theta, self.free, linearized.windows, close_by)
        first = 0 if self.known is None else len(self.known)
        own = self.library.jacobian(linearized.theta, self.free[first:], linearized.windows)
        return own if self.known is None else np.concatenate([self.known, own])

    def step(self, linearized: LinearizedWindows, jacobian: Array) -> tuple[Array, float]:
        """The damped step, and the nats that it promises."""
        space = self.library.simulator.space
        low = space.low[self.free]
        high = space.high[self.free]
        here = linearized.theta[self.free]
        prior_sd = self.settings.steps.prior_width * (high - low)
        room = (low - here, high - here)
        return damped_step(linearized.flat(jacobian), linearized.flat(linearized.residuals), room, prior_sd)

    def try_steps(self, linearized: LinearizedWindows, steps: Array) -> tuple[LinearizedWindows, float]:
        """The best of several steps (K, f), and the nats gained."""
        space = self.library.simulator.space
        free = self.free
        tried = np.repeat(linearized.theta[None], len(steps), axis=0)
        tried[:, free] = np.clip(linearized.theta[free] + steps, space.low[free], space.high[free])
        return _best(self.library, linearized, tried)


def _scan(
    library: Library, linearized: LinearizedWindows, number: int, settings: RefitSettings
) -> LinearizedWindows:
    """One number of theta at multiples of its size."""
    space = library.simulator.space
    multiples = np.array(settings.scan)
    tried = np.repeat(linearized.theta[None], len(multiples), axis=0)
    scanned = multiples * linearized.theta[number]
    tried[:, number] = np.clip(scanned, space.low[number], space.high[number])
    return _best(library, linearized, tried)[0]


def _best(
    library: Library, linearized: LinearizedWindows, tried: Array
) -> tuple[LinearizedWindows, float]:
    """The best of several thetas (K, m) where it is better than the present one, and its gain."""
    predictions = library.predict(tried, linearized.windows)
    sigma = linearized.whiten.sigma
    ways = [whitener(library, linearized.windows, theta, sigma, linearized.loadings) for theta in tried]
    values = np.array(
        [
            replace(linearized, whiten=way).of(one).sum()
            for way, one in zip(ways, predictions, strict=True)
        ]
    )
    k = int(np.nanargmax(np.where(np.isfinite(values), values, -np.inf)))
    gain = float(values[k] - linearized.log_likelihood.sum())
    if not gain > 0:
        return linearized, 0.0
    residuals = linearized.windows.measured - predictions[k] - linearized.shift
    bad = linearized.lost | ~np.isfinite(residuals).all(axis=1)
    residuals[bad] = linearized.residuals[bad]
    return replace(linearized, theta=tried[k], residuals=residuals, whiten=ways[k]), gain
