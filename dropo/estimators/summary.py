"""From a member of a family to a Fit: moments, standard errors, what is at its bound."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from dropo.core.checks import Array
from dropo.core.data import Ints, Segments
from dropo.core.errors import SimulationFailed
from dropo.core.estimator import Run
from dropo.core.family import Family
from dropo.core.fit import Fit, Status
from dropo.core.likelihood import LogLikelihood
from dropo.core.linear_gaussian import sandwich, scores_and_information
from dropo.core.local_likelihood import LocalLogLikelihood
from dropo.core.parameters import ParameterSpace
from dropo.core.problem import Problem
from dropo.estimators.held_out import held_out_errors

MANY = 20  # groups from which their number is enough for standard errors clustered by group


def summarise(
    problem: Problem, run: Run, *, method: str, family: Family, family_name: str, phi: Array, epsilon: Array, log_likelihood: float,
    mean_prediction: Array, status: Status, message: str, objective: LogLikelihood | None = None,
    warnings: Sequence[str] = (), arrays: dict[str, Array] | None = None, details: dict[str, Any] | None = None,
) -> Fit:  # fmt: skip
    """A Fit for the member phi of the family; standard errors by the clustered sandwich: on the objective's own scores where
    it has them, else on the linear-Gaussian model."""
    own = phi[: len(family.unknowns)]  # behind it stand the likelihood's unknowns
    mean, scale, sd, correlation = family.mean(own), family.scale(own), family.sd(own), family.correlation(own)
    notes = [*problem.warnings, *warnings, *at_bounds(family.unknowns, own)]
    try:
        if isinstance(objective, LocalLogLikelihood):
            mean_se, scale_se = local_standard_errors(problem, family, objective, phi)
        else:
            with run.counting():
                mean_se, scale_se = standard_errors(problem, mean, sd, correlation, epsilon)
    except SimulationFailed as error:
        mean_se = scale_se = np.full(len(mean), np.nan)
        notes.append(f"no standard errors: {error}")
    misfit = mean_prediction - problem.simulator.targets(problem.segments)
    return Fit(
        method=method, problem=problem.name, space=problem.space, family=family_name, phi=own, mean=mean,
        scale=scale, sd=sd, mean_se=mean_se, scale_se=scale_se, correlation=correlation, epsilon=epsilon, log_likelihood=log_likelihood,
        mse=float(np.mean(misfit**2)), transitions=int(problem.segments.lengths.sum()), simulator_steps=0, failed_simulations=0,
        objective_evaluations=0, status=status, message=message, warnings=tuple(notes), arrays=arrays or {},
        details={**(details or {}), **({"truth": dict(problem.truth)} if problem.truth else {}), **held_out_errors(problem, run, mean)},
    )  # fmt: skip


def standard_errors(problem: Problem, mean: Array, sd: Array, correlation: Array, epsilon: Array) -> tuple[Array, Array]:
    """(d,) standard errors of the means and of the scales; NaN where the data do not tell, and for a scale of about 0."""
    segments = problem.segments
    predicted, jacobian = problem.simulator.linearise(mean, segments)
    residuals = problem.simulator.targets(segments) - predicted
    noise = np.maximum(np.where(epsilon > 0, epsilon, np.mean(residuals**2, axis=0)), rounding(problem))
    scores, information = scores_and_information(residuals, jacobian, correlation * np.outer(sd, sd), noise)
    variance = np.diagonal(sandwich(scores, information, clusters(segments)))
    d = len(mean)
    with np.errstate(divide="ignore", invalid="ignore"):
        scale_se = np.where(sd > 0, np.sqrt(variance[d:]) / (2 * sd), np.nan)
    scale_se[~(scale_se < sd)] = np.nan  # a spread that may be 0 has no symmetric error
    return np.sqrt(variance[:d]), scale_se


def local_standard_errors(problem: Problem, family: Family, objective: LocalLogLikelihood, phi: Array) -> tuple[Array, Array]:
    """(d,) as `standard_errors`, from a local likelihood's scores; unknowns on a bound of phi are held fixed."""
    n = len(family.unknowns)
    _, scores, information = objective.expand(phi)
    units = clusters(problem.segments)
    units = units if len(units) == len(scores) else np.arange(len(scores))  # scores of groups are independent as they are
    unit = family.unknowns.to_unit(phi[:n])
    free = np.concatenate([(unit > 1e-6) & (unit < 1 - 1e-6), np.ones(len(phi) - n, dtype=bool)])
    errors = np.full(len(phi), np.nan)
    errors[free] = np.sqrt(np.diagonal(sandwich(scores[:, free], information[np.ix_(free, free)], units)))
    names = objective.unknowns.names
    mean_se = np.array([errors[names.index(f"mean.{name}")] for name in family.space.names])
    scale_se = np.array([errors[names.index(f"scale.{name}")] if f"scale.{name}" in names else np.nan for name in family.space.names])
    scale_se[~(scale_se < family.scale(phi[:n]))] = np.nan
    return mean_se, scale_se


def rounding(problem: Problem) -> Array:
    """(p,) the variance of rounding in each signal, below which a residual says nothing: (1e-12 of its size)^2."""
    return np.maximum(1e-24 * np.mean(problem.segments.targets**2), 1e-60) * np.ones(len(problem.simulator.signals))


def clusters(segments: Segments) -> Ints:
    """(R,) what is independent of the rest: groups where the data name many, else segments."""
    given = segments.trajectories.group is not None and len(np.unique(segments.group)) >= MANY
    return np.unique(segments.group if given else np.arange(len(segments)), return_inverse=True)[1][segments.rows[0]]


def at_bounds(space: ParameterSpace, phi: Array) -> list[str]:
    """A sentence for every mean on its bound, and for a scale on its upper one: the search wanted to go on."""
    unit = space.to_unit(phi)
    out = []
    for name, u, low, high in zip(space.names, unit, space.low, space.high, strict=True):
        if name.startswith("partial."):  # of no meaning between parameters that do not vary
            continue
        if u > 1 - 1e-3:
            out.append(f"{name} ends on its upper bound {high:.6g}: widen it, or the model cannot explain the data")
        elif u < 1e-3 and name.startswith("mean."):
            out.append(f"{name} ends on its lower bound {low:.6g}: widen it, or the model cannot explain the data")
    return out
