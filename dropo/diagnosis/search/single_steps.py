"""Whether an effect shows in single steps too, as a true cause does.

In a closed loop the commands answer to random forces. Over a window of several steps the forces of
its beginning and the commands of its end belong together, so that an effect of the commands may
seem to explain what chance did (the bias of open-loop prediction errors under feedback; Forssell
and Ljung 1999). A single step's command was given before the step's force: there is no such effect
in it. The two estimates of the size are compared (Hausman 1978).
"""

from collections.abc import Sequence

import numpy as np

from dropo.core.contracts.effect import EffectInstance
from dropo.core.services.validation import Array
from dropo.diagnosis.search.invariance import response_of
from dropo.diagnosis.search.linearization import (
    Library,
    LinearizedWindows,
    linearize,
    shift_linearization,
    estimate_noise,
)
from dropo.diagnosis.search.windows import Windows

# standard errors from the full size, and no more from nothing, at which an effect is not there
CLEAR = 3.0
ROUNDS = 10  # of weighting by what is left
MOST = 240  # single steps of each look, evenly spread


def absent_in_single_steps(
    library: Library, looks: Sequence[LinearizedWindows], instance: EffectInstance, floor: Array
) -> bool:
    """Whether single steps say, against the windows of the looks, that the effect is not there."""
    windows = looks[0].windows
    if windows.length == 1 or not np.diff(windows.segments.actions.ravel()).any():
        return False
    share, error = magnitude_in_single_steps(library, looks, instance, floor)
    return error > 0 and share < CLEAR * error and share < 1 - CLEAR * error


def magnitude_in_single_steps(
    library: Library, looks: Sequence[LinearizedWindows], instance: EffectInstance, floor: Array
) -> tuple[float, float]:
    """The effect's size in single steps as a share of the one that it has, by reweighted least
    squares, and its standard error, by window.
    """
    singles = [_single(library, linearized, floor) for linearized in looks]
    slopes = [response_of(library, single, instance) for single in singles]
    more = 0.0
    for _ in range(ROUNDS):
        parts = [
            _by_window(single, slope, more) for single, slope in zip(singles, slopes, strict=True)
        ]
        score, weight = (np.concatenate(part) for part in zip(*parts, strict=True))
        if not weight.sum() > 0:
            return 1.0, 0.0
        more += float(score.sum() / weight.sum())
    return 1 + more, float(np.sqrt((score**2).sum()) / weight.sum())


def _single(library: Library, linearized: LinearizedWindows, floor: Array) -> LinearizedWindows:
    """Steps of the windows by themselves, under the noise that they have."""
    begun = linearize(library, _apart(library, linearized.windows), linearized.theta, linearized.whiten.sigma)
    return shift_linearization(library, begun, linearized.theta, estimate_noise(begun, begun.whiten.sigma, floor))


def _by_window(single: LinearizedWindows, slope: Array, more: float) -> tuple[Array, Array]:
    """(W,) the score of so much more of the size than there is, and its weight."""
    rest = single.residuals - more * slope
    counts = single.whiten.weights(rest) * ~single.lost
    left = single.whiten(rest)
    along = single.whiten(slope)
    score, weight = (
        np.bincount(single.windows.block, counts * (along * part).sum(axis=1))
        for part in (left, along)
    )
    return np.asarray(score, dtype=float), np.asarray(weight, dtype=float)


def _apart(library: Library, windows: Windows) -> Windows:
    """Steps of the windows as windows of their own; the block is the window that a step is of."""
    old = windows.segments
    n = len(windows) * windows.length
    chosen = np.unique(np.linspace(0, n - 1, min(n, MOST)).round().astype(np.int64))
    segments = old.trajectories.from_rows(old.steps.ravel()[chosen], every_step=True)
    return Windows(
        segments,
        library.simulator.targets(segments).reshape(len(chosen), -1),
        chosen // windows.length,
        1,
    )
