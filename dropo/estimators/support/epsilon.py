"""The variance of the noise: by a sweep over given values (thesis, section 5.3), or what a learned
one starts from.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from dropo.core.contracts.estimator import Run
from dropo.core.contracts.problem import Problem
from dropo.core.numerics.diverged_simulations import flat
from dropo.core.records.fit import Fit, Status
from dropo.core.records.fit_choices import NoiseTrial, NoiseTuning
from dropo.core.services.validation import Array
from dropo.estimators.least_squares import estimate, misfit

PERFECT = 1e-8  # of a signal's variance: less noise than that is not claimed


def noise_scale(problem: Problem, run: Run) -> Array:
    """(p,) what each signal's own learned epsilon is a factor of, in [1e-8, 1e4]: the measured
    signal's variance.

    So a learned epsilon stays above (1e-4 of the signal's standard deviation)^2: a signal that the
    model explains perfectly would otherwise outweigh all others without bound. Signals that do not
    vary, and rotations, whose targets are angles of 0, go by the misfit in the middle of the box.
    """
    targets = problem.simulator.targets(problem.segments)
    variance = np.var(targets, axis=0)
    still = flat(targets)
    return np.where(still, misfit(problem, run), variance) if still.any() else variance


def noise_shape(problem: Problem, run: Run) -> Array:
    """(p,) what one learned factor on all variances is a factor of: the problem's own, else what
    least squares leaves.

    The latter are kept above (1e-4 of a signal's standard deviation)^2, as in `noise_scale`.
    """
    if problem.epsilon is not None:
        return np.asarray(problem.epsilon, dtype=float)
    spread = np.var(problem.simulator.targets(problem.segments), axis=0)
    return np.maximum(estimate(problem, run).noise, np.maximum(PERFECT * spread, 1e-300))


def tune(
    fit_at: Callable[[float], Fit],
    sweep: Sequence[float],
    threshold: float | None,
    problem: Problem,
    run: Run,
) -> Fit:
    """The fit at the smallest epsilon of the sweep with an acceptable mean squared error (thesis,
    section 5.3, figure 6.4).

    Without a threshold, acceptable is at most 1.1 times the least of the sweep. Its table is the
    fit's `noise_tuning`.
    """
    fits: list[Fit] = []
    report = run.progress
    for i, epsilon in enumerate(sorted(sweep)):
        run.progress = lambda share, text, i=i, e=epsilon: report(
            (i + share) / len(sweep), f"epsilon {e:.0e}: {text}"
        )  # type: ignore[misc]
        fits.append(fit_at(epsilon))
        if fits[-1].status is Status.INTERRUPTED:
            break
    run.progress = report
    least = min(fit.mse for fit in fits)
    limit = (
        1.1 * least + 1e-10 * float(np.var(problem.segments.targets))
        if threshold is None
        else threshold
    )
    accepted = [fit for fit in fits if fit.mse <= limit]
    trials = tuple(
        NoiseTrial(float(fit.epsilon[0]), float(np.sum(fit.sd**2)), fit.mse, fit.log_likelihood)
        for fit in fits
    )
    best = accepted[0] if accepted else min(fits, key=lambda fit: fit.mse)
    note = (
        ()
        if accepted
        else (
            (
                f"no epsilon of the sweep reaches the mean squared error {limit:.3g}; the "
                "least is shown"
            ),
        )
    )
    return replace(best, warnings=(*best.warnings, *note), noise_tuning=NoiseTuning(trials, limit))
