"""Fitting some of theta to windows: robust Gauss-Newton, with the noise learned in between."""

from dataclasses import replace

import numpy as np
from scipy.optimize import lsq_linear

from dropo.core.records.trajectories import Ints
from dropo.core.services.validation import Array
from dropo.diagnosis.search.linearization import (
    Library,
    LinearizedWindows,
    linearize,
    moved,
    noise_of,
    whitener,
)

SHORTER = np.array(
    [0.5, 0.25, 0.1, 0.02]
)  # shares of a step that are tried where the whole of it does not keep its promise
NEAR = 0.02  # of the usual half widths of differences: where predictions bend within those
CREEPS = 0.5  # of what a step promised: the next one must promise less
KEPT = 0.2  # share of the promised gain that a whole step must bring
SETTLED = 0.1  # [nats] below which a round of steps gains nothing more
# times at most that the start noise's way is found anew in a fit; nats from which that changes
# something
RENEWED = 4
MATTERS = 3.0
HELD = 0.1  # of the bounds' distance: the width of the prior that holds a step back
CLEAN = 10.0  # times the least noise: below it, data are without noise
OTHER = 1.3  # times a noise, from which its way through the simulation is found anew
NONE = np.zeros(0, dtype=np.int64)
SCAN = np.array(
    [0.05, 0.15, 0.3, 0.5, 0.7, 0.85, 1.15, 1.4, 1.8, 2.5, 4.0]
)  # multiples of a size where steps cannot be trusted


def refit(
    library: Library,
    seen: LinearizedWindows,
    free: np.ndarray,
    floor: Array,
    *,
    rounds: int = 4,
    rough: Ints = NONE,
    renewals: int = RENEWED,
) -> LinearizedWindows:
    """The windows of a look at the theta that they are most likely under in the free numbers, and
    under the noise that fits it.

    rough: which numbers a line scan looks for at first, since predictions are not smooth in them.
    The start noise's way is found anew at the new theta, and where that matters the fit goes on.
    Data without noise are fitted with slopes from close by in the end.
    """
    seen = settle(library, seen, free, floor, rounds=rounds, rough=rough)
    for _ in range(renewals):
        renewed = linearize(library, seen.windows, seen.theta, seen.whiten.sigma)
        if abs(float(renewed.log_likelihood.sum() - seen.log_likelihood.sum())) < MATTERS:
            seen = renewed
            break
        seen = settle(library, renewed, free, floor, rounds=2)
    clean = np.median(seen.whiten.sigma / floor) < CLEAN
    return settle(library, seen, free, floor, near=True) if clean else seen


def with_noise(library: Library, seen: LinearizedWindows, floor: Array) -> LinearizedWindows:
    """The look under the noise that its residuals have; its way through the simulation is found
    anew where it is quite another.
    """
    sigma = noise_of(seen, seen.whiten.sigma, floor)
    other = np.any(np.abs(np.log(sigma / seen.whiten.sigma)) > np.log(OTHER))
    return (
        linearize(library, seen.windows, seen.theta, sigma)
        if other
        else moved(library, seen, seen.theta, sigma)
    )


def settle(
    library: Library,
    seen: LinearizedWindows,
    free: np.ndarray,
    floor: Array,
    *,
    rounds: int = 2,
    rough: Ints = NONE,
    known: Array | None = None,
    near: bool = False,
) -> LinearizedWindows:
    """The same with the start noise's way as it is in `seen`, which a comparison of candidates can
    do with.

    known: slopes (k, W, n) of the first k free numbers that may stand for those at any theta near;
    near: whether slopes are found close by.
    """
    slopes = None
    for _ in range(rounds):
        before = float(seen.log_likelihood.sum())
        for number in rough:
            seen = _scan(library, seen, int(number))
            slopes = None
        rough = NONE
        seen, slopes = _steps(library, seen, free, known, slopes, near)
        sigma = noise_of(seen, seen.whiten.sigma, floor)
        seen = moved(library, seen, seen.theta, sigma)
        if abs(float(seen.log_likelihood.sum()) - before) < SETTLED:
            break
    return seen


