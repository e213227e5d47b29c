"""Fitting some of theta to windows: robust Gauss-Newton, with the noise learned in between."""

from dataclasses import dataclass, field, replace

import numpy as np

from dropo.core.numerics.gauss_newton import GaussNewtonSettings, damped_step, maximize
from dropo.core.records.trajectories import Ints
from dropo.core.services.validation import Array
from dropo.diagnosis.search.linearization import (
    DIVERGED,
    Library,
    LinearizedWindows,
    estimate_noise,
    linearize,
    step_lengths,
    whitener,
    with_other_noise,
)
from dropo.diagnosis.search.whitening import (
    SETTINGS,
    Whitener,
    WhitenessSettings,
    WindowNoise,
    coloured_noise,
    uneven_steps,
)

NO_INDICES = np.zeros(0, dtype=np.int64)
"""No numbers of theta."""


@dataclass(frozen=True)
class RefitSettings:
    """How theta and the noise are fitted to windows.

    Attributes
    ----------
    steps : GaussNewtonSettings
        Steps under a fixed noise; gains in nats.
    close : float
        Fraction of the usual half widths of differences, where predictions curve within those.
    renewals : int
        How often at most the effect of the start's noise is found anew in a fit.
    renewal_gain : float
        From this many nats on, finding it anew has changed something.
    stride : int
        Whether it has, and which number of a scan is best, is first seen on one window of so
        many ...
    fewest : int
        ... if these are so many at least.
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
    stride: int = 4
    fewest: int = 12
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
    nonsmooth: Ints = NO_INDICES,
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
    linearized : LinearizedWindows
        The windows at the first theta.
    free : (f,) int array
        Which numbers of theta are fitted.
    floor : (p,) array
        Lower bound of the noise.
    rounds : int
        Rounds of fitting theta and the noise in turn.
    nonsmooth : int array
        Numbers in which predictions are not smooth: a line scan finds them first.
    renewals : int, optional
        In place of the settings'.
    settings : RefitSettings
        How it is done.

    Returns
    -------
    LinearizedWindows
        The windows at the most likely theta and noise.
    """
    problem = _Steps(library, free, None, settings)
    linearized, jacobian = _settled(problem, linearized, floor, rounds, nonsmooth)
    # Linearize anew where theta has gone, until that changes nothing any more.
    for _ in range(settings.renewals if renewals is None else renewals):
        if not _is_outdated(library, linearized, settings):
            break
        renewed = linearize(library, linearized.windows, linearized.theta, linearized.whiten.noise)
        change = float(renewed.log_likelihood.sum() - linearized.log_likelihood.sum())
        if abs(change) < settings.renewal_gain:
            linearized = renewed
            break
        linearized, jacobian = _settled(problem, renewed, floor, jacobian=jacobian)
    # Without noise, errors are so small that usual differences are too wide.
    if np.median(linearized.whiten.sigma / floor) < settings.noiseless:
        noise = linearized.whiten.noise
        renewed = linearize(library, linearized.windows, linearized.theta, noise)
        return _settled(problem, renewed, floor, close=True)[0]
    return linearized


def _is_outdated(library: Library, linearized: LinearizedWindows, settings: RefitSettings) -> bool:
    """Whether some windows say that the effect of the start's noise is another by now."""
    theta, noise = linearized.linearized_at
    if np.array_equal(theta, linearized.theta) and not _is_other(linearized, noise, settings):
        return False
    some = _some(linearized, settings)
    if some is None:
        return True
    renewed = linearize(library, some.windows, some.theta, some.whiten.noise)
    change = float(renewed.log_likelihood.sum() - some.log_likelihood.sum())
    return abs(change) * settings.stride >= settings.renewal_gain


def with_noise(
    library: Library,
    linearized: LinearizedWindows,
    floor: Array,
    settings: RefitSettings = DEFAULTS,
) -> LinearizedWindows:
    """Give windows the noise that their residuals have.

    Parameters
    ----------
    library, linearized, floor, settings
        As of `refit`.

    Returns
    -------
    LinearizedWindows
        The windows at the same theta; the effect of the start's noise is found anew where the
        noise is quite another.
    """
    noise = estimate_noise(linearized, linearized.whiten.noise, floor)
    return _under(library, linearized, noise, settings)


