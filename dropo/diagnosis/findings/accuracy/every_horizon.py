"""What is said of a model after every horizon that is printed: whether an effect makes errors
larger, and whether noise explains those that are left.

Errors are compared by their squares, a signal's by no more than the square of its spread: beyond it
the motion is lost, and by how much says nothing. A simulation that failed has lost it too.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dropo.core.numerics.tails import normal_tail, student_quantile
from dropo.core.records.trajectories import Ints
from dropo.core.services.tables import number, steps_text
from dropo.core.services.validation import Array
from dropo.diagnosis.findings.accuracy.horizons import OF_MOTION, AfterHorizon


@dataclass(frozen=True)
class EveryHorizonSettings:
    """When errors are larger than others, or than noise explains.

    Attributes
    ----------
    z : float
        Standard errors over runs, or parts of them, by which squares of errors must differ; by
        Student's t with their number, at the level of a normal one ...
    worse : float
        ... and the part by which the root mean square must be larger than without an effect, and
        than noise explains; ...
    estimated : float
        ... without an effect where signals were estimated, whose errors are not those of sensors.
    misfit : float
        The part by which it must be larger than noise explains.
    few : int
        Runs or parts below which their spread says little: the root mean square must then be ...
    times : float
        ... so many times as large.
    refused : int
        Effects at most that are taken out of the model, one after another, since errors are larger
        with them.
    draws : int
        Draws of the numbers fitted, from which it is computed what their errors make.
    """

    z: float = 3.0
    worse: float = 0.03
    estimated: float = 1.0
    misfit: float = 0.25
    few: int = 5
    times: float = 2.0
    refused: int = 6
    draws: int = 4


SETTINGS = EveryHorizonSettings()


@dataclass(frozen=True)
class Beyond:
    """Errors after a horizon that are larger than others.

    Attributes
    ----------
    steps : int
        The horizon in control steps.
    unit : str
        Of the signals, or `OF_MOTION`.
    ratio : float
        How many times as large their root mean square is.
    score : float
        The difference of squares in units of what counts as one.
    """

    steps: int
    unit: str
    ratio: float
    score: float


def worse_after(
    found: Sequence[AfterHorizon],
    without: int,
    model: int,
    settings: EveryHorizonSettings = SETTINGS,
    *,
    measured: NDArray[np.bool_] | None = None,
) -> Beyond | None:
    """Say after which horizon a model's errors are larger than those of another.

    Parameters
    ----------
    found : sequence of AfterHorizon
        Every horizon.
    without, model : int
        Which of the models; that without an effect, and that with it.
    settings : EveryHorizonSettings
        When they are larger.
    measured : (p,) bool array, optional
        Which signals count; all if None.

    Returns
    -------
    Beyond or None
        Where it stands out most.
    """
    largest: list[Beyond] = []
    for after in _of_signals(found, measured):
        limits = {unit: value for unit, _, value in _lines(after, after.by_noise)}
        before = _lines(after, after.errors[[without]])
        for (unit, old, size), (_, new, _) in zip(
            before, _lines(after, after.errors[[model]]), strict=True
        ):
            limit = max(size, limits[unit])
            beyond = _beyond(new - old, new, limit, after.block, settings.worse, settings)
            if beyond is not None:
                ratio = float(np.sqrt(new.mean() / max(old.mean(), 1e-300)))
                largest.append(Beyond(after.steps, unit, ratio, beyond))
    return max(largest, key=lambda one: one.score, default=None)


def beyond_noise(
    found: Sequence[AfterHorizon],
    model: int,
    usual: int | None = None,
    settings: EveryHorizonSettings = SETTINGS,
    *,
    measured: NDArray[np.bool_] | None = None,
) -> tuple[Beyond, ...]:
    """Say after which horizons a model's errors are larger than noise explains.

    Parameters
    ----------
    found : sequence of AfterHorizon
        Every horizon.
    model : int
        Which of the models: the one that the noise was drawn with.
    usual : int, optional
        A horizon [control steps] whose errors count as those of the noise, however large they are;
        where the noise that was drawn is not all that there is.
    settings : EveryHorizonSettings
        When they are larger.
    measured : (p,) bool array, optional
        Which signals count; all if None.

    Returns
    -------
    tuple of Beyond
        One for each horizon where they are, of the unit that stands out most.
    """
    found = _of_signals(found, measured)
    larger = {}
    for after in found:
        if after.steps == usual:
            larger = {
                unit: max(1.0, size / max(noise, 1e-300))
                for (unit, _, size), (_, _, noise) in zip(
                    _lines(after, after.errors[[model]]),
                    _lines(after, after.by_noise),
                    strict=True,
                )
            }
    worst = []
    for after in found:
        of_horizon = []
        for (unit, own, _), (_, noise, size) in zip(
            _lines(after, after.errors[[model]]), _lines(after, after.by_noise), strict=True
        ):
            times = larger.get(unit, 1.0) ** 2
            limit = size * np.sqrt(times)
            beyond = _beyond(
                own - times * noise, own, limit, after.block, settings.misfit, settings
            )
            if beyond is not None:
                ratio = float(np.sqrt(own.mean() / max(noise.mean(), 1e-300)))
                of_horizon.append(Beyond(after.steps, unit, ratio, beyond))
        if of_horizon:
            worst.append(max(of_horizon, key=lambda one: one.score))
    return tuple(worst)


def _of_signals(
    found: Sequence[AfterHorizon], counted: NDArray[np.bool_] | None
) -> Sequence[AfterHorizon]:
    """Every horizon, with the signals that count (p,) alone; all if None."""
    if counted is None:
        return found
    return [replace(after, spread=np.where(counted, after.spread, 0.0)) for after in found]


def in_words(found: Sequence[Beyond]) -> str:
    """Write where errors are beyond noise.

    Parameters
    ----------
    found : sequence of Beyond
        What is beyond the noise.

    Returns
    -------
    str
        Such as "errors after 20 and 100 steps, up to 3 times ...".
    """
    steps = [str(one.steps) for one in found]
    *but_last, last = steps
    after = f"{', '.join(but_last)} and {last} steps" if but_last else steps_text(found[0].steps)
    worst = max(found, key=lambda one: one.ratio)
    up_to = "up to " if but_last else ""
    times = f"{up_to}{number(worst.ratio, 2)} times what noise explains"
    return f"errors after {after}, {times} ({worst.unit})"


def _lines(after: AfterHorizon, errors: Array) -> Iterator[tuple[str, Array, float]]:
    """For all signals together, then for those of each unit: squares (W,), and their root mean.

    errors: (D, W, p), of which the mean over D is taken.
    """
    varies = after.spread > 0
    finite = np.where(np.isfinite(errors), np.abs(errors), np.inf)
    squares = np.mean(np.minimum(finite, after.spread) ** 2, axis=0)
    if not varies.any():
        return
    of_motion = np.mean(squares[:, varies] / after.spread[varies] ** 2, axis=1)
    yield OF_MOTION, of_motion, float(np.sqrt(of_motion.mean()))
    units = [signal.unit or "-" for signal in after.signals]
    for unit in dict.fromkeys(units):
        own = varies & np.array([other == unit for other in units])
        if own.any():
            of_unit = np.mean(squares[:, own], axis=1)
            yield unit, of_unit, float(np.sqrt(of_unit.mean()))


def _beyond(
    difference: Array,
    squares: Array,
    limit: float,
    block: Ints,
    part: float,
    settings: EveryHorizonSettings,
) -> float | None:
    """How far a mean difference of squares (W,) is beyond what counts as one; None if it is not.

    squares: (W,) of the model; limit: root mean square that these must exceed by a part.
    """
    size = float(np.sqrt(squares.mean()))
    mean = float(difference.mean())
    if not (mean > 0 and size > (1 + part) * limit):
        return None
    count = int(block.max()) + 1
    if count < settings.few:
        ratio = size / max(limit, 1e-300)
        return ratio / settings.times if ratio > settings.times else None
    sums = np.bincount(block, weights=difference - mean, minlength=count)
    error = float(np.sqrt(count / (count - 1) * np.sum(sums**2))) / len(block)
    needed = float(student_quantile(1 - normal_tail(settings.z), count - 1)) * error
    return mean / max(needed, 1e-300) if mean > needed else None
