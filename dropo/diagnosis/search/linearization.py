"""Windows beside what a simulator with every effect predicts for them: residuals, and how the noise
of the measured start state carries into the predictions.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from dropo.core.contracts.effect import EffectInstance
from dropo.core.contracts.simulator import Simulator
from dropo.core.numerics.finite_differences import axial_design
from dropo.core.records.trajectories import Ints
from dropo.core.services.validation import Array
from dropo.diagnosis.search.noise_learning import learn_noise
from dropo.diagnosis.search.whitening import Whitener, WindowNoise
from dropo.diagnosis.search.windows import Windows
from dropo.mjmodel.robot_simulator import RobotSimulator

DIVERGED = 1e3
"""Standard deviations by which a window counts as wrong whose simulation diverges."""


@dataclass(frozen=True)
class DerivativeSettings:
    """Half widths of the differences that derivatives are taken from.

    Attributes
    ----------
    of_interval : float
        For a declared parameter, as a fraction of its search interval.
    of_probe : float
        For a magnitude of an effect, as a fraction of its smallest probe.
    kept : int
        So many Jacobians are kept for those who ask for the same again.
    """

    of_interval: float = 1e-3
    of_probe: float = 0.1
    kept: int = 4


DEFAULTS = DerivativeSettings()


@dataclass(eq=False)
class Library:
    """A simulator with every effect, and where each effect's magnitudes stand in its parameters.

    Attributes
    ----------
    simulator : Simulator
        Its m parameters are the d declared ones, then the magnitudes of all effects.
    instances : sequence of EffectInstance
        The effects, in the order of their magnitudes.
    declared : int
        d.
    differences : DerivativeSettings
        Widths of differences.
    coarse : Simulator or None
        The same in coarser physics steps, which predicts in its place; what its steps make wrong is
        found where windows are linearized, and added to the predictions.
    indices_of : dict of str to (q,) int array
        For each effect's label, the indices of its magnitudes among the parameters.
    """

    simulator: Simulator
    instances: Sequence[EffectInstance]
    declared: int
    differences: DerivativeSettings = DEFAULTS
    coarse: Simulator | None = None
    indices_of: dict[str, np.ndarray] = field(init=False)
    _kept: list[tuple[Windows, bytes, Array]] = field(init=False, default_factory=list)

    def __post_init__(self) -> None:
        self.indices_of = {}
        end = self.declared
        for instance in self.instances:
            start = end
            end += len(instance.quantities)
            self.indices_of[instance.label] = np.arange(start, end)

    @property
    def steps(self) -> Array:
        """(m,) half widths of differences."""
        space = self.simulator.space
        width = self.differences.of_interval * (space.high - space.low)
        of_effects = []
        for instance in self.instances:
            for quantity in instance.quantities:
                smallest = min(abs(probe) for probe in quantity.probes)
                of_effects.append(self.differences.of_probe * smallest)
        return np.concatenate([width[: self.declared], of_effects])

    def predict(self, values: Array, windows: Windows, offsets: Array | None = None) -> Array:
        """Simulate windows under several parameter vectors, in coarser steps where there are such.

        Parameters
        ----------
        values : (K, m) array
            Parameter vectors.
        windows : Windows
            W windows of n measurements each.
        offsets : (K, W, p) array, optional
            Added to the measured start of each window.

        Returns
        -------
        (K, W, n) array
            NaN where a simulation diverges.
        """
        coarse = self.coarse
        if coarse is None:
            predicted = self.simulator.predict(values, windows.segments, offsets=offsets)
        else:
            before = coarse.steps
            predicted = coarse.predict(values, windows.segments, offsets=offsets)
            self.simulator.steps += coarse.steps - before
        return predicted.reshape(len(values), len(windows), -1)

    def defect(self, theta: Array, windows: Windows, predicted: Array) -> Array | None:
        """Find what coarser steps make wrong.

        Parameters
        ----------
        theta : (m,) array
            The parameters.
        windows : Windows
            W windows of n measurements.
        predicted : (W, n) array
            What `predict` says of them.

        Returns
        -------
        (W, n) array or None
            What is missing in it; None without coarser steps.
        """
        if self.coarse is None:
            return None
        exact = self.simulator.predict(theta[None], windows.segments)
        return np.asarray(exact.reshape(predicted.shape) - predicted, dtype=float)

    def jacobian(
        self, theta: Array, free: np.ndarray, windows: Windows, fraction: float = 1.0
    ) -> Array:
        """Differentiate the predictions, by central differences within the bounds.

        Parameters
        ----------
        theta : (m,) array
            Where.
        free : (f,) int array
            The parameters by which it differentiates.
        windows : Windows
            What is predicted.
        fraction : float
            Of the usual half widths `steps`.

        Returns
        -------
        (f, W, n) array
            0 where a simulation diverges, and of a number beyond its bounds.
        """
        space = self.simulator.space
        count = len(free)
        if not count:
            return np.zeros((0, len(windows), windows.measured.shape[1]))
        width = fraction * self.steps[free]
        upper = np.clip(theta[free] + width, space.low[free], space.high[free])
        lower = np.clip(theta[free] - width, space.low[free], space.high[free])
        values = np.repeat(theta[None], 2 * count, axis=0)
        values[np.arange(count), free] = upper
        values[count + np.arange(count), free] = lower
        predicted = self.predict(values, windows)
        change = predicted[:count] - predicted[count:]
        between = (upper - lower)[:, None, None]
        slopes = np.divide(change, between, out=np.zeros_like(change), where=between > 0)
        return np.asarray(np.nan_to_num(slopes))

    def kept_jacobian(self, theta: Array, free: np.ndarray, windows: Windows) -> Array:
        """Differentiate the predictions, unless that was done here just before.

        Parameters
        ----------
        theta, free, windows
            As of `jacobian`.

        Returns
        -------
        (f, W, n) array
            One of the last few that this was asked for, or a new one.
        """
        key = theta.tobytes() + free.tobytes()
        for own_windows, own_key, jacobian in self._kept:
            if own_windows is windows and own_key == key:
                return jacobian
        jacobian = self.jacobian(theta, free, windows)
        self._kept = [(windows, key, jacobian), *self._kept[: self.differences.kept - 1]]
        return jacobian


@dataclass(frozen=True, eq=False)
class LinearizedWindows:
    """W windows of n measurements, and the model linearized in their starts.

    Attributes
    ----------
    windows : Windows
        What was measured.
    theta : (m,) array
        The parameters.
    residuals : (W, n) array
        Measured less predicted, in the signals' units.
    shift : (W, n) array
        The part of the predictions that is not simulated each time: from their curvature in the
        noisy start, and the defect.
    whiten : Whitener
        The covariance of the residuals, with the noise sigma (p,).
    lost : (W,) bool array
        Windows whose simulation diverges.
    linearized_at : tuple of (m,) array and Noise
        The parameters and the noise that the start's loadings were found at.
    shifted : bool
        Whether the windows were simulated again since.
    defect : (W, n) array or None
        What coarser physics steps make wrong there; None where they are not coarser.
    """

    windows: Windows
    theta: Array
    residuals: Array
    shift: Array
    whiten: Whitener
    lost: np.ndarray
    linearized_at: tuple[Array, WindowNoise]
    shifted: bool = False
    defect: Array | None = None

    @property
    def predicted(self) -> Array:
        """(W, n) what was simulated from the measured starts; NaN in windows that diverge."""
        predicted = self.windows.measured - self.residuals - self.shift
        return np.where(self.lost[:, None], np.nan, predicted)

    @property
    def start_loadings(self) -> Array:
        """(W, n, 2 p) the loadings of the start's noise: of its linear and its quadratic part."""
        return self.whiten.loadings[:, :, : 2 * len(self.whiten.sigma)]

    @property
    def loadings(self) -> Array:
        """(W, n, 2 p + c) those of the start's noise, and of the lengths of c = L control steps
        where these differ.
        """
        return self.whiten.loadings[:, :, : 2 * len(self.whiten.sigma) + self.clocks]

    @property
    def clocks(self) -> int:
        """c, the number of steps whose lengths differ; 0 where they are known."""
        return self.windows.length if self.whiten.noise.timing else 0

    @property
    def extra_loadings(self) -> Array:
        """(W, n, e) the loadings of what else starts of delayed signals are wrong by."""
        return self.whiten.loadings[:, :, 2 * len(self.whiten.sigma) + self.clocks :]

    @property
    def known_loadings(self) -> Array:
        """(W, n, c + e) the loadings of all but the start's noise, of numbers of variance 1."""
        first = 2 * len(self.whiten.sigma)
        return self.whiten.loadings[:, :, first:] * self.whiten.scale[first:]

    @property
    def log_likelihood(self) -> Array:
        """(W,) log densities of the windows [nats]."""
        return self.whiten.log_likelihood(self.residuals)

    def take(self, index: Ints) -> "LinearizedWindows":
        """Return some of the windows.

        Parameters
        ----------
        index : int array
            Which.

        Returns
        -------
        LinearizedWindows
        """
        whiten = replace(self.whiten, loadings=self.whiten.loadings[index])
        return LinearizedWindows(
            windows=self.windows.take(index),
            theta=self.theta,
            residuals=self.residuals[index],
            shift=self.shift[index],
            whiten=whiten,
            lost=self.lost[index],
            linearized_at=self.linearized_at,
            shifted=self.shifted,
            defect=None if self.defect is None else self.defect[index],
        )

    def flat(self, residuals: Array) -> Array:
        """Whiten and weight residuals as the likelihood does; windows that diverge count nothing.

        Parameters
        ----------
        residuals : (..., W, n) array
            Residuals, or changes of predictions.

        Returns
        -------
        (..., W (n + r)) array
            With the r latent numbers of each window's start.
        """
        weights = np.sqrt(self.whiten.weights(self.residuals) * ~self.lost)[:, None]
        whitened = weights * self.whiten(residuals)
        return whitened.reshape(*residuals.shape[:-2], -1)

    def log_likelihood_of(self, predictions: Array) -> Array:
        """Evaluate other predictions, with the noise and the curvature's part as they are.

        Parameters
        ----------
        predictions : (..., W, n) array
            NaN where a simulation diverges.

        Returns
        -------
        (..., W) array
            Log densities [nats].
        """
        residuals = self.windows.measured - predictions - self.shift
        residuals = np.nan_to_num(residuals, nan=DIVERGED)
        residuals[..., self.lost, :] = self.residuals[self.lost]
        return self.whiten.log_likelihood(residuals)


