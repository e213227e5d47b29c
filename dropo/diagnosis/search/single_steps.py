"""Whether an effect shows in single steps too, as a true cause does.

In a closed loop the commands respond to random forces. Over a window of several steps, the forces
at its beginning and the commands at its end are correlated, so that an effect of the commands may
seem to explain what was chance (the bias of open-loop prediction errors under feedback [1]_). A
single step's command was given before the step's force: there is no such effect in it. The two
estimates of the magnitude are compared [2]_.

References
----------
.. [1] Forssell and Ljung, Closed-loop identification revisited, Automatica 35, 1999.
.. [2] Hausman, Specification tests in econometrics, Econometrica 46, 1978.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dropo.core.contracts.effect import EffectInstance
from dropo.core.services.validation import Array
from dropo.diagnosis.search.invariance import response_of
from dropo.diagnosis.search.linearization import (
    Library,
    LinearizedWindows,
    estimate_noise,
    linearize,
    with_other_noise,
)
from dropo.diagnosis.search.whitening import Whitener
from dropo.diagnosis.search.windows import Windows


@dataclass(frozen=True)
class SingleStepSettings:
    """How single steps are compared with windows.

    Attributes
    ----------
    z : float
        Standard errors that the estimate from single steps must be below the full magnitude, and
        may be above 0 at most, for the effect to be absent.
    rounds : int
        Reweighted least squares are repeated so often.
    maximum : int
        Single steps of each side that are simulated, evenly spread.
    """

    z: float = 3.0
    rounds: int = 10
    maximum: int = 240


SETTINGS = SingleStepSettings()


def absent_in_single_steps(
    library: Library,
    sides: Sequence[LinearizedWindows],
    instance: EffectInstance,
    floor: Array,
    settings: SingleStepSettings = SETTINGS,
) -> bool:
    """Decide whether single steps, against the windows, say that an effect is not there.

    Parameters
    ----------
    library : Library
        The simulator with every effect.
    sides : sequence of LinearizedWindows
        Windows under the model with the effect.
    instance : EffectInstance
        The effect.
    floor : (p,) array
        Lower bound of the noise.
    settings : SingleStepSettings
        How sure that must be.

    Returns
    -------
    bool
        False where the windows are single steps themselves, no command changes, or signals were
        estimated: a step from one estimate to the next has the errors of both in common, and what
        is measured tells nothing of so short a time.
    """
    windows = sides[0].windows
    is_short = windows.length == 1 or windows.start_sd is not None
    if is_short or not np.diff(windows.segments.actions.ravel()).any():
        return False
    # The windows' first steps are single steps too, and linearized already: mostly they are enough.
    firsts = [_with_own_noise(library, _first_steps(side), floor) for side in sides]
    fraction, error = _magnitude(library, firsts, instance, settings)
    if error > 0 and fraction > settings.z * error:
        return False
    fraction, error = magnitude_in_single_steps(library, sides, instance, floor, settings)
    nothing = fraction < settings.z * error
    not_full = fraction < 1 - settings.z * error
    return error > 0 and nothing and not_full


def magnitude_in_single_steps(
    library: Library,
    sides: Sequence[LinearizedWindows],
    instance: EffectInstance,
    floor: Array,
    settings: SingleStepSettings = SETTINGS,
) -> tuple[float, float]:
    """Estimate an effect's magnitude from single steps, by reweighted least squares.

    Parameters
    ----------
    library, sides, instance, floor, settings
        As of `absent_in_single_steps`.

    Returns
    -------
    fraction : float
        The magnitude, as a fraction of the one that was fitted to windows.
    error : float
        Its standard error, clustered by window; 0 where the steps do not respond.
    """
    singles = []
    for side in sides:
        apart = _cut_apart(library, side.windows, settings.maximum)
        single = linearize(library, apart, side.theta, side.whiten.noise)
        singles.append(_with_own_noise(library, single, floor))
    return _magnitude(library, singles, instance, settings)


def _magnitude(
    library: Library,
    singles: Sequence[LinearizedWindows],
    instance: EffectInstance,
    settings: SingleStepSettings,
) -> tuple[float, float]:
    """The fraction of an effect's magnitude in some single steps, and its standard error."""
    responses = [response_of(library, single, instance) for single in singles]
    change = 0.0
    score = np.zeros(0)
    weight = np.zeros(0)
    for _ in range(settings.rounds):
        scores = []
        weights = []
        for single, response in zip(singles, responses, strict=True):
            own_score, own_weight = _by_window(single, response, change)
            scores.append(own_score)
            weights.append(own_weight)
        score = np.concatenate(scores)
        weight = np.concatenate(weights)
        if not weight.sum() > 0:
            return 1.0, 0.0
        change += float(score.sum() / weight.sum())
    return 1 + change, float(np.sqrt((score**2).sum()) / weight.sum())


def _with_own_noise(
    library: Library, singles: LinearizedWindows, floor: Array
) -> LinearizedWindows:
    """Single steps under the noise that they have."""
    noise = estimate_noise(singles, singles.whiten.noise, floor)
    return with_other_noise(library, singles, noise)


def _first_steps(linearized: LinearizedWindows) -> LinearizedWindows:
    """The first steps of windows, as windows of their own."""
    windows = linearized.windows
    noise = linearized.whiten.noise
    p = len(noise.sigma)
    old = windows.segments
    segments = old.trajectories.from_rows(old.steps[:, 0], every_step=True)
    block = np.arange(len(windows))
    first = Windows(segments, windows.measured[:, :p], block, 1, windows.start_sd)
    # Of the lengths of steps, the first alone matters.
    loadings = linearized.whiten.loadings[:, :p]
    kept = np.ones(loadings.shape[2], dtype=bool)
    kept[2 * p + 1 : 2 * p + linearized.clocks] = False
    return replace(
        linearized,
        windows=first,
        residuals=linearized.residuals[:, :p],
        shift=linearized.shift[:, :p],
        defect=None if linearized.defect is None else linearized.defect[:, :p],
        whiten=Whitener(loadings[:, :, kept], linearized.whiten.scale[kept], noise, first.counted),
        shifted=True,
    )


def _by_window(single: LinearizedWindows, response: Array, change: float) -> tuple[Array, Array]:
    """(W,) the score of the magnitude changed by a fraction, and its weight, in each window."""
    residuals = single.residuals - change * response
    weights = single.whiten.weights(residuals) * ~single.lost
    left = single.whiten(residuals)
    along = single.whiten(response)
    block = single.windows.block
    score = np.bincount(block, weights * (along * left).sum(axis=1))
    weight = np.bincount(block, weights * (along * along).sum(axis=1))
    return np.asarray(score, dtype=float), np.asarray(weight, dtype=float)


def _cut_apart(library: Library, windows: Windows, maximum: int) -> Windows:
    """Steps of the windows as windows of their own; their block is the window they are from."""
    old = windows.segments
    count = len(windows) * windows.length
    chosen = np.linspace(0, count - 1, min(count, maximum)).round().astype(np.int64)
    chosen = np.unique(chosen)
    segments = old.trajectories.from_rows(old.steps.ravel()[chosen], every_step=True)
    measured = library.simulator.targets(segments).reshape(len(chosen), -1)
    return Windows(segments, measured, chosen // windows.length, 1, windows.start_sd)