def _under(
    library: Library,
    linearized: LinearizedWindows,
    noise: WindowNoise,
    settings: RefitSettings = DEFAULTS,
) -> LinearizedWindows:
    """Windows under a noise, linearized anew where it is quite another."""
    if _is_other(linearized, noise, settings):
        return linearize(library, linearized.windows, linearized.theta, noise)
    return with_other_noise(library, linearized, noise)


def _is_other(linearized: LinearizedWindows, noise: WindowNoise, settings: RefitSettings) -> bool:
    """Whether a noise is quite another than that of some windows."""
    ratios = np.abs(np.log(noise.sigma / linearized.whiten.sigma))
    return bool(np.any(ratios > np.log(settings.other_noise)))


def other_noise(
    library: Library,
    linearized: LinearizedWindows,
    floor: Array,
    settings: WhitenessSettings = SETTINGS,
) -> WindowNoise | None:
    """Test whether the noise is another than white.

    Parameters
    ----------
    library : Library
        The simulator with every effect.
    linearized : LinearizedWindows
        The windows under white noise.
    floor : (p,) array
        Lower bound of its standard deviations.
    settings : WhitenessSettings
        When it is another.

    Returns
    -------
    WindowNoise or None
        A first guess: errors that follow each other, control steps of different lengths, or both
        if one of them does not explain as much; None where the windows ask for neither.
    """
    good = linearized.take(np.flatnonzero(~linearized.lost))
    white = good.whiten.noise
    if not np.any(white.sigma > settings.clear * floor):
        return None
    timing = replace(white, timing=settings.timing)
    coloured = coloured_noise(good.whiten, good.residuals, floor, settings)
    if coloured is not None:
        asked = [coloured, timing, replace(coloured, timing=settings.timing)]
    else:
        lengths = step_lengths(library, good.windows, good.loadings, white.sigma)
        if not uneven_steps(good.whiten, good.residuals, lengths, settings):
            return None
        asked = [timing]
    best = good
    for noise in asked:
        found = with_noise(library, _under(library, good, noise), floor)
        gain = float(found.log_likelihood.sum() - best.log_likelihood.sum())
        if gain > settings.minimum_gain:
            best = found
    return None if best is good else best.whiten.noise


def settle(
    library: Library,
    linearized: LinearizedWindows,
    free: np.ndarray,
    floor: Array,
    *,
    rounds: int = 2,
    nonsmooth: Ints = NO_INDICES,
    known: Array | None = None,
    slopes: Array | None = None,
    settings: RefitSettings = DEFAULTS,
) -> LinearizedWindows:
    """Fit windows with the effect of the start's noise as it is, enough to compare candidates.

    Parameters
    ----------
    library, linearized, free, floor, rounds, nonsmooth, settings
        As of `refit`.
    known : (k, W, n) array, optional
        Jacobian by the first k free numbers that may stand for theirs at any theta near by.
    slopes : (f - k, W, n) array, optional
        Jacobian by the other free numbers, that may be used at first.

    Returns
    -------
    LinearizedWindows
    """
    problem = _Steps(library, free, known, settings)
    whole = None
    if slopes is not None:
        whole = slopes if known is None else np.concatenate([known, slopes])
    return _settled(problem, linearized, floor, rounds, nonsmooth, jacobian=whole)[0]


