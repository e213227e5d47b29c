"""Errors by horizon on data held out, and what part of them the sensors' noise explains."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from dropo.core.contracts.problem import Problem
from dropo.core.contracts.simulator import Simulator
from dropo.core.records.trajectories import Ints, Signal
from dropo.core.services.validation import Array
from dropo.diagnosis.search.linearization import Library, LinearizedWindows
from dropo.diagnosis.search.trials import State
from dropo.evaluation.held_out import (
    OF_DIAGNOSIS,
    DataPart,
    HeldOutSettings,
    HorizonErrors,
    errors_of,
    held_out_part,
    held_out_starts,
    held_out_windows,
    noise_free_spread,
    rms_by_unit,
    rms_of_motion,
)

LOST = 2.0
"""Multiple of a signal's spread that an error counts at most: beyond it the motion is lost."""
OF_MOTION = "of the motion"
"""The line of all signals together, each in units of its spread."""


@dataclass(frozen=True)
class DrawnNumberSettings:
    """Which fitted numbers' errors are counted as errors that noise makes.

    Attributes
    ----------
    identifiable : float
        Largest standard error of a direction of the numbers, as a fraction of their intervals, at
        which the data identify it.
    """

    identifiable: float = 0.1


DRAWN = DrawnNumberSettings()


@dataclass(frozen=True, eq=False)
class Horizon:
    """Errors of one model after a horizon, beside what the sensors' noise alone would give.

    Attributes
    ----------
    steps : int
        The horizon in control steps.
    seconds : float or None
        The horizon [s]; None where the simulator does not know its control step.
    rmse : float
        Root mean square error of all signals, each in units of its noise-free spread; NaN where the
        simulation diverges in every window, as all its errors are then.
    noise : float
        The part of `rmse` that noise explains.
    units : dict of str to tuple
        For each unit the root mean square error over its signals, and the noise's part.
    by_signal : (p,) array
        Root mean square error of each signal, in its unit.
    capped_by_signal : (p,) array
        The same where an error counts as `LOST` times its signal's spread at most, and so does a
        simulation that failed.
    capped : dict of str to float
        Likewise for each unit; under `OF_MOTION` that of all signals, each in units of its spread.
    lost : float
        The fraction of the errors that are larger than that.
    """

    steps: int
    seconds: float | None
    rmse: float
    noise: float
    units: dict[str, tuple[float, float]]
    by_signal: Array
    capped_by_signal: Array
    capped: dict[str, float]
    lost: float

    def to_json(self) -> dict[str, Any]:
        """Return plain numbers.

        Returns
        -------
        dict
            None of an error where the simulation diverges.
        """
        units = {
            unit: {"rmse": _or_none(off), "noise": noise}
            for unit, (off, noise) in self.units.items()
        }
        return {
            "steps": self.steps,
            "seconds": self.seconds,
            "rmse": _or_none(self.rmse),
            "noise": self.noise,
            "units": units,
            "lost": self.lost,
        }


def _or_none(error: float) -> float | None:
    """The error, or None where there is none."""
    return error if np.isfinite(error) else None


@dataclass(frozen=True, eq=False)
class AfterHorizon:
    """Errors of K models in the W windows of one horizon, and what noise would make of them.

    Attributes
    ----------
    steps : int
        The horizon in control steps.
    signals : tuple of Signal
        The p compared signals.
    models : tuple of Horizon
        What is printed of each model.
    errors : (K, W, p) array
        Measured less predicted, in the signals' units; NaN where a simulation failed.
    by_noise : (D, W, p) array
        Errors of the last state's model in D draws of the noise, were it the truth; NaN likewise.
    spread : (p,) array
        Of each signal without its noise; 0 where it does not vary.
    block : (W,) int array
        The run, or part of a run, that a window belongs to. Windows that overlap share one.
    """

    steps: int
    signals: tuple[Signal, ...]
    models: tuple[Horizon, ...]
    errors: Array
    by_noise: Array
    spread: Array
    block: Ints


def horizons(
    problem: Problem,
    library: Library,
    thetas: Sequence[Array],
    last: State,
    rng: np.random.Generator,
    settings: HeldOutSettings = OF_DIAGNOSIS,
    draws: int = 2,
) -> list[list[Horizon]]:
    """Return the errors of several models by horizon.

    Parameters
    ----------
    problem, library, thetas, last, rng, settings, draws
        As of `after_horizons`.

    Returns
    -------
    list of list of Horizon
        For each model, one of each horizon.
    """
    found = after_horizons(problem, library, thetas, last, rng, settings, draws)
    return [[after.models[i] for after in found] for i in range(len(thetas))]


