"""The problem's data under a distribution that its method did not find by their likelihood."""

from dataclasses import replace

import numpy as np

from dropo.core.contracts.estimator import Run
from dropo.core.contracts.interactive_estimator import distribution
from dropo.core.contracts.problem import Problem
from dropo.core.records.fits.fit import Fit, Status
from dropo.core.records.fits.search_records import SearchRecord
from dropo.core.services.errors import Incompatible
from dropo.core.services.registry import find
from dropo.core.services.validation import Array
from dropo.estimators.support.epsilon import noise_shape
from dropo.estimators.support.posterior_targets import PointLikelihood
from dropo.estimators.support.summary import at_bounds, cut_off, of_every_fit, with_model_check

ROUNDING = 1e-12  # of an interval: the standard deviation of draws that are all the same


def evaluate_fit(problem: Problem, run: Run, fit: Fit, draws: int, rng: np.random.Generator) -> Fit:
    """Add what the problem's data say about a fit's distribution.

    Parameters
    ----------
    problem : Problem
    run : Run
    fit : Fit
        Its method has no likelihood, and so no standard errors.
    draws : int
        From its distribution, by which the log-likelihood is estimated.
    rng : numpy.random.Generator

    Returns
    -------
    Fit
        With log-likelihood, mean squared error and held-out errors. The noise variance is the
        problem's own, else that of what the draws' mean leaves.
    """
    run.best = fit
    targets = problem.simulator.targets(problem.segments)
    with run.counting(evaluations=1):
        predictions = problem.simulator.predict(fit.sample(draws, rng), problem.segments)
    residual = np.mean((predictions.mean(axis=0) - targets) ** 2, axis=0)
    epsilon = residual
    if problem.epsilon is not None:
        epsilon = np.broadcast_to(np.asarray(problem.epsilon, dtype=float), targets.shape[1:])
    likelihood = find("likelihoods", "monte-carlo")(draws=draws)
    rows = likelihood.log_density(predictions, targets, epsilon)
    return replace(
        fit,
        epsilon=epsilon,
        log_likelihood=float(rows.sum()) if np.isfinite(rows).all() else -np.inf,
        mse=float(residual.mean()),
        **of_every_fit(problem, run, fit),
    )


def point_likelihood(
    problem: Problem, run: Run, method: str, epsilon: float | tuple[float, ...] | None
) -> PointLikelihood:
    """Make the likelihood of parameters that are the same in all rows.

    Parameters
    ----------
    problem : Problem
    run : Run
    method : str
        The name of the method that asks, for the refusal.
    epsilon : float or tuple of float, optional
        The noise variances; None: the problem's own, else what least squares leaves.

    Returns
    -------
    PointLikelihood

    Raises
    ------
    Incompatible
        Where the problem has other noise than a Gaussian one on the compared rows.
    """
    if problem.start_noise or problem.noise_degrees is not None:
        raise Incompatible(
            f"Method {method!r} knows Gaussian noise on the compared rows alone, and the problem"
            f" {problem.name!r} has other noise too. Use method 'posterior' or 'dropo'."
        )
    variances = noise_shape(problem, run) if epsilon is None else np.asarray(epsilon, dtype=float)
    return PointLikelihood(problem, variances)


def posterior_fit(
    problem: Problem,
    run: Run,
    method: str,
    draws: Array,
    target: PointLikelihood,
    *,
    status: Status,
    message: str,
    search_record: SearchRecord,
    warnings: tuple[str, ...] = (),
) -> Fit:
    """Make a fit of the draws of a posterior of the parameters.

    Parameters
    ----------
    problem : Problem
    run : Run
    method : str
        Its name.
    draws : (K, d) array
        Of the posterior.
    target : PointLikelihood
        The likelihood, for the value at the draws' mean.
    status : Status
        How the method ended.
    message : str
        The same in words.
    search_record : SearchRecord
        What the method keeps.
    warnings : tuple of str
        What speaks against the draws.

    Returns
    -------
    Fit
        The Gaussian with the draws' mean and covariance; its standard deviations are the means'
        standard errors too. log_likelihood and mse are those of the mean.
    """
    # Draws that are all the same are given the width of rounding.
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
        search_record=search_record,
        warnings=(
            *warnings,
            *at_bounds(family.unknowns, phi),
            *cut_off(problem.space, mean, family.sd(phi)),
        ),
    )
    run.best = fit
    return with_model_check(problem, run, replace(fit, **of_every_fit(problem, run, fit)))
