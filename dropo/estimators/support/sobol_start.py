"""Where a search begins when the simulator explodes at its start: elsewhere in the box."""

import numpy as np
from scipy.stats import qmc

from dropo.core.contracts.estimator import Run
from dropo.core.contracts.problem import Problem
from dropo.core.services.validation import Array

# looked at, on about so many segments
POINTS = 64
SEGMENTS = 60


def best_sobol_point(problem: Problem, run: Run) -> Array:
    """(d,) of 64 points over the box, the one whose simulations are nearest to most of the
    measurements.

    By the sum over the signals of the logarithm of their median error, which a few wild rows do not
    move.
    """
    space = problem.space
    segments = problem.segments
    some = segments.take(segments.thin(SEGMENTS))
    points = space.from_unit(
        qmc.Sobol(len(space), rng=np.random.default_rng(0)).random_base2(int(np.log2(POINTS)))
    )
    with run.counting(evaluations=1):
        predictions = problem.simulator.predict(points, some)
    errors = np.nan_to_num(np.abs(predictions - problem.simulator.targets(some)), nan=np.inf)
    return np.asarray(
        points[np.log(np.median(errors, axis=1) + np.finfo(float).tiny).sum(axis=1).argmin()]
    )
