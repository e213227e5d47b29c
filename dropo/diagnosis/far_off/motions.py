"""Long windows of which every step is compared, and how long they can be."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from dropo.core.contracts.problem import Problem
from dropo.core.numerics.robust_statistics import deviation
from dropo.core.records.trajectories import Ints
from dropo.core.services.errors import BadArgument
from dropo.core.services.validation import Array
from dropo.diagnosis.search.library import robot_of
from dropo.diagnosis.search.linearization import Library
from dropo.diagnosis.search.whitening import Whitener, white
from dropo.diagnosis.search.window_length import first_noise, noise_floor
from dropo.diagnosis.search.windows import Windows, WindowSettings, cut, spread_of
from dropo.evaluation.held_out import DataPart, whole_part


@dataclass(frozen=True)
class LongWindowSettings:
    """Which windows are compared.

    Attributes
    ----------
    seconds : tuple of float
        Lengths of windows that are tried, rising [s].
    tried : int
        Number of windows by which it is found out whether they can be so long.
    curved : float
        Fraction of the errors' variance that is not linear in the start's noise, above which
        windows are too long.
    physics_steps : int
        About how many physics steps are simulated for all windows of a side.
    control_steps : int
        Largest number of control steps that are compared on a side.
    pool : int
        Windows to fit are chosen from about this many times as many.
    looked_at : int
        Of so many times the windows that are wanted it is found out in which the start's noise acts
        nonlinearly.
    resting : float
        Fraction of a signal's usual change below which it rests.
    spans : int
        That change is over one of so many parts of a window.
    few : int
        Number of windows by which it is found out whether the start's noise matters.
    start : float
        The start's noise matters if its variance, averaged over all steps, is more than this
        fraction of the errors' variance.
    rate_noise : float
        Lower bound of a rate's noise at the start, as a fraction of the rate's spread: rates were
        mostly estimated from positions.
    known_before : float
        What is known of how a signal moves before any window is chosen, beside what a usual window
        says of it.
    """

    seconds: tuple[float, ...] = (0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 20.0)
    tried: int = 8
    curved: float = 0.2
    physics_steps: int = 160_000
    control_steps: int = 16_000
    pool: int = 8
    looked_at: int = 2
    resting: float = 0.1
    spans: int = 50
    few: int = 4
    start: float = 0.1
    rate_noise: float = 0.05
    known_before: float = 0.01


@dataclass(frozen=True)
class OuterSpreadSettings:
    """Which of many errors stands for the size of all: where a machine mostly rests, their median
    is that of rest.

    Attributes
    ----------
    quantile : float
        The quantile of the errors' absolute values.
    of_normal : float
        That quantile of normal errors, in their standard deviations.
    """

    quantile: float = 0.9
    of_normal: float = 1.645


SETTINGS = LongWindowSettings()
FEW = WindowSettings(fewest=3)
"""Long windows may be few: each has many pieces."""
OUTER = OuterSpreadSettings()


@dataclass(frozen=True, eq=False)
class Motions:
    """W windows of L steps, of which p' signals are compared: positions, where there are any.

    Attributes
    ----------
    windows : Windows
        What was measured.
    compared : (p,) bool array
        Which signals are compared.
    floor : (p',) array
        Lower bound of their error.
    noise : (p',) array
        The sensors' noise: by single steps, or by third differences where these are smaller.
    loadings : (W, L p', p) array
        The change of what is compared by the error of each measured signal at the start; of none,
        (W, L p', 0), where these do not matter.
    start_sd : (p,) array
        Standard deviations of those errors, or none.
    """

    windows: Windows
    compared: np.ndarray
    floor: Array
    noise: Array
    loadings: Array
    start_sd: Array

    @cached_property
    def moving(self) -> NDArray[np.bool_]:
        """(W L, p') where a signal that is compared moves."""
        signals = self.of_compared(self.windows.measured)
        signals = signals.reshape(len(self.windows), self.windows.length, -1)
        return moving(signals).reshape(-1, signals.shape[2])

    def of_compared(self, values: Array) -> Array:
        """Select the compared signals.

        Parameters
        ----------
        values : (..., W, L p) array
            Predictions of all signals, or changes of them.

        Returns
        -------
        (..., W, L p') array
            Those of the compared signals.
        """
        apart = values.reshape(*values.shape[:-1], self.windows.length, len(self.compared))
        return apart[..., self.compared].reshape(*values.shape[:-1], -1)

    def residuals(self, predicted: Array) -> Array:
        """Compare predictions with what was measured.

        Parameters
        ----------
        predicted : (..., W, L p) array
            Predictions of all signals.

        Returns
        -------
        (..., W, L p') array
            Measured less predicted, of the compared signals, in their units.
        """
        return self.of_compared(self.windows.measured - predicted)

    def whitener(self, scale: Array) -> Whitener:
        """Build the covariance of residuals, the start's noise included.

        Parameters
        ----------
        scale : (p',) array
            Standard deviation of each compared signal's error in every step.

        Returns
        -------
        Whitener
            What whitens residuals.
        """
        return Whitener(self.loadings, self.start_sd, white(scale))


def moving(signals: Array, settings: LongWindowSettings = SETTINGS) -> NDArray[np.bool_]:
    """Tell where signals move.

    Parameters
    ----------
    signals : (W, L, p) array
        In windows of L steps.
    settings : LongWindowSettings
        When a signal rests.

    Returns
    -------
    (W, L, p) bool array
        Whether a signal changes from here on by a part of what it usually changes by in that time.
    """
    length = signals.shape[1]
    span = min(max(1, length // settings.spans), length - 1)
    later = np.minimum(np.arange(length) + span, length - 1)
    change = np.abs(signals[:, later] - signals[:, later - span])
    usual = np.sqrt(np.mean(change**2, axis=(0, 1)))
    return np.asarray(change >= settings.resting * usual)


def motions_of(
    problem: Problem, library: Library, theta: Array, settings: LongWindowSettings = SETTINGS
) -> tuple[Motions, Motions]:
    """Cut a problem's data into windows as long as a model can be compared over.

    Parameters
    ----------
    problem : Problem
        Its data, some of them held out.
    library : Library
        The model.
    theta : (m,) array
        Its numbers.
    settings : LongWindowSettings
        Which windows.

    Returns
    -------
    fitted, held_out : Motions
        Those to fit in an order in which the first few of them tell the most, since a machine
        mostly does the same; those held out evenly spread.

    Raises
    ------
    BadArgument
        If the data are too few for the shortest windows, or none are held out.

    References
    ----------
    Fedorov, Theory of Optimal Experiments (1972), section 3.1: one after another, what adds most to
    the determinant of the information.
    """
    whole = whole_part(problem.trajectories)
    length = _length(problem, whole, library, theta, settings)
    signals = library.simulator.signals
    is_rate = np.array([signal.unit.endswith("/s") for signal in signals])
    compared = ~is_rate if not is_rate.all() else is_rate
    count = _count(problem, length, settings)
    pool = cut(problem, whole, length, settings.pool * count, "fit", FEW)
    order = _most_informative(pool, compared, settings.looked_at * count, settings)
    fractions = _curved_fractions(problem, library, theta, pool.take(order))
    # Those in which the start's noise acts too nonlinearly come last, the most linear first.
    bent = np.maximum(fractions, settings.curved)
    train = pool.take(order[np.argsort(bent, kind="stable")[:count]])
    test = _held_out(problem, length, settings)
    start_sd = first_noise(problem, library, train, theta, noise_floor(library.simulator, train))
    least = settings.rate_noise * spread_of(library.simulator, train)
    start_sd = np.where(is_rate, np.maximum(start_sd, least), start_sd)
    some = train.take(_spread(len(train), settings.few))
    few = _motions(library, theta, some, compared, start_sd)
    rows = few.residuals(library.predict(theta[None], some)[0]).reshape(-1, len(few.noise))
    error = np.tile(np.fmax(few.noise, deviation(rows)), length)
    fractions = (few.loadings * start_sd / error[:, None]) ** 2
    matters = fractions.sum(axis=2).mean() > settings.start
    make = _motions if matters else _from_known_starts
    return (
        make(library, theta, train, compared, start_sd),
        make(library, theta, test, compared, start_sd),
    )


def _most_informative(
    windows: Windows, compared: np.ndarray, wanted: int, settings: LongWindowSettings
) -> Ints:
    """The indices of so many windows, those first whose motions differ most from what is chosen.

    How far and how fast each signal moves in a window stands for what it says of a joint; one
    after another is taken that adds most to the determinant of these numbers' products.
    """
    shape = (len(windows), windows.length, len(compared))
    signals = windows.measured.reshape(shape)[:, :, compared]
    speed = np.sqrt(np.mean(np.diff(signals, axis=1, prepend=signals[:, :1]) ** 2, axis=1))
    moved = np.concatenate([signals.std(axis=1), speed], axis=1)
    moved /= np.maximum(np.sqrt(np.mean(moved**2, axis=0)), 1e-300)
    # By the inverse of the products so far, begun with little more than nothing.
    inverse = np.eye(moved.shape[1]) / settings.known_before
    gain = np.sum(moved**2, axis=1) / settings.known_before
    chosen = []
    for _ in range(min(wanted, len(windows))):
        best = int(np.argmax(gain))
        chosen.append(best)
        step = inverse @ moved[best]
        size = 1 + float(moved[best] @ step)
        inverse -= np.outer(step, step) / size
        gain -= (moved @ step) ** 2 / size
        gain[best] = -np.inf
    return np.array(chosen, dtype=np.int64)


def _spread(count: int, wanted: int) -> Ints:
    """The indices of a few of so many windows."""
    return np.unique(np.linspace(0, count - 1, wanted).round().astype(np.int64))


def _from_known_starts(
    library: Library, theta: Array, windows: Windows, compared: np.ndarray, start_sd: Array
) -> Motions:
    """Windows whose start's noise is forgotten before long."""
    rows = windows.length * int(compared.sum())
    loadings = np.zeros((len(windows), rows, 0))
    floor = noise_floor(library.simulator, windows)
    by_differences, tick = _noise_by_differences(windows, len(compared))
    noise = np.maximum(np.minimum(start_sd, by_differences), np.maximum(tick, floor))
    return Motions(windows, compared, floor[compared], noise[compared], loadings, np.zeros(0))


def _noise_by_differences(windows: Windows, p: int) -> tuple[Array, Array]:
    """(p,) the signals' noise by third differences, which motion hardly has, and by their ticks."""
    signals = windows.measured.reshape(len(windows), windows.length, p)
    steps = np.abs(np.diff(signals, axis=1)).reshape(-1, p)
    tick = np.min(steps, axis=0, initial=np.inf, where=steps > 1e-9 * np.ptp(signals))
    of_tick = np.where(np.isfinite(tick), tick, 0.0) / np.sqrt(12.0)
    if windows.length < 4:
        return np.full(p, np.inf), of_tick
    thirds = np.diff(signals, 3, axis=1).reshape(-1, p)
    return outer_spread(thirds) / np.sqrt(20.0), of_tick


def outer_spread(errors: Array, settings: OuterSpreadSettings = OUTER) -> Array:
    """Estimate the standard deviation of errors about 0 by one of the larger ones.

    Errors that are not finite are larger than all others.

    Parameters
    ----------
    errors : (n, p) array
        Errors of p signals.
    settings : OuterSpreadSettings
        Which one.

    Returns
    -------
    (p,) array
        The quantile of the sizes, in standard deviations of normal errors.
    """
    sizes = np.abs(np.where(np.isfinite(errors), errors, np.inf))
    outer = np.quantile(sizes, settings.quantile, axis=0, method="higher")
    return np.asarray(outer / settings.of_normal)


def _motions(
    library: Library, theta: Array, windows: Windows, compared: np.ndarray, start_sd: Array
) -> Motions:
    """Windows with the effect of their start's noise."""
    p = len(compared)
    offsets = np.concatenate([np.zeros((1, p)), np.diag(start_sd)])
    offsets = np.repeat(offsets[:, None], len(windows), axis=1)
    predicted = library.predict(np.repeat(theta[None], p + 1, axis=0), windows, offsets)
    plain = _from_known_starts(library, theta, windows, compared, start_sd)
    changes = plain.of_compared(np.nan_to_num(predicted[1:] - predicted[0]))
    loadings = np.moveaxis(changes / start_sd[:, None, None], 0, 2)
    return replace(plain, loadings=loadings, start_sd=start_sd)


def _held_out(problem: Problem, length: int, settings: LongWindowSettings) -> Windows:
    """Windows of the data held out, of this length or, where there are too few, of half of it."""
    if problem.held_out is None:
        raise BadArgument("Whole motions are evaluated on data held out. Got none.")
    part = whole_part(problem.held_out)
    while True:
        try:
            return cut(problem, part, length, _count(problem, length, settings), "hold out", FEW)
        except BadArgument:
            length //= 2
            if length == 0:
                raise


def _length(
    problem: Problem,
    part: DataPart,
    library: Library,
    theta: Array,
    settings: LongWindowSettings,
) -> int:
    """Control steps of the longest windows for which there are data, and to whose end the start's
    noise acts linearly.
    """
    step = library.simulator.control_step
    found = 0
    for seconds in settings.seconds:
        length = max(1, round(seconds / step)) if step else round(100 * seconds)
        if length <= found:
            continue
        try:
            few = FEW if found else WindowSettings()
            windows = cut(problem, part, length, settings.tried, "fit", few)
        except BadArgument:
            if not found:
                raise
            break
        if found and _curvature(problem, library, theta, windows) > settings.curved:
            break
        found = length
    return found


def _count(problem: Problem, length: int, settings: LongWindowSettings) -> int:
    """How many windows of a side are simulated."""
    skip = robot_of(problem).steps_per_action
    steps = min(settings.control_steps, settings.physics_steps // skip)
    return max(settings.tried, steps // length)


def _curved_fractions(problem: Problem, library: Library, theta: Array, windows: Windows) -> Array:
    """(W,) the part of errors in the last quarter that the start's noise makes by curvature.

    Infinite where a simulation diverges.
    """
    p = len(library.simulator.signals)
    sigma = first_noise(problem, library, windows, theta, noise_floor(library.simulator, windows))
    # Signs that follow no pattern, the same in every run.
    signs = np.where(np.sin(1.0 + np.arange(len(windows) * p) ** 2) > 0, 1.0, -1.0)
    shift = sigma * signs.reshape(len(windows), p)
    offsets = np.stack([np.zeros_like(shift), shift, -shift])
    predicted = library.predict(np.repeat(theta[None], 3, axis=0), windows, offsets)
    late = predicted[:, :, -max(1, windows.length // 4) * p :]
    curved = 0.5 * (late[1] + late[2]) - late[0]
    linear = 0.5 * (late[1] - late[2])
    noise = np.tile(sigma, late.shape[2] // p)
    of_curve = np.mean((curved / noise) ** 2, axis=1)
    fraction = of_curve / (1 + np.mean((linear / noise) ** 2, axis=1) + of_curve)
    return np.where(np.isfinite(fraction), fraction, np.inf)


def _curvature(problem: Problem, library: Library, theta: Array, windows: Windows) -> float:
    """What is bent of most windows."""
    fraction = _curved_fractions(problem, library, theta, windows)
    good = fraction[np.isfinite(fraction)]
    if len(good) < 0.5 * len(fraction):
        return np.inf
    return float(np.median(good))