@dataclass(frozen=True)
class FoundStartSettings:
    """How starts of signals that were estimated are found.

    Attributes
    ----------
    rounds : int
        Gauss-Newton steps at most.
    parts : tuple of float
        Parts of such a step that are tried.
    close : float
        They end where a window gains less in the mean [nats].
    """

    rounds: int = 8
    parts: tuple[float, ...] = (1.0, 0.5, 0.2, 0.05)
    close: float = 0.1


FOUND_STARTS = FoundStartSettings()


def linearize(
    library: Library,
    windows: Windows,
    theta: Array,
    noise: WindowNoise,
    settings: FoundStartSettings = FOUND_STARTS,
) -> LinearizedWindows:
    """Simulate windows from their starts, and from starts shifted by sigma either way.

    Parameters
    ----------
    library : Library
        The simulator with every effect.
    windows : Windows
        W windows of n measurements.
    theta : (m,) array
        The parameters.
    noise : WindowNoise
        Of the p signals.
    settings : FoundStartSettings
        How starts of signals that were estimated are found.

    Returns
    -------
    LinearizedWindows
        Of the same windows; where signals were estimated, of windows that start where the model and
        the measurements that follow put them: a smoother knows nothing of what commands do.

    Notes
    -----
    To second order in each signal's error z, without mixed terms, the prediction is f + J z +
    H z^2 / 2. The mean of the last part shifts the predictions; its variance, (H sigma^2)^2 / 2, is
    a loading of its own, so that windows that begin close to an impact count less.

    Of a signal that was estimated sigma is wide, so that its start is free; but the start is not
    that far off. Its differences are as wide as its errors are, and the second order is theirs.

    Where a library predicts in coarser steps, the defect of these is found here, from the measured
    starts, and kept until windows are linearized anew: it changes little with the parameters [1]_.

    References
    ----------
    .. [1] Stetter, The defect correction principle and discretization methods, Numerische
       Mathematik 29, 1978.
    """
    found = _linearized(library, windows, theta, noise)
    if windows.start_sd is None:
        return found
    for _ in range(settings.rounds):
        further = _with_found_starts(library, found, settings)
        if further is None:
            break
        found = _linearized(library, further, theta, noise)
    return found


