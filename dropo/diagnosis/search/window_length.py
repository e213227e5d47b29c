"""How long windows must be for errors of the model to stand out from the sensors' noise."""

import math
from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from dropo.core.contracts.problem import Problem
from dropo.core.contracts.simulator import Simulator
from dropo.core.numerics.robust_statistics import deviation
from dropo.core.services.validation import Array
from dropo.diagnosis.search.linearization import Library, linearize
from dropo.diagnosis.search.whitening import white
from dropo.diagnosis.search.windows import Windows, split, spread_of


@dataclass(frozen=True)
class WindowLengthSettings:
    """Which horizons are tried, and when one is long enough.

    Attributes
    ----------
    shortest : int
        Control steps; enough where errors stand out from the noise at once ...
    seconds : float
        ... and velocities were measured. Where they were estimated, windows are no shorter than
        this [s]: of a few positions, most only tell with which velocity a window starts.
    horizons : tuple of int
        Control steps that are tried, in this order.
    stands_out : float
        Most windows must be off by this multiple of what noise explains, in some signal.
    curved : float
        Fraction of the noise's variance that is not linear in it, above which windows are too long.
    fewest : int
        Windows of each side that must be left.
    tried : int
        Windows that are simulated.
    minimum_noise : float
        Lower bound of the noise, as a fraction of each signal's spread.
    """

    shortest: int = 5
    seconds: float = 0.25
    horizons: tuple[int, ...] = (5, 10, 20, 50, 100, 200, 500, 1000)
    stands_out: float = 3.0
    curved: float = 0.2
    fewest: int = 16
    tried: int = 24
    minimum_noise: float = 1e-5


SETTINGS = WindowLengthSettings()


def choose_length(problem: Problem, settings: WindowLengthSettings = SETTINGS) -> int:
    """Choose the horizon of a diagnosis's windows.

    Parameters
    ----------
    problem : Problem
        Its own horizon (lambda) is taken if it is above 1, but no less than the shortest.
    settings : WindowLengthSettings
        Which horizons are tried.

    Returns
    -------
    int
        Control steps. The first horizon at which the model with nominal parameters is clearly off;
        the shortest if it is at none. That is so where the data are too few, or where the start's
        noise grows so fast (impacts, chaos) that no linearization in it holds.
    """
    if problem.horizon > 1:
        return max(settings.shortest, problem.horizon)
    shortest = _shortest(problem, settings)
    space = problem.space
    library = Library(problem.simulator, (), len(space))
    nominal = np.asarray(problem.simulator.nominal, dtype=float)
    theta = space.clip(nominal)
    sigma: Array | None = None
    longer = [horizon for horizon in settings.horizons if horizon > shortest]
    for horizon in (shortest, *longer):
        if not _enough(problem, horizon, settings.fewest):
            break
        train = split(problem, horizon, settings.tried)[0]
        if sigma is None:
            floor = noise_floor(problem.simulator, train, settings)
            sigma = first_noise(problem, library, train, theta, floor)
        error, curved = _errors_and_curvature(library, train, theta, sigma)
        if horizon == shortest > settings.shortest and curved > settings.curved:
            return settings.shortest
        if error > settings.stands_out:
            return horizon
        if curved > settings.curved:
            break
    return shortest


def _shortest(problem: Problem, settings: WindowLengthSettings) -> int:
    """The shortest horizon, in control steps, of which the data hold enough windows."""
    step = problem.simulator.control_step
    if not problem.estimated or step is None:
        return settings.shortest
    horizon = max(settings.shortest, math.ceil(settings.seconds / step))
    while horizon > settings.shortest and not _enough(problem, horizon, settings.fewest):
        horizon = max(settings.shortest, horizon // 2)
    return horizon


def _enough(problem: Problem, horizon: int, fewest: int) -> bool:
    """Whether both sides of the data hold enough windows."""
    sides = [problem.trajectories]
    needed = 2 * fewest  # half of them are held out
    if problem.held_out is not None:
        sides.append(problem.held_out)
        needed = fewest
    for side in sides:
        windows = sum((stop - start) // (horizon + 1) for start, stop in side.spans)
        if windows < needed:
            return False
    return True


def _errors_and_curvature(
    library: Library, windows: Windows, theta: Array, sigma: Array
) -> tuple[float, float]:
    """How far windows are off at their last step, and how curved the noise's effect is there.

    The first is the median over windows, in units of what noise explains, of the worst signal; the
    second the fraction of the noise's variance that is of second order, on average.
    """
    linearized = linearize(library, windows, theta, white(sigma))
    p = len(sigma)
    loadings = linearized.loadings[:, -p:] * np.tile(sigma, 2)
    linear, quadratic = np.split(loadings**2, 2, axis=2)
    curved = quadratic.sum(axis=2)
    variance = sigma**2 + linear.sum(axis=2) + curved
    # 0.6745 sd is the median of a Gaussian's absolute value.
    off = np.abs(linearized.residuals[:, -p:]) / (0.6745 * np.sqrt(variance))
    return float(np.median(off, axis=0).max()), float(np.mean(curved / variance))


def noise_floor(
    simulator: Simulator,
    train: Windows,
    settings: WindowLengthSettings = SETTINGS,
    estimated: Collection[str] = (),
) -> Array:
    """Return the lower bound (p,) of the noise in a diagnosis.

    Of signals that are estimated nothing is taken as known: a smoother's errors are common to the
    states around it, so that they look like a cause, mostly a late sensor.

    Parameters
    ----------
    simulator : Simulator
        Whose signals they are.
    train : Windows
        Windows to fit, which give each signal's spread.
    settings : WindowLengthSettings
        Which fraction of the spread it is.
    estimated : collection of str
        Names of the signals whose bound is the whole spread.

    Returns
    -------
    (p,) array
        Standard deviations, in the signals' units.
    """
    unknown = [signal.name in estimated for signal in simulator.signals]
    fraction = np.where(unknown, 1.0, settings.minimum_noise)
    return np.maximum(fraction * spread_of(simulator, train), 1e-12)


def first_noise(
    problem: Problem, library: Library, train: Windows, theta: Array, floor: Array
) -> Array:
    """Guess the noise before anything is fitted.

    Parameters
    ----------
    problem : Problem
        Its noise is taken if it states one.
    library : Library
        The simulator.
    train : Windows
        Windows to fit.
    theta : (m,) array
        The parameters.
    floor : (p,) array
        Lower bound.

    Returns
    -------
    (p,) array
        The stated standard deviations, else the robust spread of one-step residuals over sqrt(2).
    """
    if problem.epsilon is not None:
        stated = np.broadcast_to(np.asarray(problem.epsilon, dtype=float), floor.shape)
        return np.maximum(np.sqrt(stated), floor)
    residuals = train.measured - library.predict(theta[None], train)[0]
    one_step = residuals[:, : len(floor)]
    found = one_step[np.isfinite(one_step).all(axis=1)]
    if not len(found):
        return floor
    return np.maximum(deviation(found) / np.sqrt(2), floor)