def after_horizons(
    problem: Problem,
    library: Library,
    thetas: Sequence[Array],
    last: State,
    rng: np.random.Generator,
    settings: HeldOutSettings = OF_DIAGNOSIS,
    draws: int = 2,
) -> list[AfterHorizon]:
    """Predict data held out by several models, over every horizon.

    Parameters
    ----------
    problem : Problem
        Whose held-out part is predicted.
    library : Library
        The simulator with every effect.
    thetas : sequence of array
        The models: (m,) each.
    last : State
        Its noise is taken: starts are drawn anew under it, so that it is known at impacts too.
    rng : numpy.random.Generator
        Draws the noise of the starts, and a child of it that of the ends.
    settings : HeldOutSettings
        Which horizons, beside that of the windows, and which windows.
    draws : int
        Draws of each window's start, from which the noise's part is computed.

    Returns
    -------
    list of AfterHorizon
        The horizons for which the data held out are long enough, up to the first after which the
        last state's model has failed in every window.
    """
    found: list[AfterHorizon] = []
    (ends,) = rng.spawn(1)
    models = [*thetas, last.theta]
    # With nothing found, or nothing fitted, some models are the same.
    different, which = np.unique(np.stack(models), axis=0, return_inverse=True)
    which = which.ravel()
    simulator = library.simulator
    sigma = signal_noise(problem, last)
    rho = last.train.whiten.noise.rho
    part, spread = _part_and_spread(problem, library, last)
    for steps in sorted({*settings.horizons, last.train.windows.length}):
        starts = held_out_starts(part, steps, settings)
        if len(starts) < settings.fewest:
            break
        windows = part.trajectories.from_rows(starts, steps)
        predicted = simulator.predict(different, windows)
        offsets = sigma * rng.standard_normal((draws, len(windows), len(sigma)))
        same = np.repeat(last.theta[None], draws, axis=0)
        change = simulator.predict(same, windows, offsets=offsets) - predicted[which[-1]]
        good = np.isfinite(change).all(axis=2)
        # Where a sensor's errors follow each other, some of the start's is still there.
        there = rho**steps * offsets[good] - change[good]
        noise = (1 - rho ** (2 * steps)) * sigma**2 + np.mean(there**2, axis=0)
        errors = errors_of(simulator, predicted, windows, spread)
        if errors[which[-1]].failed == errors[which[-1]].rows:
            break
        # Starts of a late signal are off by more than noise.
        extra_sd = simulator.extra_start_sd(last.theta, windows)
        if extra_sd.any():
            further = offsets + extra_sd * ends.standard_normal(offsets.shape)
            change = simulator.predict(same, windows, offsets=further) - predicted[which[-1]]
        anew = np.sqrt(1 - rho ** (2 * steps)) * sigma * ends.standard_normal(offsets.shape)
        off = simulator.targets(windows) - predicted
        of_each = [
            _horizon(simulator, of_model, noise, rows)
            for of_model, rows in zip(errors, off, strict=True)
        ]
        after = AfterHorizon(
            steps=steps,
            signals=tuple(simulator.signals),
            models=tuple(of_each[i] for i in which[:-1].tolist()),
            errors=off[which[:-1]],
            by_noise=rho**steps * offsets + anew - change,
            spread=spread,
            block=apart(part.block[starts], starts, steps),
        )
        found.append(after)
    return found


def with_numbers(
    problem: Problem,
    library: Library,
    last: State,
    covariance: Array,
    found: Sequence[AfterHorizon],
    rng: np.random.Generator,
    draws: int,
    settings: HeldOutSettings = OF_DIAGNOSIS,
    drawn: DrawnNumberSettings = DRAWN,
) -> list[AfterHorizon]:
    """Add to what noise makes of errors what it makes of the numbers that were fitted.

    Parameters
    ----------
    problem, library, last, settings
        As of `after_horizons`.
    covariance : (f, f) array
        Of the numbers that are free in the last state.
    found : sequence of AfterHorizon
        What `after_horizons` found.
    rng : numpy.random.Generator
        Draws the numbers.
    draws : int
        How many models are drawn.
    drawn : DrawnNumberSettings
        Which numbers vary.

    Returns
    -------
    list of AfterHorizon
        Each with `draws` draws: one of the noise as it has it, in turn, with one of the numbers.
    """
    (own,) = rng.spawn(1)
    space = library.simulator.space
    thetas = np.repeat(last.theta[None], draws + 1, axis=0)
    # A direction that is not identifiable is no error that noise makes of the numbers.
    width = (space.high - space.low)[last.free]
    values, vectors = np.linalg.eigh(covariance / np.outer(width, width))
    sizes = np.sqrt(np.maximum(values, 0.0))
    root = width[:, None] * vectors * np.where(sizes < drawn.identifiable, sizes, 0.0)
    thetas[1:, last.free] += own.standard_normal((draws, len(values))) @ root.T
    thetas[1:] = space.clip(thetas[1:])
    part, _ = _part_and_spread(problem, library, last)
    more = []
    for after in found:
        windows = held_out_windows(part, after.steps, settings)
        predicted = library.simulator.predict(thetas, windows)
        which = np.arange(draws) % len(after.by_noise)
        by_noise = after.by_noise[which] + predicted[0] - predicted[1:]
        more.append(replace(after, by_noise=by_noise))
    return more