def _with_found_starts(
    library: Library, found: LinearizedWindows, settings: FoundStartSettings
) -> Windows | None:
    """Windows that start where their measurements put them; None where they do so already.

    Of several parts of a Gauss-Newton step, each window makes the one after which it is likeliest:
    a whole one may be too long where a motion turns suddenly.
    """
    windows, whiten, theta = found.windows, found.whiten, found.theta
    assert windows.start_sd is not None
    estimated = np.isfinite(windows.start_sd)
    p = len(estimated)
    step = np.where(estimated, whiten.latent(found.residuals)[:, :p], 0.0)
    step[found.lost] = 0.0
    parts = np.array(settings.parts)
    offsets = parts[:, None, None] * step
    predicted = library.predict(np.repeat(theta[None], len(parts), axis=0), windows, offsets)
    residuals = windows.measured - predicted - found.shift
    # What is measured is off by its noise still; what was estimated is not, where it starts there.
    scale = whiten.scale.copy()
    scale[:p][estimated] = 0.0
    there = replace(whiten, scale=scale)
    before = there.log_likelihood(found.residuals)
    after = there.log_likelihood(np.nan_to_num(residuals, nan=DIVERGED))
    gains = np.where(np.isfinite(predicted).all(axis=2), after - before, 0.0)
    best = gains.argmax(axis=0)
    gain = np.maximum(np.take_along_axis(gains, best[None], axis=0)[0], 0.0)
    if gain.mean() < settings.close:
        return None
    moves = np.where(gain[:, None] > 0, parts[best][:, None] * step, 0.0)
    starts = windows.segments.starts
    simulator = library.simulator
    if isinstance(simulator, RobotSimulator):
        starts = simulator.layout.move(starts, moves)
    else:
        starts = starts + moves
    own = whiten.scale[:p] * np.sqrt(np.diagonal(whiten.inner, axis1=1, axis2=2)[:, :p])
    start_sd = np.where(estimated, np.minimum(np.median(own, axis=0), windows.start_sd), np.inf)
    return windows.with_starts(starts, moves, start_sd)


