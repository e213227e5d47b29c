"""How long windows must be for what is wrong to stand out from the sensors' noise."""

import numpy as np

from dropo.core.contracts.problem import Problem
from dropo.core.numerics.robust_statistics import deviation
from dropo.core.services.validation import Array
from dropo.diagnosis.search.linearization import Library, linearize
from dropo.diagnosis.search.windows import Windows, split, spread_of

SHORTEST = 5  # steps; enough where the simulation's errors stand out from the noise so early
LENGTHS = (5, 10, 20, 50, 100, 200, 500, 1000)
STANDS_OUT = 3.0  # times what noise explains that most windows must be off by in some signal
# share of what noise explains that is not linear in it, from which windows are too long to judge
CURVED = 0.2
# windows on each side that must be left; windows that are looked at
ENOUGH = 16
TRIED = 24


def choose_length(problem: Problem, windows: int) -> int:
    """The problem's own horizon, where it states one (lambda above 1), but at least SHORTEST; else
    the first of LENGTHS at which the model as it is, with its parameters nominal, is off by
    STANDS_OUT times the noise. SHORTEST where it is at none: for want of data, or where the
    start's noise grows until it bends (impacts, chaos), and no likelihood holds that takes its
    way to be nearly straight.
    """
    if problem.length > 1:
        return max(SHORTEST, problem.length)
    library = Library(problem.simulator, (), len(problem.space))
    theta = np.clip(
        np.asarray(problem.simulator.nominal, dtype=float), problem.space.low, problem.space.high
    )
    sigma: Array | None = None
    for length in LENGTHS:
        if not _enough(problem, length):
            break
        train = split(problem, length, TRIED)[0]
        if sigma is None:
            sigma = first_noise(
                problem,
                library,
                train,
                theta,
                np.maximum(1e-5 * spread_of(problem.simulator, train), 1e-12),
            )
        surprise, curved = _judged(library, train, theta, sigma)
        if surprise > STANDS_OUT:
            return length
        if curved > CURVED:
            break
    return SHORTEST


def _enough(problem: Problem, length: int) -> bool:
    sides = (
        (problem.trajectories, problem.held_out)
        if problem.held_out is not None
        else (problem.trajectories,)
    )
    least = ENOUGH if problem.held_out is not None else 2 * ENOUGH
    return all(
        sum((stop - start) // (length + 1) for start, stop in side.spans) >= least for side in sides
    )


def _judged(library: Library, windows: Windows, theta: Array, sigma: Array) -> tuple[float, float]:
    """How many times the noise's reach most windows are off at their last step, in the signal where
    that is most; and what share of the noise's reach there is of second order, on average.
    """
    linearized = linearize(library, windows, theta, sigma)
    p = len(sigma)
    linear, bent = np.split((linearized.loadings[:, -p:] * np.tile(sigma, 2)) ** 2, 2, axis=2)
    variance = sigma**2 + linear.sum(axis=2) + bent.sum(axis=2)
    off = np.abs(linearized.residuals[:, -p:]) / (0.6745 * np.sqrt(variance))
    return float(np.median(off, axis=0).max()), float(np.mean(bent.sum(axis=2) / variance))


def first_noise(
    problem: Problem, library: Library, train: Windows, theta: Array, floor: Array
) -> Array:
    """(p,) the stated noise, else the spread of most one-step residuals."""
    if problem.epsilon is not None:
        return np.maximum(
            np.sqrt(np.broadcast_to(np.asarray(problem.epsilon, dtype=float), floor.shape)), floor
        )
    residuals = (train.measured - library.predict(theta[None], train)[0])[:, : len(floor)]
    found = residuals[np.isfinite(residuals).all(axis=1)]
    return np.maximum(deviation(found) / np.sqrt(2), floor) if len(found) else floor
