"""Errors by horizon on data held out, and what part of them the sensors' noise explains."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from dropo.core.contracts.problem import Problem
from dropo.core.contracts.simulator import Simulator
from dropo.core.services.validation import Array
from dropo.diagnosis.search.linearization import Library
from dropo.diagnosis.search.trials import State
from dropo.evaluation.held_out import (
    SETTINGS,
    DataPart,
    HeldOutSettings,
    HorizonErrors,
    errors_of,
    held_out_part,
    held_out_windows,
    noise_free_spread,
    rms_by_unit,
    rms_of_motion,
)


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
    """

    steps: int
    seconds: float | None
    rmse: float
    noise: float
    units: dict[str, tuple[float, float]]
    by_signal: Array

    def to_json(self) -> dict[str, Any]:
        """Return plain numbers; None of an error where the simulation diverges."""
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
        }


def _or_none(error: float) -> float | None:
    """The error, or None where there is none."""
    return error if np.isfinite(error) else None


def horizons(
    problem: Problem,
    library: Library,
    thetas: Sequence[Array],
    last: State,
    rng: np.random.Generator,
    settings: HeldOutSettings = SETTINGS,
    draws: int = 2,
) -> list[list[Horizon]]:
    """Return the errors of several models by horizon.

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
        Draws the noise of the starts.
    settings : HeldOutSettings
        Which horizons, beside that of the windows, and which windows.
    draws : int
        Draws of each window's start, from which the noise's part is computed.

    Returns
    -------
    list of list of Horizon
        For each model, the horizons for which the data held out are long enough, up to the first
        after which the last of the models has failed in every window.
    """
    found: list[list[Horizon]] = [[] for _ in thetas]
    models = [*thetas, last.theta]
    # With nothing found, or nothing fitted, some models are the same.
    different, which = np.unique(np.stack(models), axis=0, return_inverse=True)
    which = which.ravel()
    simulator = library.simulator
    sigma = signal_noise(problem, last)
    rho = last.train.whiten.noise.rho
    part, spread = _part_and_spread(problem, library, last)
    for steps in sorted({*settings.horizons, last.train.windows.length}):
        windows = held_out_windows(part, steps, settings)
        if len(windows) < settings.fewest:
            break
        predicted = simulator.predict(different, windows)
        offsets = sigma * rng.standard_normal((draws, len(windows), len(sigma)))
        same = np.repeat(last.theta[None], draws, axis=0)
        change = simulator.predict(same, windows, offsets=offsets) - predicted[which[-1]]
        good = np.isfinite(change).all(axis=2)
        # Where a sensor's errors follow each other, some of the start's is still there.
        together = rho**steps * offsets[good] * change[good]
        noise = sigma**2 + np.mean(change[good] ** 2 - 2 * together, axis=0)
        errors = errors_of(simulator, predicted, windows, spread)
        if errors[which[-1]].failed == errors[which[-1]].rows:
            break
        for out, i in zip(found, which[:-1].tolist(), strict=True):
            out.append(_horizon(simulator, errors[i], noise))
    return found


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
    windows = held_out_windows(part, last.train.windows.length)
    predicted = library.simulator.predict(np.stack(thetas), windows)
    return errors_of(library.simulator, predicted, windows, spread)


def beyond_windows(found: Sequence[Horizon], window: int, times: float = 2.0) -> str | None:
    """Say after which horizon errors are larger than windows and noise lead to expect.

    Parameters
    ----------
    found : sequence of Horizon
        Of the last model.
    window : int
        Control steps in a window, by which the verdict was found.
    times : float
        How many times larger they are than noise explains, beside what they are after a window.

    Returns
    -------
    str or None
        A sentence on the unit where it stands out most; None where it does nowhere.
    """
    own = next((one for one in found if one.steps == window), None)
    if own is None:
        return None
    worst: tuple[float, int, str] | None = None
    for one in found:
        for unit, (error, noise) in one.units.items():
            off, expected = own.units[unit]
            ratio = error / max(noise, 1e-300)
            usual = max(off / max(expected, 1e-300), 1.0)
            if one.steps > window and ratio > times * usual and ratio > (worst or (0.0,))[0]:
                worst = (ratio, one.steps, unit)
    if worst is None:
        return None
    ratio, steps, unit = worst
    return (
        f"after {steps} steps errors are {ratio:.2g} times what noise explains ({unit}), and the "
        f"verdict is that of windows of {window}: diagnose with --steps {steps}"
    )


def _part_and_spread(problem: Problem, library: Library, last: State) -> tuple[DataPart, Array]:
    """The data that are held out, and the spread (p,) of their signals without the noise."""
    part = held_out_part(problem, last.train.windows.length)
    return part, noise_free_spread(library.simulator, part, signal_noise(problem, last) ** 2)


def signal_noise(problem: Problem, last: State) -> Array:
    """Return the standard deviations (p,) of the signals' noise, as the last state has them.

    Of signals that were estimated, those of their errors: the windows know nothing of them.

    Parameters
    ----------
    problem : Problem
        Whose data are diagnosed.
    last : State
        Of the search.
    """
    signals = problem.simulator.signals
    stated = [problem.estimated.get(signal.name, np.inf) for signal in signals]
    return np.minimum(last.train.whiten.sigma, stated)


def _horizon(simulator: Simulator, errors: HorizonErrors, noise: Array) -> Horizon:
    """The errors beside the noise's (p,) variance at this horizon."""
    step = simulator.control_step
    by_noise = rms_by_unit(errors.signals, noise)
    there = np.nan if errors.failed == errors.rows else 1.0
    return Horizon(
        steps=errors.horizon,
        seconds=None if step is None else errors.horizon * step,
        rmse=there * errors.overall,
        noise=rms_of_motion(noise, errors.spread),
        units={unit: (there * off, by_noise[unit]) for unit, off in errors.by_unit.items()},
        by_signal=there * errors.by_signal,
    )
