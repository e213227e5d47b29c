"""From a member of a family to a Fit: moments, standard errors, whether the model can be right,
what the data cannot tell.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from dropo.core.contracts.estimator import Run
from dropo.core.contracts.family import Family
from dropo.core.contracts.likelihood import LogLikelihood
from dropo.core.contracts.local_likelihood import LocalLogLikelihood
from dropo.core.contracts.problem import Problem
from dropo.core.numerics.linear_gaussian import scores_and_information
from dropo.core.numerics.robust_covariance import sandwich
from dropo.core.records.dependence import independent, units_of
from dropo.core.records.fit import Fit, Status
from dropo.core.records.parameters import ParameterSpace
from dropo.core.services.errors import SimulationFailed
from dropo.core.services.validation import Array
from dropo.evaluation.fit_errors import held_out_errors
from dropo.evaluation.identifiability import blind_spots, determined, null_directions
from dropo.evaluation.model_check import ModelCheck, check_model

EDGE = 1e-6  # of an unknown's interval: nearer to its bound it is on it
STEPS = (
    1e-3,
    1e-2,
)  # least and largest half width of a simulator's differences, as a share of a parameter's interval
FINE = 1e-6  # likewise of a local model's, which is smooth


def summarize(
    problem: Problem,
    run: Run,
    *,
    method: str,
    family: Family,
    family_name: str,
    phi: Array,
    epsilon: Array,
    log_likelihood: float,
    mean_prediction: Array,
    status: Status,
    message: str,
    objective: LogLikelihood | None = None,
    weighted_by: Array | None = None,
    warnings: Sequence[str] = (),
    arrays: dict[str, Array] | None = None,
    details: dict[str, Any] | None = None,
) -> Fit:
    """A Fit for the member phi of the family, with sandwich errors from the objective's own scores
    where it has them, else from the linear-Gaussian model; weighted_by: (p,) the noise variances
    that the estimate took for its weights, epsilon by default.
    """
    own = phi[: len(family.unknowns)]  # behind it stand the likelihood's unknowns
    mean = family.mean(own)
    scale = family.scale(own)
    sd = family.sd(own)
    correlation = family.correlation(own)
    notes = [*problem.warnings, *warnings, *at_bounds(family.unknowns, own)]
    found = dict(details or {})
    mean_se = scale_se = degrees = np.full(len(mean), np.nan)
    try:
        with run.counting():
            if isinstance(objective, LocalLogLikelihood):
                mean_se, scale_se, degrees = local_standard_errors(problem, family, objective, phi)
                jacobian = local_jacobian(objective, mean, problem.space)
            else:
                noise = epsilon if weighted_by is None else weighted_by
                mean_se, scale_se, degrees, jacobian = standard_errors(
                    problem, mean, sd, correlation, noise
                )
        unknown = null_directions(problem.space, jacobian, epsilon)
        found["identifiability"] = blind_spots(problem, mean, jacobian, unknown)
        mean_se = np.where(determined(problem.space, unknown), mean_se, np.nan)
        if status in (Status.CONVERGED, Status.OUT_OF_BUDGET):
            check = _check(problem, family, objective, phi, mean_prediction, jacobian, epsilon)
            found["model_check"] = check.found
            notes += check.sentences
    except SimulationFailed as error:
        notes.append(f"no standard errors: {error}")
    misfit = mean_prediction - problem.simulator.targets(problem.segments)
    return Fit(
        method=method,
        problem=problem.name,
        space=problem.space,
        family=family_name,
        phi=own,
        mean=mean,
        scale=scale,
        sd=sd,
        mean_se=mean_se,
        scale_se=scale_se,
        degrees=degrees,
        correlation=correlation,
        epsilon=epsilon,
        log_likelihood=log_likelihood,
        mse=float(np.mean(misfit**2)),
        transitions=int(problem.segments.lengths.sum()),
        simulator_steps=0,
        failed_simulations=0,
        objective_evaluations=0,
        status=status,
        message=message,
        warnings=tuple(notes),
        arrays=arrays or {},
        details={
            **found,
            **({"truth": dict(problem.truth)} if problem.truth else {}),
            **held_out_errors(problem, run, mean),
        },
    )


def standard_errors(
    problem: Problem, mean: Array, sd: Array, correlation: Array, noise: Array
) -> tuple[Array, Array, Array, Array]:
    """(d,) standard errors of the means and of the scales, the degrees of freedom of the first, and
    the Jacobian (R, p, d).

    NaN where the data do not tell, for a mean on its bound, and for a scale of about 0.
    Sensitivities are differences over a hundredth of the interval, then over one standard error as
    they give it, but no less than a thousandth: a contact that switches inside a step gives slopes
    without bound as differences shrink.
    """
    space = problem.space
    width = problem.space.high - problem.space.low
    free = _inside(space, mean)
    step = STEPS[1] * width
    for _ in range(2):
        errors, scale_se, degrees, jacobian = _errors_with(
            problem, mean, sd, correlation, noise, free, step
        )
        step = np.clip(
            np.where(np.isfinite(errors), errors, step), STEPS[0] * width, STEPS[1] * width
        )
    return errors, scale_se, degrees, jacobian


def _errors_with(
    problem: Problem,
    mean: Array,
    sd: Array,
    correlation: Array,
    noise: Array,
    free: np.ndarray,
    step: Array,
) -> tuple[Array, Array, Array, Array]:
    segments = problem.segments
    d = len(mean)
    predicted, jacobian = problem.simulator.linearize(mean, segments, step=step)
    residuals = problem.simulator.targets(segments) - predicted
    known = np.maximum(np.where(noise > 0, noise, np.mean(residuals**2, axis=0)), rounding(problem))
    scores, information = scores_and_information(
        residuals, jacobian, correlation * np.outer(sd, sd), known
    )
    kept = np.tile(free, 2)
    covariance, counted = sandwich(
        scores[:, kept], information[np.ix_(kept, kept)], units_of(segments)
    )
    variance, degrees = np.full((2, 2 * d), np.nan)
    variance[kept], degrees[kept] = np.diagonal(covariance), counted
    with np.errstate(divide="ignore", invalid="ignore"):
        scale_se = np.where(sd > 0, np.sqrt(variance[d:]) / (2 * sd), np.nan)
    scale_se[~(scale_se < sd)] = np.nan  # a spread that may be 0 has no symmetric error
    return np.sqrt(variance[:d]), scale_se, degrees[:d], jacobian


def local_standard_errors(
    problem: Problem, family: Family, objective: LocalLogLikelihood, phi: Array
) -> tuple[Array, Array, Array]:
    """The first three of `standard_errors`, from a local likelihood's scores; unknowns on a bound
    of phi are held fixed.
    """
    n = len(family.unknowns)
    _, scores, information = objective.value_score_information(phi)
    units = units_of(problem.segments)
    units = (
        units if len(units.label) == len(scores) else independent(len(scores))
    )  # scores of groups are independent as they are
    free = np.concatenate([_inside(family.unknowns, phi[:n]), np.ones(len(phi) - n, dtype=bool)])
    errors, degrees = np.full((2, len(phi)), np.nan)
    covariance, degrees[free] = sandwich(scores[:, free], information[np.ix_(free, free)], units)
    errors[free] = np.sqrt(np.diagonal(covariance))
    names = objective.unknowns.names
    means = [names.index(f"mean.{name}") for name in family.space.names]
    scale_se = np.array(
        [
            errors[names.index(f"scale.{name}")] if f"scale.{name}" in names else np.nan
            for name in family.space.names
        ]
    )
    scale_se[~(scale_se < family.scale(phi[:n]))] = np.nan
    return errors[means], scale_se, degrees[means]


def local_jacobian(objective: LocalLogLikelihood, mean: Array, space: ParameterSpace) -> Array:
    """(R, p, d) slopes of the local model at the mean."""
    half = FINE * np.diag(space.high - space.low)
    predictions = objective.predict(np.concatenate([mean + half, mean - half]))
    slopes = (predictions[: len(mean)] - predictions[len(mean) :]) / (2 * np.diagonal(half))[
        :, None, None
    ]
    return np.moveaxis(slopes, 0, -1)


def _check(
    problem: Problem,
    family: Family,
    objective: LogLikelihood | None,
    phi: Array,
    mean_prediction: Array,
    jacobian: Array,
    epsilon: Array,
) -> ModelCheck:
    """The model check; a likelihood that knows the covariance of the measurements has their
    whitened residuals.
    """
    learned = objective is None or len(objective.unknowns) > len(family.unknowns)
    moments = getattr(objective, "moments", None)
    whitened = None
    if moments is not None and not learned and problem.noise_degrees is None:
        mean, covariance = moments(phi)
        residual = problem.simulator.targets(problem.segments) - mean
        whitened = np.linalg.solve(np.linalg.cholesky(covariance), residual[:, :, None])[:, :, 0]
    return check_model(
        problem, mean_prediction, jacobian, epsilon, whitened=whitened, learned=learned
    )


def _inside(space: ParameterSpace, values: Array) -> np.ndarray:
    unit = space.to_unit(values)
    return np.asarray((unit > EDGE) & (unit < 1 - EDGE))


def rounding(problem: Problem) -> Array:
    """(p,) the variance of rounding in each signal, below which a residual says nothing: (1e-12 of
    its size)^2.
    """
    return np.maximum(1e-24 * np.mean(problem.segments.targets**2), 1e-60) * np.ones(
        len(problem.simulator.signals)
    )


def at_bounds(space: ParameterSpace, phi: Array) -> list[str]:
    """A sentence for every mean on its bound, and for a scale on its upper one: the search wanted
    to go on.
    """
    unit = space.to_unit(phi)
    out = []
    for name, u, low, high in zip(space.names, unit, space.low, space.high, strict=True):
        if name.startswith("partial."):  # of no meaning between parameters that do not vary
            continue
        if u > 1 - 1e-3:
            out.append(
                f"{name} ends on its upper bound {high:.6g}: widen it, or the model cannot "
                "explain the data"
            )
        elif u < 1e-3 and name.startswith("mean."):
            out.append(
                f"{name} ends on its lower bound {low:.6g}: widen it, or the model cannot "
                "explain the data"
            )
    return out
