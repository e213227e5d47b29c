"""Parameters that explain most windows, however wild the others are."""

from dataclasses import dataclass

import numpy as np

from dropo.core.contracts.simulator import Simulator
from dropo.core.numerics.robust_statistics import deviation
from dropo.core.records.trajectories import Segments
from dropo.core.services.validation import Array, float_array

# Gauss-Newton steps at most; shares of the search intervals by which the last one moves
ROUNDS = 8
SETTLED = 1e-4
DEGREES = 3.0  # of freedom of the Student t whose weights the windows have
PRIOR = 1e-6  # of the information: a normal prior of a thousand search intervals
LONGEST = 0.25  # of a step, in search intervals


@dataclass(frozen=True, eq=False)
class RobustFit:
    """value: (d,); and at the last step, in units of the search intervals: information (d, d), its
    inverse under a wide prior, and the scores of each window (W, d).
    """

    value: Array
    information: Array
    inverse: Array
    scores: Array


def robust_fit(
    simulator: Simulator,
    windows: Segments,
    start: Array,
    *,
    beyond: bool = False,
    rounds: int = ROUNDS,
) -> RobustFit:
    """Gauss-Newton with the weights of a Student t, from `start` (d,), within the search intervals;
    beyond: or as far as is possible.

    Windows in which something pushes count for little, so that they need not be found before the
    model is fitted.
    """
    space = simulator.space
    measured = simulator.targets(windows)
    width = space.high - space.low
    low, high = (space.lower, space.upper) if beyond else (space.low, space.high)
    value = np.clip(float_array("start", start, (len(space),), "robust_fit"), low, high)
    for _ in range(rounds):
        predicted, slopes = simulator.linearize(value, windows, step=1e-3 * width)
        errors = measured - predicted
        scale = np.maximum(deviation(errors), 1e-300)
        white = slopes * width / scale[:, None]
        rest = errors / scale
        weights = (DEGREES + 1) / (DEGREES + np.mean(rest**2, axis=1))
        information = np.einsum("w,wpd,wpe->de", weights, white, white)
        scores = weights[:, None] * np.einsum("wpd,wp->wd", white, rest)
        inverse = np.linalg.inv(information + PRIOR * np.eye(len(space)))
        new = np.clip(
            value + width * np.clip(inverse @ scores.sum(axis=0), -LONGEST, LONGEST), low, high
        )
        moved = np.max(np.abs(new - value) / width)
        value = new
        if moved < SETTLED:
            break
    return RobustFit(value, information, inverse, scores)