def _settled(
    problem: "_Steps",
    linearized: LinearizedWindows,
    floor: Array,
    rounds: int = 2,
    nonsmooth: Ints = NO_INDICES,
    *,
    jacobian: Array | None = None,
    close: bool = False,
) -> tuple[LinearizedWindows, Array | None]:
    """Windows fitted as `settle` does, with the last Jacobian (f, W, n) where it still holds.

    jacobian: one from near by that may be used at first.
    """
    library = problem.library
    settings = problem.settings
    for _ in range(rounds):
        before = float(linearized.log_likelihood.sum())
        # Line scans of numbers that have no useful derivative; in the first round only.
        for number in nonsmooth:
            linearized = _scan(library, linearized, int(number), settings)
            jacobian = None
        nonsmooth = NO_INDICES
        # Theta under this noise, then the noise at this theta.
        if len(problem.free):
            linearized, jacobian = maximize(
                problem, linearized, settings.steps, jacobian=jacobian, close=close
            )
        noise = estimate_noise(linearized, linearized.whiten.noise, floor)
        linearized = with_other_noise(library, linearized, noise)
        if abs(float(linearized.log_likelihood.sum()) - before) < settings.steps.tolerance:
            break
    return linearized, jacobian


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
        if self.known is not None and first == len(self.free):
            return self.known
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
        rows = linearized.flat(jacobian)
        residuals = linearized.flat(linearized.residuals)
        return damped_step(rows, residuals, room, prior_sd)

    def try_steps(
        self, linearized: LinearizedWindows, steps: Array
    ) -> tuple[LinearizedWindows, float]:
        """The best of several steps (K, f), and the nats gained."""
        space = self.library.simulator.space
        free = self.free
        thetas = np.repeat(linearized.theta[None], len(steps), axis=0)
        stepped = linearized.theta[free] + steps
        thetas[:, free] = np.clip(stepped, space.low[free], space.high[free])
        return _best(self.library, linearized, thetas)


def _scan(
    library: Library, linearized: LinearizedWindows, number: int, settings: RefitSettings
) -> LinearizedWindows:
    """One number of theta at multiples of its present value."""
    space = library.simulator.space
    multiples = np.array(settings.scan)
    candidates = np.repeat(linearized.theta[None], len(multiples), axis=0)
    scanned = multiples * linearized.theta[number]
    candidates[:, number] = np.clip(scanned, space.low[number], space.high[number])
    some = _some(linearized, settings)
    if some is not None:
        _, _, values = _evaluated(library, some, candidates)
        gains = settings.stride * (values - some.log_likelihood.sum())
        if gains.max() >= settings.renewal_gain:
            candidates = candidates[[gains.argmax()]]
        elif gains.min() <= -settings.renewal_gain:
            return linearized  # they tell, and no other is better
    return _best(library, linearized, candidates)[0]


def _some(linearized: LinearizedWindows, settings: RefitSettings) -> LinearizedWindows | None:
    """Some of the windows, evenly spread; None where they are few."""
    count = len(linearized.windows)
    if count < settings.stride * settings.fewest:
        return None
    return linearized.take(np.arange(0, count, settings.stride))


def _best(
    library: Library, linearized: LinearizedWindows, candidates: Array
) -> tuple[LinearizedWindows, float]:
    """The best of several thetas (K, m) if it is better than the present one, and its gain."""
    windows = linearized.windows
    noise = linearized.whiten.noise
    predictions, whiteners, values = _evaluated(library, linearized, candidates)
    best = int(values.argmax())
    gain = float(values[best] - linearized.log_likelihood.sum())
    if not gain > 0:
        return linearized, 0.0
    # Windows that diverge count as those that are lost.
    residuals = windows.measured - predictions[best] - linearized.shift
    lost = linearized.lost | ~np.isfinite(residuals).all(axis=1)
    residuals[lost] = DIVERGED * np.tile(noise.sigma, windows.length)
    better = replace(
        linearized,
        theta=candidates[best],
        residuals=residuals,
        whiten=whiteners[best],
        lost=lost,
        shifted=True,
    )
    return better, gain


def _evaluated(
    library: Library, linearized: LinearizedWindows, candidates: Array
) -> tuple[Array, list[Whitener], Array]:
    """Predictions (K, W, n) of several thetas (K, m), each with the covariance that it implies, and
    the log-likelihoods (K,), -inf where there is none.
    """
    windows = linearized.windows
    predictions = library.predict(candidates, windows)
    whiteners = []
    values = []
    for theta, predicted in zip(candidates, predictions, strict=True):
        noise = linearized.whiten.noise
        whiten = whitener(library, windows, theta, noise, linearized.loadings)
        there = replace(linearized, whiten=whiten)
        whiteners.append(whiten)
        values.append(there.log_likelihood_of(predicted).sum())
    return predictions, whiteners, np.where(np.isfinite(values), values, -np.inf)
