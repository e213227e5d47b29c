"""Checks that every estimator must pass."""

import numpy as np

from dropo.core.contracts.estimator import Estimator
from dropo.core.contracts.problem import Problem
from dropo.core.records.fits.fit import Fit, Status
from dropo.core.services.validation import Array
from dropo.testing.optimizers import no_global_stream

MAX_Z = 4.5
"""Standard errors between a mean and the truth: 7e-6 false alarms a number."""


def check_estimator(
    estimator: Estimator, problem: Problem, *, tolerance: float = 0.0, max_z: float = MAX_Z
) -> Fit:
    """Check that an estimator keeps to the contract of `Estimator` on a problem.

    Parameters
    ----------
    estimator : Estimator
        A method with its settings.
    problem : Problem
        With d parameters that it can fit; where it has a `truth`, the means must find it.
    tolerance : float
        How far means may be from the truth beside their standard errors, as a fraction of the
        parameters' bounds; for methods without standard errors.
    max_z : float
        And how many standard errors.

    Returns
    -------
    Fit
        The first of the fits.

    Raises
    ------
    AssertionError
        If a rule is broken: the same seed must give the same fit, no global random stream may be
        used, shapes must be those of the problem and numbers finite, and the truth must be found.
    """
    with no_global_stream(type(estimator).__name__):
        fit = estimator.fit(problem, rng=0)
    again = estimator.fit(problem, rng=0)
    d = len(problem.space)
    for name in ("mean", "scale", "sd"):
        values: Array = getattr(fit, name)
        assert values.shape == (d,), f"{name} has shape {values.shape}, not ({d},)"
        assert np.isfinite(values).all(), f"{name} is not finite: {values}"
        same = np.array_equal(values, getattr(again, name))
        assert same, f"the same seed gives another {name}: {values} and {getattr(again, name)}"
    inside = (problem.space.lower <= fit.mean) & (fit.mean <= problem.space.upper)
    assert inside.all(), f"means outside what is possible: {fit.mean}"
    assert fit.correlation.shape == (d, d), f"correlation has shape {fit.correlation.shape}"
    assert fit.space is problem.space or fit.space.names == problem.space.names
    assert isinstance(fit.status, Status), f"status is {fit.status!r}"
    assert fit.message, "no message says how it ended"
    counted = fit.simulator_steps + fit.objective_evaluations
    assert counted > 0, "nothing was counted: simulate inside run.evaluate or run.counting"
    _check_truth(fit, problem, tolerance, max_z)
    return fit


def _check_truth(fit: Fit, problem: Problem, tolerance: float, max_z: float) -> None:
    """The means find the truth within their errors, where it is known."""
    width = problem.space.high - problem.space.low
    for name, value in (problem.truth or {}).items():
        i = problem.space.names.index(name)
        off = abs(float(fit.mean[i]) - value)
        error = float(np.nan_to_num(fit.mean_se[i]))
        allowed = max_z * error + tolerance * float(width[i])
        assert off <= allowed, f"{name} is {off:.3g} from the truth; {allowed:.3g} is allowed"
