"""The noise of a fit: its variance by a sweep, the scale from which that is learned, its tails."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from dropo.core.contracts.estimator import Progress, Run
from dropo.core.contracts.problem import Problem
from dropo.core.numerics.diverged_simulations import flat
from dropo.core.numerics.robust_statistics import student_t_log_density, student_t_weights
from dropo.core.records.fits.fit import Fit, Status
from dropo.core.records.fits.fit_choices import NoiseTrial, NoiseTuning
from dropo.core.services.validation import Array
from dropo.estimators.support.point_estimate import estimate, misfit


@dataclass(frozen=True)
class EpsilonSettings:
    """What limits the variances of the noise.

    Attributes
    ----------
    lowest : float
        Least variance that residuals can give, as a fraction of the signal's variance.
    accepted : float
        A sweep without a threshold accepts this multiple of its least mean squared error.
    rounding : float
        A sweep accepts errors that are larger by this fraction of the variance of all targets, so
        that those which differ by rounding alone are all accepted.
    """

    lowest: float = 1e-8
    accepted: float = 1.1
    rounding: float = 1e-10


DEFAULTS = EpsilonSettings()


@dataclass(frozen=True)
class TailSettings:
    """When residuals have longer tails than a Gaussian's.

    Attributes
    ----------
    degrees : tuple of float
        Degrees of freedom of a Student t that are tried.
    gain : float
        One is taken that raises the log-likelihood of the whitened residuals by more than this
        [nats]; in Gaussian ones, it is exceeded once in 400 times.
    fewest : int
        Rows below which nothing is said.
    rounding : float
        Signals whose noise is below this fraction of the one it was learned from say nothing: what
        is left of them is rounding.
    least : float
        Least scale of a Student t over the Gaussian's: a smaller one is that of rows that fit
        exactly.
    scalings : int
        Passes in which the scale of each Student t is found.
    """

    degrees: tuple[float, ...] = (2.1, 2.5, 3.0, 4.0, 6.0, 10.0, 20.0)
    gain: float = 4.0
    fewest: int = 60
    rounding: float = 1e-6
    least: float = 0.02
    scalings: int = 30


TAILS = TailSettings()


def tail_degrees(
    residual: Array,
    covariance: Array,
    evident: NDArray[np.bool_],
    settings: TailSettings = TAILS,
) -> float | None:
    """Find the degrees of freedom of the Student t that residuals follow, where they have tails.

    Parameters
    ----------
    residual : (R, p) array
        Measured less predicted.
    covariance : (R, p, p) array
        That a Gaussian fit says they have.
    evident : (p,) array of bool
        Signals whose residuals are more than rounding.
    settings : TailSettings

    Returns
    -------
    float or None
        None where a Gaussian does.

    References
    ----------
    Lange, Little and Taylor, J. Am. Stat. Assoc. 84 (1989), 881.
    """
    if len(residual) < settings.fewest or not evident.any():
        return None
    own = covariance[:, evident][:, :, evident]
    left = residual[:, evident]
    squares = np.einsum("rp,rp->r", left, np.linalg.solve(own, left[:, :, None])[:, :, 0])
    p = left.shape[1]
    size = float(np.mean(squares)) / p
    if size <= 0:
        return None
    gaussian = -0.5 * len(squares) * p * (np.log(2 * np.pi * size) + 1)
    values = [_student_value(squares, p, nu, settings) for nu in settings.degrees]
    best = int(np.argmax(values))
    return settings.degrees[best] if values[best] > gaussian + settings.gain else None


def _student_value(squares: Array, p: int, nu: float, settings: TailSettings) -> float:
    """Log-likelihood of squared lengths (R,) in p dimensions under the best scale."""
    scale = float(np.mean(squares)) / p
    least = settings.least * scale
    for _ in range(settings.scalings):
        scale = float(np.mean(student_t_weights(squares / scale, p, nu) * squares)) / p
        scale = max(scale, least)
    of_rows = student_t_log_density(squares / scale, p, nu) - 0.5 * p * np.log(scale)
    return float(of_rows.sum())


def noise_scale(problem: Problem, run: Run) -> Array:
    """Find the variances that learned noise, one for each signal, is a factor of.

    Parameters
    ----------
    problem : Problem
    run : Run
        Counts the simulation, if one is needed.

    Returns
    -------
    (p,) array
        The variance of each measured signal. Signals that do not vary, and rotations, whose targets
        are angles of 0, have their mean squared error in the middle of the box.

    Raises
    ------
    SimulationFailed
        If that simulation diverges.

    Notes
    -----
    Factors lie in [1e-8, 1e4], so that a learned standard deviation is at least 1e-4 of the
    signal's: a signal that the model explains perfectly would outweigh all others without bound.
    """
    targets = problem.simulator.targets(problem.segments)
    variance = np.var(targets, axis=0)
    constant = flat(targets)
    if not constant.any():
        return variance
    return np.where(constant, misfit(problem, run), variance)


def noise_shape(problem: Problem, run: Run, settings: EpsilonSettings = DEFAULTS) -> Array:
    """Find the variances that one learned factor multiplies.

    Parameters
    ----------
    problem : Problem
    run : Run
        Counts the simulations.
    settings : EpsilonSettings

    Returns
    -------
    (p,) array
        The problem's own noise variances; without such, those of the residuals of least squares,
        but no less than `settings.lowest` of the signal's variance.

    Raises
    ------
    SimulationFailed
        If least squares meets a simulation that diverges.
    """
    if problem.epsilon is not None:
        return np.asarray(problem.epsilon, dtype=float)
    variance = np.var(problem.simulator.targets(problem.segments), axis=0)
    lowest = np.maximum(settings.lowest * variance, 1e-300)
    with run.beginning():
        return np.maximum(estimate(problem, run).noise, lowest)


def tune(
    fit_at: Callable[[float], Fit],
    sweep: Sequence[float],
    threshold: float | None,
    problem: Problem,
    run: Run,
    settings: EpsilonSettings = DEFAULTS,
) -> Fit:
    """Choose the smallest noise variance of a sweep whose fit has an acceptable error.

    Parameters
    ----------
    fit_at : callable
        Fits with one noise variance for all signals.
    sweep : sequence of float
        The variances to try [signal unit^2].
    threshold : float or None
        The largest mean squared error that is accepted. None: 1.1 times the least of the sweep.
    problem : Problem
    run : Run
        Its progress is shown over the whole sweep.
    settings : EpsilonSettings

    Returns
    -------
    Fit
        The chosen one, with the table of all in `noise_tuning`. If none is accepted, that of the
        least error, with a warning. An interrupted sweep chooses from what is done.

    References
    ----------
    Tiboni 2021, section 5.3 and figure 6.4.
    """
    fits: list[Fit] = []
    whole = run.progress
    for place, epsilon in enumerate(sorted(sweep)):
        run.progress = partial(_show_part, whole, place, len(sweep), epsilon)
        fits.append(fit_at(epsilon))
        if fits[-1].status is Status.INTERRUPTED:
            break
    run.progress = whole

    limit = threshold
    if limit is None:
        rounding = settings.rounding * float(np.var(problem.segments.targets))
        limit = settings.accepted * min(fit.mse for fit in fits) + rounding
    trials = []
    for fit in fits:
        variance = float(np.sum(fit.sd**2))
        trials.append(NoiseTrial(float(fit.epsilon[0]), variance, fit.mse, fit.log_likelihood))
    tuning = NoiseTuning(tuple(trials), limit)

    accepted = [fit for fit in fits if fit.mse <= limit]
    if accepted:
        return replace(accepted[0], noise_tuning=tuning)
    best = min(fits, key=lambda fit: fit.mse)
    note = f"no epsilon of the sweep reaches the mean squared error {limit:.3g}; the least is shown"
    return replace(best, warnings=(*best.warnings, note), noise_tuning=tuning)


def _show_part(
    whole: Progress, place: int, count: int, epsilon: float, fraction: float, text: str
) -> None:
    """Show the progress of one fit as a part of the sweep's."""
    whole((place + fraction) / count, f"epsilon {epsilon:.0e}: {text}")