def _linearized(
    library: Library, windows: Windows, theta: Array, noise: WindowNoise
) -> LinearizedWindows:
    """Windows linearized in the starts that they have, as `linearize` says."""
    sigma = noise.sigma
    p = len(sigma)
    width = sigma if windows.start_sd is None else np.minimum(sigma, windows.start_sd)
    # Row 0: the measured start; then each signal larger by its width, then each smaller.
    offsets = np.repeat(axial_design(width, -width)[:, None], len(windows), axis=1)
    predicted = library.predict(np.repeat(theta[None], 2 * p + 1, axis=0), windows, offsets)
    lost = np.asarray(~np.isfinite(predicted).all(axis=(0, 2)))
    defect = library.defect(theta, windows, predicted[0])
    if defect is not None:
        lost |= ~np.isfinite(defect).all(axis=1)
        defect[lost] = 0.0
    predicted[:, lost] = 0.0
    centre = predicted[0]
    upper = predicted[1 : p + 1]
    lower = predicted[p + 1 :]
    # (p, W, n) half the second derivative times width^2, and the first derivative times sigma.
    curvature = 0.5 * (upper + lower) - centre
    linear = 0.5 * (upper - lower) * (sigma / width)[:, None, None]
    scaled = np.concatenate([linear, np.sqrt(2) * curvature])
    loadings = np.moveaxis(scaled / np.tile(sigma, 2)[:, None, None], 0, 2)
    shift = curvature.sum(axis=0)
    if defect is not None:
        shift = shift + defect
    residuals = windows.measured - centre - shift
    residuals[lost] = DIVERGED * np.tile(sigma, windows.length)
    if noise.timing:
        loadings = np.concatenate(
            [loadings, step_lengths(library, windows, loadings, sigma)], axis=2
        )
    whiten = whitener(library, windows, theta, noise, loadings)
    at = (theta, noise)
    return LinearizedWindows(windows, theta, residuals, shift, whiten, lost, at, defect=defect)