def _steps(
    library: Library,
    seen: LinearizedWindows,
    free: np.ndarray,
    known: Array | None,
    slopes: Array | None,
    near: bool,
    most: int = 5,
) -> tuple[LinearizedWindows, Array | None]:
    """Gauss-Newton steps with the noise as it is, whole ones where they do what they promise, else
    shorter ones; in bounds.

    The slopes are found anew where a step does not keep its promise, or where there are none yet;
    and closer by where that does not help,
    or where step after step promises the same: predictions bend within the usual width of
    differences, as they do in a contact's margin, and a few windows that an impact enters hold all
    others back. They come back too.
    """
    fresh = slopes is None
    before = np.inf
    for _ in range(most if len(free) else 0):
        if slopes is None:
            slopes = (
                library.slopes(seen.theta, free, seen.windows, NEAR)
                if near
                else _slopes(library, seen, free, known)
            )
            fresh = True
        step, promised = _step(library, seen, free, slopes)
        seen, gain = _along(library, seen, free, step[None])
        kept = gain > KEPT * promised
        creeps = promised > CREEPS * before
        before = promised
        if fresh and not kept:
            seen, more = _along(library, seen, free, SHORTER[:, None] * step)
            gain += more
        if gain < SETTLED and (kept or near or promised < SETTLED):
            break
        near = near or (fresh and (creeps or gain < SETTLED))
        if creeps or not kept:
            slopes = None
        fresh = False
    return seen, slopes


def _slopes(
    library: Library, seen: LinearizedWindows, free: np.ndarray, known: Array | None
) -> Array:
    first = 0 if known is None else len(known)
    own = library.slopes(seen.theta, free[first:], seen.windows)
    return own if known is None else np.concatenate([known, own])


def _step(
    library: Library, seen: LinearizedWindows, free: np.ndarray, slopes: Array
) -> tuple[Array, float]:
    """The step (f,) within the bounds, and the nats that it promises.

    It is held back as by a prior of a share of the bounds' distance, so that it does not run along
    what the data do not tell apart (Levenberg 1944).
    """
    low, high = (
        bound[free] for bound in (library.simulator.space.low, library.simulator.space.high)
    )
    rows = seen.flat(slopes)
    target = seen.flat(seen.residuals)
    scale = np.maximum(np.linalg.norm(rows, axis=1), 1 / (HELD * (high - low)))
    q, r = np.linalg.qr((rows / scale[:, None]).T)
    held = np.concatenate([r, np.diag(1 / (HELD * (high - low) * scale))])
    reach = (
        np.minimum(low - seen.theta[free], -1e-12 / scale) * scale,
        np.maximum(high - seen.theta[free], 1e-12 / scale) * scale,
    )
    step = (
        lsq_linear(held, np.concatenate([q.T @ target, np.zeros(len(free))]), bounds=reach).x
        / scale
    )
    moves = step @ rows
    return step, float(moves @ target) - 0.5 * float(moves @ moves)


def _along(
    library: Library, seen: LinearizedWindows, free: np.ndarray, steps: Array
) -> tuple[LinearizedWindows, float]:
    space = library.simulator.space
    tried = np.repeat(seen.theta[None], len(steps), axis=0)
    tried[:, free] = np.clip(seen.theta[free] + steps, space.low[free], space.high[free])
    return _best(library, seen, tried)


def _scan(library: Library, seen: LinearizedWindows, number: int) -> LinearizedWindows:
    """One number of theta at multiples of its size."""
    space = library.simulator.space
    tried = np.repeat(seen.theta[None], len(SCAN), axis=0)
    tried[:, number] = np.clip(SCAN * seen.theta[number], space.low[number], space.high[number])
    return _best(library, seen, tried)[0]


def _best(
    library: Library, seen: LinearizedWindows, tried: Array
) -> tuple[LinearizedWindows, float]:
    """The best of several thetas (K, m) where it is better than the present one, and the nats
    gained; the noise stays.
    """
    predictions = library.predict(tried, seen.windows)
    ways = [
        whitener(library, seen.windows, theta, seen.whiten.sigma, seen.loadings) for theta in tried
    ]
    values = np.array(
        [
            replace(seen, whiten=way).of(one).sum()
            for way, one in zip(ways, predictions, strict=True)
        ]
    )
    k = int(np.nanargmax(np.where(np.isfinite(values), values, -np.inf)))
    gain = float(values[k] - seen.log_likelihood.sum())
    if not gain > 0:
        return seen, 0.0
    residuals = seen.windows.measured - predictions[k] - seen.shift
    bad = seen.lost | ~np.isfinite(residuals).all(axis=1)
    residuals[bad] = seen.residuals[bad]
    return replace(seen, theta=tried[k], residuals=residuals, whiten=ways[k]), gain
