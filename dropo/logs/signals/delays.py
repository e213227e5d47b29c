"""How much later one sensor is than another, and how fast its clock runs beside the other's.

Both follow from what the two sensors have seen. In reading order: `estimate_delay` and
`estimate_clock` call `_match`, which searches a grid and refines the best of it.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicHermiteSpline
from scipy.optimize import least_squares

from dropo.core.services.validation import Array, float_array, require
from dropo.logs.signals.velocities import estimate_velocities


@dataclass(frozen=True)
class DelaySettings:
    """How a delay is searched for.

    Attributes
    ----------
    grid_rows : int
        Rows of the signal that the search on a grid uses at most.
    starts : int
        The best points of the grid, from which nonlinear least squares start.
    blocks : int
        Blocks of rows whose scores are taken as independent for the standard errors.
    minimum_overlap : int
        Rows of the signal that the shifted reference must cover.
    """

    grid_rows: int = 4000
    starts: int = 3
    blocks: int = 40
    minimum_overlap: int = 10


DEFAULTS = DelaySettings()


@dataclass(frozen=True)
class Delay:
    """How much later a signal is than its reference.

    Attributes
    ----------
    seconds : float
        By how much.
    se : float
        Its standard error [s].
    explained : float
        Fraction of the signal's variance that the shifted reference explains; near 0 nothing can
        be said.
    """

    seconds: float
    se: float
    explained: float


@dataclass(frozen=True)
class Clock:
    """How a signal's clock runs beside its reference's.

    What happens at t on the reference's clock is stamped t + seconds + skew (t - origin) on the
    signal's.

    Attributes
    ----------
    seconds : float
        Offset [s]; it holds the sensor's own delay, too, which nothing distinguishes from it.
    se : float
        Standard error of `seconds`.
    skew : float
        How much faster the clock runs, as a fraction.
    skew_se : float
        Standard error of `skew`.
    explained : float
        As of `Delay`.
    origin : float
        The reference's first stamp [s].
    """

    seconds: float
    se: float
    skew: float
    skew_se: float
    explained: float
    origin: float


def estimate_delay(
    time: ArrayLike,
    reference: ArrayLike,
    signal: ArrayLike,
    *,
    max_delay: float = 0.05,
    settings: DelaySettings = DEFAULTS,
) -> Delay:
    """Estimate how much later a signal is than a reference.

    Parameters
    ----------
    time : (n,) array
        Strictly increasing stamps of both [s].
    reference, signal : (n,) or (n, p) array
        What both have seen, each in a unit of its own.
    max_delay : float
        The delay lies between -max_delay and max_delay [s].
    settings : DelaySettings, optional
        How it is searched for.

    Returns
    -------
    Delay

    Raises
    ------
    BadArgument
        If `max_delay` is not above 0, the arrays have different shapes or are not finite, `time`
        does not increase, or a column is constant.

    Notes
    -----
    Each column of the signal is a + b reference(t - delay) + noise, with its own a and b: the
    largest cross-correlation over a grid, then nonlinear least squares on the smoothed reference,
    so that the delay is no multiple of a time step. Standard errors hold for residuals that are
    correlated in time (scores of whole blocks).
    """
    found = _match((time, reference), (time, signal), max_delay, 0.0, "estimate_delay", settings)
    return Delay(float(found.theta[0]), float(found.errors[0]), found.explained)


def estimate_clock(
    reference_time: ArrayLike,
    reference: ArrayLike,
    signal_time: ArrayLike,
    signal: ArrayLike,
    *,
    max_delay: float = 0.05,
    skew: float = 0.02,
    settings: DelaySettings = DEFAULTS,
) -> Clock:
    """Estimate offset and skew of a signal's clock together.

    Parameters
    ----------
    reference_time : (n,) array
        Strictly increasing stamps of the reference [s], by its own clock.
    reference : (n,) or (n, p) array
        What it has seen.
    signal_time : (m,) array
        Stamps of the signal [s], by its own clock.
    signal : (m,) or (m, p) array
        What it has seen.
    max_delay : float
        Both clocks are within so many seconds of each other at the reference's first stamp.
    skew : float
        Their rates differ by up to this fraction.
    settings : DelaySettings, optional
        How both are searched for.

    Returns
    -------
    Clock

    Raises
    ------
    BadArgument
        If `max_delay` or `skew` is not above 0, the arrays have different shapes or are not finite,
        stamps do not increase, or a column is constant.
    """
    caller = "estimate_clock"
    require(skew > 0, "skew", "above 0", skew, caller)
    one = (reference_time, reference)
    found = _match(one, (signal_time, signal), max_delay, skew, caller, settings)
    seconds, rate = found.theta.tolist()
    se, skew_se = found.errors.tolist()
    return Clock(seconds, se, rate, skew_se, found.explained, found.origin)


@dataclass(frozen=True, eq=False)
class _Match:
    """Seconds and, where free, the skew (d,), their standard errors, and how well they fit."""

    theta: Array
    errors: Array
    explained: float
    origin: float


def _match(
    reference: tuple[ArrayLike, ArrayLike],
    signal: tuple[ArrayLike, ArrayLike],
    max_delay: float,
    skew: float,
    caller: str,
    settings: DelaySettings,
) -> _Match:
    """Shift the reference, each with its stamps, onto the signal; `skew` 0 keeps the rate."""
    require(max_delay > 0, "max_delay", "above 0", max_delay, caller)
    time, recorded = _as_columns("reference", *reference, caller)
    stamps, measured = _as_columns("signal", *signal, caller)
    rule = f"of {recorded.shape[1]} columns, as the reference"
    require(recorded.shape[1] == measured.shape[1], "signal", rule, measured.shape[1], caller)

    # the reference as a smooth curve
    smooth = estimate_velocities(time, recorded)
    curve = CubicHermiteSpline(time, smooth.positions, smooth.velocities)
    speeds = smooth.velocities.std(axis=0)
    moving = bool((speeds > 0).all() and (measured.std(axis=0) > 0).all())
    require(moving, "reference and signal", "moving", "a constant", caller)
    width = float((recorded.std(axis=0) / speeds).min())  # seconds over which the reference changes
    origin = float(time[0])
    duration = float(stamps[-1] - time[0])

    def residuals(theta: Array, rows: slice) -> Array:
        rate = theta[1] if skew else 0.0
        at = origin + (stamps[rows] - origin - theta[0]) / (1 + rate)
        return _unexplained(curve, at, measured[rows], settings.minimum_overlap)

    def all_residuals(theta: Array) -> Array:
        return residuals(theta, slice(None)).ravel()

    # the grid, fine enough that the reference changes little from point to point
    axes = [np.arange(-max_delay, max_delay + 1e-12, min(width / 2, max_delay / 4))]
    if skew:
        step = min(width / 2 / duration, skew / 4)
        axes.append(np.arange(-skew, skew * (1 + 1e-12), step))
    grid = np.stack([axis.ravel() for axis in np.meshgrid(*axes, indexing="ij")], axis=1)
    some = slice(None, None, max(1, len(stamps) // settings.grid_rows))
    costs = [float(np.sum(residuals(theta, some) ** 2)) for theta in grid]

    # least squares from the best of it
    scale = [width, width / duration][: grid.shape[1]]
    starts = np.argsort(costs)[: settings.starts]
    fits = [_refine(all_residuals, grid[i], scale) for i in starts]
    theta, jacobian, rest = min(fits, key=lambda fit: float(fit[2] @ fit[2]))
    explained = 1 - float(rest @ rest) / rest.size
    shape = measured.shape
    errors = _standard_errors(jacobian.reshape(*shape, -1), rest.reshape(shape), settings.blocks)
    return _Match(theta, errors, explained, origin)


def _as_columns(name: str, time: ArrayLike, values: ArrayLike, caller: str) -> tuple[Array, Array]:
    """Stamps (n,) and values (n, p)."""
    stamps = float_array("time", time, (None,), caller)
    rows = np.asarray(values, dtype=float)
    if rows.ndim == 1:
        rows = rows[:, None]
    return stamps, float_array(name, rows, (len(stamps), None), caller)


def _unexplained(
    curve: CubicHermiteSpline, at: Array, measured: Array, minimum_overlap: int
) -> Array:
    """(n, p) what no line through the reference explains, in standard deviations of the signal.

    It is 0 outside of the reference's span, and 1 everywhere where both overlap too little.
    """
    inside = (at >= curve.x[0]) & (at <= curve.x[-1])
    if inside.sum() < minimum_overlap:
        return np.ones_like(measured)
    shifted = curve(at[inside])
    here = measured[inside]
    shifted = shifted - shifted.mean(axis=0)
    here = here - here.mean(axis=0)
    gain = np.sum(shifted * here, axis=0) / np.sum(shifted**2, axis=0)
    out = np.zeros_like(measured)
    out[inside] = (here - gain * shifted) / measured.std(axis=0)
    return out


def _refine(
    residuals: Callable[[Array], Array], start: Array, scale: list[float]
) -> tuple[Array, Array, Array]:
    """The least squares from a start, their Jacobian and residuals."""
    steps = np.full(len(start), 1e-4)
    found = least_squares(
        residuals, start, x_scale=scale, xtol=1e-12, ftol=1e-12, diff_step=steps, jac="3-point"
    )
    return found.x, np.asarray(found.jac), found.fun


def _standard_errors(jacobian: Array, rest: Array, count: int) -> Array:
    """Standard errors from a Jacobian (n, p, d) and residuals (n, p).

    The scores of `count` blocks of rows are taken as independent. Each column counts by its own
    residuals alone, as it did in the sum of squares.
    """
    blocks = np.array_split(np.arange(len(rest)), min(count, len(rest)))
    scores = np.array([np.einsum("npd,np->d", jacobian[rows], rest[rows]) for rows in blocks])
    bread = np.linalg.pinv(np.einsum("npd,npe->de", jacobian, jacobian), hermitian=True)
    return np.sqrt(np.diagonal(bread @ (scores.T @ scores) @ bread))
