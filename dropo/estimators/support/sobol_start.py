"""Where a search begins if the simulator diverges at its start: elsewhere in the box."""

from dataclasses import dataclass

import numpy as np

from dropo.core.contracts.estimator import Run
from dropo.core.contracts.problem import Problem
from dropo.core.numerics.sobol import sobol_points
from dropo.core.services.validation import Array


@dataclass(frozen=True)
class SobolSettings:
    """How much of the box and of the data is tried.

    Attributes
    ----------
    points : int
        Points of the box, a power of 2.
    segments : int
        Segments that are simulated from each point, at most.
    """

    points: int = 64
    segments: int = 60


DEFAULTS = SobolSettings()


def best_sobol_point(problem: Problem, run: Run, settings: SobolSettings = DEFAULTS) -> Array:
    """Find the point of a Sobol set over the box whose simulations are nearest the measurements.

    Parameters
    ----------
    problem : Problem
    run : Run
        Counts the simulations.
    settings : SobolSettings

    Returns
    -------
    (d,) array
        The point with the least sum over the signals of log(median absolute error), on which a few
        diverging rows have no influence.
    """
    space = problem.space
    segments = problem.segments.take(problem.segments.thin(settings.segments))
    exponent = int(np.log2(settings.points))
    points = space.from_unit(sobol_points(len(space), exponent, np.random.default_rng(0)))
    with run.counting(evaluations=1):
        predictions = problem.simulator.predict(points, segments)
    errors = np.abs(predictions - problem.simulator.targets(segments))
    median = np.median(np.nan_to_num(errors, nan=np.inf), axis=1)
    error = np.log(median + np.finfo(float).tiny).sum(axis=1)
    return np.asarray(points[error.argmin()])