def step_lengths(library: Library, windows: Windows, loadings: Array, sigma: Array) -> Array:
    """Return the change of the predictions by each control step's length, in units of one.

    What a longer step adds is carried on as an error of the start is that has become as large.

    Parameters
    ----------
    library : Library
        The simulator, whose signals they are.
    windows : Windows
        W windows of L steps, whose measured rows say how far a step moves.
    loadings : (W, n, >= p) array
        The first p: of errors of the start.
    sigma : (p,) array
        The size of errors.

    Returns
    -------
    (W, n, L) array
    """
    p = len(sigma)
    data = windows.segments.trajectories
    steps = windows.segments.steps
    before = data.observations[steps]
    after = data.next_observations[steps]
    simulator = library.simulator
    if isinstance(simulator, RobotSimulator):
        after = simulator.layout.coordinates(after, before)
        before = simulator.layout.coordinates(before, before)
    moved = (after - before) / sigma
    by_start = loadings[:, :, :p].reshape(len(windows), windows.length, p, p)
    by_start = by_start * sigma / sigma[:, None]
    start = np.linalg.pinv(by_start, rcond=1e-9) @ moved[..., None]
    later = np.einsum("wjab,wib->wjai", by_start, start[..., 0]) * sigma[:, None]
    step = np.arange(windows.length)
    later *= (step[:, None] >= step)[:, None]
    return np.asarray(later.reshape(len(windows), -1, windows.length), dtype=float)


def shift_linearization(
    library: Library, linearized: LinearizedWindows, theta: Array, noise: WindowNoise
) -> LinearizedWindows:
    """Simulate windows under other parameters, with the start's loadings as they are.

    Parameters
    ----------
    library : Library
        The simulator with every effect.
    linearized : LinearizedWindows
        Where the loadings, and the defect of coarser steps, are taken from; a library that has no
        coarser steps has no defect.
    theta : (m,) array
        The other parameters.
    noise : WindowNoise
        The other noise.

    Returns
    -------
    LinearizedWindows
        By one simulation a window.
    """
    windows = linearized.windows
    if library.coarse is None and linearized.defect is not None:
        shift = linearized.shift - linearized.defect
        linearized = replace(linearized, shift=shift, defect=None)
    predicted = library.predict(theta[None], windows)[0]
    lost = np.logical_or(linearized.lost, ~np.isfinite(predicted).all(axis=1))
    residuals = windows.measured - predicted - linearized.shift
    residuals[lost] = DIVERGED * np.tile(noise.sigma, windows.length)
    whiten = whitener(library, windows, theta, noise, _loadings(library, linearized, noise))
    return replace(
        linearized, theta=theta, residuals=residuals, whiten=whiten, lost=lost, shifted=True
    )


