"""What the problem's data say about a law that was not found by its likelihood: by draws of it, or
of a posterior.
"""

from dataclasses import replace
from typing import Any

import numpy as np

from dropo.core.contracts.estimator import Run
from dropo.core.contracts.interactive_estimator import distribution
from dropo.core.contracts.problem import Problem
from dropo.core.records.fit import Fit, Status
from dropo.core.services.errors import Incompatible
from dropo.core.services.registry import find
from dropo.core.services.validation import Array
from dropo.estimators.support.epsilon import noise_shape
from dropo.estimators.support.posterior_targets import PointLikelihood
from dropo.estimators.support.summary import at_bounds
from dropo.evaluation.held_out import held_out_errors

ROUNDING = 1e-12  # of an interval: the standard deviation of draws that are all the same


def judged(problem: Problem, run: Run, fit: Fit, draws: int, rng: np.random.Generator) -> Fit:
    """The fit with log-likelihood and errors of so many draws of its law; no standard errors, as
    its method has none.

    The noise variance is the problem's own, else that of what the draws' mean leaves.
    """
    targets = problem.simulator.targets(problem.segments)
    with run.counting(evaluations=1):
        predictions = problem.simulator.predict(fit.sample(draws, rng), problem.segments)
    residual = np.mean((predictions.mean(axis=0) - targets) ** 2, axis=0)
    epsilon = (
        residual
        if problem.epsilon is None
        else np.broadcast_to(np.asarray(problem.epsilon, dtype=float), targets.shape[1:])
    )
    rows = find("likelihoods", "monte-carlo")(draws=draws).log_density(
        predictions, targets, epsilon
    )
    return replace(
        fit,
        epsilon=epsilon,
        log_likelihood=float(rows.sum()) if np.isfinite(rows).all() else -np.inf,
        mse=float(residual.mean()),
        **_told(problem, run, fit),
    )


def point_likelihood(
    problem: Problem, run: Run, method: str, epsilon: float | tuple[float, ...] | None
) -> PointLikelihood:
    """The likelihood of parameters that are the same in all rows; epsilon: None, the problem's own,
    else what least squares leaves.
    """
    if problem.start_noise or problem.noise_degrees is not None:
        raise Incompatible(
            f"Method {method!r} knows Gaussian noise on the compared rows alone, and the "
            f"problem {problem.name!r} has other noise too."
            " Use method 'posterior' or 'dropo'."
        )
    return PointLikelihood(
        problem, noise_shape(problem, run) if epsilon is None else np.asarray(epsilon, dtype=float)
    )


def posterior_fit(
    problem: Problem,
    run: Run,
    method: str,
    draws: Array,
    target: PointLikelihood,
    *,
    status: Status,
    message: str,
    arrays: dict[str, Array],
    details: dict[str, Any],
    warnings: tuple[str, ...] = (),
) -> Fit:
    """The Gaussian with the mean and covariance of a posterior's draws (K, d) of the parameters,
    which are its standard errors too.

    log_likelihood and mse are those of the mean; the draws are kept in `arrays["draws"]`.
    """
    d = len(problem.space)
    family = find("families", "full")(problem.space)
    rounding = np.diag((ROUNDING * (problem.space.high - problem.space.low)) ** 2)
    phi = family.phi_of(draws.mean(axis=0), np.cov(draws.T).reshape(d, d) + rounding)
    mean = family.mean(phi)
    with run.counting(evaluations=1):
        value = float(target.many(mean[None])[0])
        predicted = target.mean(mean)
    fit = distribution(
        problem,
        method,
        "full",
        phi,
        mean_se=family.sd(phi),
        epsilon=target.epsilon(mean),
        log_likelihood=value,
        mse=float(np.mean((predicted - target.targets) ** 2)),
        status=status,
        message=message,
        arrays={"draws": draws, **arrays},
        details=details,
        warnings=(*warnings, *at_bounds(family.unknowns, phi)),
    )
    return replace(fit, **_told(problem, run, fit))


def _told(problem: Problem, run: Run, fit: Fit) -> dict[str, Any]:
    """Warnings and details that every fit has."""
    truth = {"truth": dict(problem.truth)} if problem.truth else {}
    return {
        "warnings": (*problem.warnings, *fit.warnings),
        "details": {**fit.details, **truth, **held_out_errors(problem, run, fit.mean)},
    }