def apart(block: Ints, starts: Ints, steps: int, fewest: int = 8, pieces: int = 24) -> Ints:
    """Number the windows' blocks, or where they are few pieces of them that hardly overlap.

    Parameters
    ----------
    block : (W,) int array
        The run or block of time of each window.
    starts : (W,) int array
        Their first rows, ascending.
    steps : int
        Their length.
    fewest : int
        Blocks below which they are cut into pieces ...
    pieces : int
        ... of which there are then about so many at most, each as long as a window at least.

    Returns
    -------
    (W,) int array
        From 0 on.
    """
    names, which = np.unique(block, return_inverse=True)
    if len(names) >= fewest:
        return which.astype(np.int64)
    out = np.zeros(len(block), dtype=np.int64)
    first = 0
    for i in range(len(names)):
        own = which == i
        row = starts[own] - starts[own][0]
        count = max(1, min(pieces // len(names), int(row[-1]) // steps))
        out[own] = first + np.minimum(row * count // max(int(row[-1]), 1), count - 1)
        first += count
    return out


def errors_after(
    problem: Problem, library: Library, thetas: Sequence[Array], last: State
) -> list[HorizonErrors]:
    """Return the errors of several models after the horizon of the last state's windows.

    Parameters
    ----------
    problem, library, thetas, last
        As of `horizons`, which gives the same numbers at this horizon.

    Returns
    -------
    list of HorizonErrors
        One of each model.
    """
    part, spread = _part_and_spread(problem, library, last)
    windows = held_out_windows(part, last.train.windows.length, OF_DIAGNOSIS)
    predicted = library.simulator.predict(np.stack(thetas), windows)
    return errors_of(library.simulator, predicted, windows, spread)


def _part_and_spread(problem: Problem, library: Library, last: State) -> tuple[DataPart, Array]:
    """The data that are held out, and the spread (p,) of their signals without the noise."""
    part = held_out_part(problem, last.train.windows.length)
    return part, noise_free_spread(library.simulator, part, signal_noise(problem, last) ** 2)


def signal_noise(problem: Problem, last: State) -> Array:
    """Return the standard deviations (p,) of the signals' noise, as the last state has them.

    Of signals that were estimated, those of their errors: as they are stated, or as large as the
    windows find those of their starts. A smoother bends where a command steps, of which the spread
    of its measurements knows nothing.

    Parameters
    ----------
    problem : Problem
        Whose data are diagnosed.
    last : State
        Of the search.
    """
    signals = problem.simulator.signals
    stated = [problem.estimated.get(signal.name, np.inf) for signal in signals]
    found = np.concatenate([_start_errors(side) for side in (last.train, last.test)])
    size = np.sqrt(np.mean(found**2, axis=0))
    return np.minimum(last.train.whiten.sigma, np.maximum(stated, size))


def _start_errors(side: LinearizedWindows) -> Array:
    """How far (W, p) the measured starts of the windows that are not lost are off."""
    errors = side.whiten.latent(side.residuals)[:, : len(side.whiten.sigma)]
    if side.windows.moved is not None:
        errors = errors + side.windows.moved
    return np.asarray(errors[~side.lost])


def _horizon(simulator: Simulator, errors: HorizonErrors, noise: Array, rows: Array) -> Horizon:
    """The errors, and those of each row (W, p), beside the noise's (p,) variance."""
    step = simulator.control_step
    by_noise = rms_by_unit(errors.signals, noise)
    there = np.nan if errors.failed == errors.rows else 1.0
    # A signal that does not vary has no motion to lose.
    varies = errors.spread > 0
    most = np.where(varies, LOST * errors.spread, np.inf)
    sizes = np.where(np.isfinite(rows), np.abs(rows), np.where(varies, np.inf, 0.0))
    squares = np.mean(np.minimum(sizes, most) ** 2, axis=0)
    return Horizon(
        steps=errors.horizon,
        seconds=None if step is None else errors.horizon * step,
        rmse=there * errors.overall,
        noise=rms_of_motion(noise, errors.spread),
        units={unit: (there * off, by_noise[unit]) for unit, off in errors.by_unit.items()},
        by_signal=there * errors.by_signal,
        capped_by_signal=np.sqrt(squares),
        capped=rms_by_unit(errors.signals, squares)
        | {OF_MOTION: rms_of_motion(squares, errors.spread)},
        lost=float(np.mean(sizes[:, varies] > most[varies])) if varies.any() else 0.0,
    )
