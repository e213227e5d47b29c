"""How much later one sensor is than another, and how fast its clock runs beside the other's: from
what both have seen.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicHermiteSpline
from scipy.optimize import least_squares

from dropo.core.services.validation import Array, float_array, require
from dropo.logs.signals.velocities import estimate_velocities

GRID = 4000  # rows that the first search looks at
STARTS = 3  # of the search that follows, from the best of the grid
BLOCKS = 40  # pieces whose scores are taken as independent for the standard errors


@dataclass(frozen=True)
class Delay:
    """`seconds` that the signal is later than the reference, with its standard error.

    explained: the share of the signal's variance that the shifted reference explains; near 0
    nothing can be said.
    """

    seconds: float
    se: float
    explained: float


@dataclass(frozen=True)
class Clock:
    """What happens at t on the reference's clock is stamped t + seconds + skew (t - origin) on the
    signal's; se: standard errors.

    `seconds` holds the sensor's own delay too, which cannot be told from an offset of its clock.
    """

    seconds: float
    se: float
    skew: float
    skew_se: float
    explained: float
    origin: float


def estimate_delay(
    time: ArrayLike, reference: ArrayLike, signal: ArrayLike, *, most: float = 0.05
) -> Delay:
    """How much later `signal` is than `reference`, both (n,) or (n, p) at strictly increasing times
    (n,) [s], -most to most.

    Each column of the signal is a + b reference(t - delay) + noise, with its own a and b: the
    largest cross-correlation over a grid, then nonlinear least squares on the smoothed reference,
    so that the delay is no multiple of a time step. Standard errors hold for residuals that hang
    together in time (scores of whole blocks).
    """
    found, errors, explained, _ = _matched(
        (time, reference), (time, signal), most, 0.0, "estimate_delay"
    )
    return Delay(float(found[0]), float(errors[0]), explained)


def estimate_clock(
    reference_time: ArrayLike,
    reference: ArrayLike,
    signal_time: ArrayLike,
    signal: ArrayLike,
    *,
    most: float = 0.05,
    skew: float = 0.02,
) -> Clock:
    """Offset and skew together, from a reference (n,) or (n, p) and a signal (m,) or (m, p).

    reference_time (n,), signal_time (m,): their stamps [s], each by its own clock. Both clocks must
    be within `most` of each other at the reference's first stamp, and run at rates that differ by
    up to `skew`.
    """
    require(skew > 0, "skew", "above 0", skew, "estimate_clock")
    found, errors, explained, origin = _matched(
        (reference_time, reference), (signal_time, signal), most, skew, "estimate_clock"
    )
    return Clock(
        float(found[0]), float(errors[0]), float(found[1]), float(errors[1]), explained, origin
    )


def _back(stamps: Array, seconds: float, skew: float, origin: float) -> Array:
    return origin + (stamps - origin - seconds) / (1 + skew)


def _matched(
    reference: tuple[ArrayLike, ArrayLike],
    signal: tuple[ArrayLike, ArrayLike],
    most: float,
    skew: float,
    caller: str,
) -> tuple[Array, Array, float, float]:
    """Seconds, and with `skew` > 0 the skew; their standard errors; the explained share; the
    origin.
    """
    require(most > 0, "most", "above 0", most, caller)
    time, seen = _columns("reference", *reference, caller)
    stamps, measured = _columns("signal", *signal, caller)
    require(
        seen.shape[1] == measured.shape[1],
        "signal",
        f"of {seen.shape[1]} columns, as the reference",
        measured.shape[1],
        caller,
    )
    smooth = estimate_velocities(time, seen)
    curve = CubicHermiteSpline(time, smooth.positions, smooth.velocities)
    slopes = smooth.velocities.std(axis=0)
    require(
        bool((slopes > 0).all() and (measured.std(axis=0) > 0).all()),
        "reference and signal",
        "moving",
        "a constant",
        caller,
    )
    width = float((seen.std(axis=0) / slopes).min())  # seconds over which the reference changes
    origin = float(time[0])
    span = float(stamps[-1] - time[0])

    def residuals(theta: Array, rows: slice) -> Array:
        at = _back(stamps[rows], theta[0], theta[1] if skew else 0.0, origin)
        return _unexplained(curve, at, measured[rows], (time[0], time[-1]))

    steps = [np.arange(-most, most + 1e-12, min(width / 2, most / 4))]
    steps += [np.arange(-skew, skew * (1 + 1e-12), min(width / 2 / span, skew / 4))] if skew else []
    grid = np.stack([axis.ravel() for axis in np.meshgrid(*steps, indexing="ij")], axis=1)
    some = slice(None, None, max(1, len(stamps) // GRID))
    costs = [float(np.sum(residuals(theta, some) ** 2)) for theta in grid]
    scale = [width, width / span][: grid.shape[1]]
    fits = [
        _refined(lambda theta: residuals(theta, slice(None)).ravel(), grid[i], scale)
        for i in np.argsort(costs)[:STARTS]
    ]
    theta, slope, rest = min(fits, key=lambda fit: float(fit[2] @ fit[2]))
    explained = 1 - float(rest @ rest) / rest.size
    return (
        theta,
        _errors(slope.reshape(*measured.shape, -1), rest.reshape(measured.shape)),
        explained,
        origin,
    )


def _columns(name: str, time: ArrayLike, values: ArrayLike, caller: str) -> tuple[Array, Array]:
    stamps = float_array("time", time, (None,), caller)
    rows = np.asarray(values, dtype=float)
    return stamps, float_array(
        name, rows[:, None] if rows.ndim == 1 else rows, (len(stamps), None), caller
    )


def _unexplained(
    curve: CubicHermiteSpline, at: Array, measured: Array, span: tuple[float, float]
) -> Array:
    """(n, p) what no line through the reference explains, in standard deviations of the signal; 0
    outside of the reference's span.
    """
    inside = (at >= span[0]) & (at <= span[1])
    out = np.zeros_like(measured)
    if inside.sum() < 10:
        return np.ones_like(measured)
    seen = curve(at[inside])
    here = measured[inside]
    seen = seen - seen.mean(axis=0)
    here = here - here.mean(axis=0)
    gain = np.sum(seen * here, axis=0) / np.sum(seen**2, axis=0)
    out[inside] = (here - gain * seen) / measured.std(axis=0)
    return out


def _refined(
    residuals: Callable[[Array], Array], start: Array, scale: list[float]
) -> tuple[Array, Array, Array]:
    steps = np.full(len(start), 1e-4)
    found = least_squares(
        residuals, start, x_scale=scale, xtol=1e-12, ftol=1e-12, diff_step=steps, jac="3-point"
    )
    return found.x, np.asarray(found.jac), found.fun


def _errors(slope: Array, rest: Array) -> Array:
    """Standard errors from slopes (n, p, d) and residuals (n, p): the scores of blocks of rows are
    taken as independent.

    Each column counts by its own residuals alone, as it did in the sum of squares.
    """
    blocks = np.array_split(np.arange(len(rest)), min(BLOCKS, len(rest)))
    scores = np.array([np.einsum("npd,np->d", slope[rows], rest[rows]) for rows in blocks])
    bread = np.linalg.pinv(np.einsum("npd,npe->de", slope, slope), hermitian=True)
    return np.sqrt(np.diagonal(bread @ (scores.T @ scores) @ bread))