def with_other_noise(
    library: Library, linearized: LinearizedWindows, noise: WindowNoise
) -> LinearizedWindows:
    """Give windows another noise, at their theta, with the start's loadings as they are.

    Parameters
    ----------
    library : Library
        The simulator that they were simulated with.
    linearized : LinearizedWindows
        The windows.
    noise : Noise
        The other noise.

    Returns
    -------
    LinearizedWindows
        As of `shift_linearization`; those that this, or a step of a fit, gave are not simulated
        again.
    """
    theta = linearized.theta
    if not linearized.shifted:
        return shift_linearization(library, linearized, theta, noise)
    windows = linearized.windows
    residuals = linearized.residuals.copy()
    residuals[linearized.lost] = DIVERGED * np.tile(noise.sigma, windows.length)
    whiten = whitener(library, windows, theta, noise, _loadings(library, linearized, noise))
    return replace(linearized, residuals=residuals, whiten=whiten)


def _loadings(library: Library, linearized: LinearizedWindows, noise: WindowNoise) -> Array:
    """The loadings of windows, with those of the steps' lengths where another noise has such."""
    loadings = linearized.loadings
    if not noise.timing or linearized.clocks:
        return loadings
    lengths = step_lengths(library, linearized.windows, loadings, noise.sigma)
    return np.concatenate([loadings, lengths], axis=2)


def whitener(
    library: Library, windows: Windows, theta: Array, noise: WindowNoise, loadings: Array
) -> Whitener:
    """Return the covariance of windows whose starts are noisy.

    Starts of delayed signals are wrong by more than noise: for each such signal there is one latent
    number more.

    Parameters
    ----------
    library : Library
        Its simulator knows the extra standard deviation of starts.
    windows : Windows
        W windows of n measurements.
    theta : (m,) array
        The parameters, delays among them.
    noise : WindowNoise
        Of the p signals.
    loadings : (W, n, 2 p + c) array
        Of the start's noise, and of the lengths of c steps.

    Returns
    -------
    Whitener
    """
    extra_sd = library.simulator.extra_start_sd(theta, windows.segments)
    delayed = np.flatnonzero(extra_sd.any(axis=0))
    extra = loadings[:, :, delayed] * extra_sd[:, None, delayed]
    clocks = np.full(loadings.shape[2] - 2 * len(noise.sigma), noise.timing)
    scale = np.concatenate([np.tile(noise.sigma, 2), clocks, np.ones(len(delayed))])
    return Whitener(np.concatenate([loadings, extra], axis=2), scale, noise, windows.counted)


def estimate_noise(
    linearized: LinearizedWindows, noise: WindowNoise, floor: Array, rounds: int = 60
) -> WindowNoise:
    """Estimate the noise under which windows are most likely.

    Parameters
    ----------
    linearized : LinearizedWindows
        The windows, at their theta.
    noise : WindowNoise
        First guess.
    floor : (p,) array
        Lower bound of its standard deviations.
    rounds : int
        Iterations, at most.

    Returns
    -------
    WindowNoise
        The first guess itself where the simulation diverges in all windows.
    """
    good = ~linearized.lost
    if not good.any():
        return noise
    loadings = linearized.loadings[good]
    residuals = linearized.residuals[good]
    known = linearized.extra_loadings[good]
    clocks = np.full(min(linearized.clocks, 1), noise.timing)
    learned, timing = learn_noise(
        loadings,
        residuals,
        noise,
        floor,
        clocks,
        known=known,
        counted=linearized.windows.counted,
        rounds=rounds,
    )
    return replace(learned, timing=float(timing.sum()))
