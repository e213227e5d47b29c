"""From a member of a family to a fit: moments, standard errors, and what speaks against them."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import special

from dropo.core.contracts.estimator import Run
from dropo.core.contracts.family import Family
from dropo.core.contracts.likelihood import LocalLogLikelihood, LogLikelihood
from dropo.core.contracts.prior import describe
from dropo.core.contracts.problem import Problem
from dropo.core.contracts.support.mean_prior import MeanPrior
from dropo.core.numerics.kept_rows import MEMORY, MemorySettings
from dropo.core.records.fits.fit import Fit, Status
from dropo.core.records.fits.fit_parts import ModelCheck, PriorUse
from dropo.core.records.parameters import ParameterSpace
from dropo.core.services.errors import SimulationFailed
from dropo.core.services.validation import Array
from dropo.estimators.support.common_errors import with_common_errors
from dropo.estimators.support.standard_errors import (
    OfPrior,
    StandardErrors,
    local_standard_errors,
    standard_errors,
)
from dropo.evaluation.held_out import held_out_errors
from dropo.evaluation.identifiability import describe_not_identifiable, determined, null_directions
from dropo.evaluation.likely_cause import LikelyCause, likely_cause
from dropo.evaluation.model_check import check_model


@dataclass(frozen=True)
class SummarySettings:
    """What a summary warns of.

    Attributes
    ----------
    apart : float
        A prior is warned of where data and prior are more standard deviations apart: by chance, one
        fit in 16,000.
    near : float
        An estimate is warned of that is nearer to its bound than this fraction of the interval.
    cut : float
        So is a posterior whose mean is nearer than so many standard deviations: an exponential
        density has 1, one that knows nothing of the interval 1.7.
    narrow : float
        Intervals are warned of that are so many times narrower than the scatter of scores says.
    level : float
        The probability that chance alone makes them look so.
    trials : float
        Usual effects are tried on a model that nothing else speaks against, for at most this
        fraction of the steps that the fit took.
    """

    apart: float = 4.0
    near: float = 1e-3
    cut: float = 1.3
    narrow: float = 1.5
    level: float = 0.001
    trials: float = 0.1


SETTINGS = SummarySettings()
WIDEN = "widen it, or the model cannot explain the data"


def as_found(
    problem: Problem,
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
    warnings: Sequence[str] = (),
    settings: SummarySettings = SETTINGS,
    **further: Any,
) -> Fit:
    """Make the fit of a member of a family without errors and checks.

    Parameters
    ----------
    problem : Problem
    method, family_name : str
        Their names.
    family : Family
    phi : (m,) array
        The member; behind the family's own unknowns may stand the likelihood's.
    epsilon : (p,) array
        The noise variances [signal unit^2].
    log_likelihood : float
        Of all rows [nats].
    mean_prediction : (R, p) array
        Under the member.
    status : Status
        How the method ended.
    message : str
        The same in words.
    warnings : sequence of str
        What the method has to say against it.
    settings : SummarySettings
        What is warned of.
    **further
        Further fields of the fit.

    Returns
    -------
    Fit
        At no cost: it simulates nothing.
    """
    own = phi[: len(family.unknowns)]
    unknown = np.full(len(problem.space), np.nan)
    notes = (*problem.warnings, *warnings, *at_bounds(family.unknowns, own, settings))
    misfit = mean_prediction - problem.simulator.targets(problem.segments)
    return Fit(
        method=method,
        problem=problem.name,
        space=problem.space,
        family=family_name,
        phi=own,
        mean=family.mean(own),
        scale=family.scale(own),
        sd=family.sd(own),
        mean_se=unknown,
        scale_se=unknown,
        degrees_of_freedom=unknown,
        correlation=family.correlation(own),
        epsilon=epsilon,
        log_likelihood=log_likelihood,
        mse=float(np.mean(misfit**2)),
        transitions=int(problem.segments.lengths.sum()),
        simulator_steps=0,
        failed_simulations=0,
        objective_evaluations=0,
        status=status,
        message=message,
        warnings=notes,
        truth=dict(problem.truth or {}),
        **further,
    )


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
    memory: MemorySettings = MEMORY,
    settings: SummarySettings = SETTINGS,
    **further: Any,
) -> Fit:
    """Make the fit of a member of a family.

    Parameters
    ----------
    problem : Problem
    run : Run
    method, family_name : str
        Their names.
    family : Family
    phi : (m,) array
        The member; behind the family's own unknowns may stand the likelihood's.
    epsilon : (p,) array
        The noise variances [signal unit^2].
    log_likelihood : float
        Of all rows [nats].
    mean_prediction : (R, p) array
        Under the member.
    status : Status
        How the method ended.
    message : str
        The same in words.
    objective : LogLikelihood, optional
        That phi maximises. A local one has scores of its own, by which standard errors are found;
        else they are those of the linear-Gaussian model.
    weighted_by : (p,) array, optional
        The noise variances that the estimate took for its weights; epsilon by default.
    warnings : sequence of str
        What the method has to say against it.
    memory : MemorySettings
        What of it the sensitivities of the checks may take.
    settings : SummarySettings
        What is warned of.
    **further
        Further fields of the fit: its typed parts, or an outside method's `arrays` and `details`.

    Returns
    -------
    Fit
        With standard errors, held-out errors, what the data do not determine, and whether the
        model can be right. What it cost is filled in by `Estimator.fit`; `run.best` is the fit as
        far as it has come.
    """
    fit = as_found(
        problem,
        method=method,
        family=family,
        family_name=family_name,
        phi=phi,
        epsilon=epsilon,
        log_likelihood=log_likelihood,
        mean_prediction=mean_prediction,
        status=status,
        message=message,
        warnings=warnings,
        settings=settings,
        **further,
    )
    mean = fit.mean
    run.best = fit

    prior = MeanPrior(problem.priors, problem.space)
    try:
        errors = _standard_errors(
            problem, run, family, objective, phi, epsilon, weighted_by, prior, memory
        )
    except SimulationFailed as error:
        fit = replace(fit, warnings=(*fit.warnings, f"no standard errors: {error}"))
    else:
        errors = with_common_errors(problem, run, mean, mean_prediction, epsilon, errors)
        fit = replace(fit, **_with_errors(problem, mean, epsilon, errors, prior))
        if errors.prior is not None:
            use = _prior_use(problem, errors.prior)
            said = (*fit.warnings, *_against_priors(use, settings))
            fit = replace(fit, priors=use, warnings=said)
        run.best = fit

        # Whether the model can be right, where a search came to an end.
        if status in (Status.CONVERGED, Status.OUT_OF_BUDGET):
            check = _check_model(problem, family, objective, phi, mean_prediction, errors, epsilon)
            fit = _checked(problem, run, fit, errors, check)
    run.best = fit
    return replace(fit, held_out=held_out_errors(problem, run, mean))


def _with_errors(
    problem: Problem, mean: Array, epsilon: Array, errors: StandardErrors, prior: MeanPrior
) -> dict[str, Any]:
    """The fields of standard errors; a mean that neither data nor prior determine has none."""
    null = null_directions(problem.space, errors.jacobian, epsilon)
    left = null
    if prior:
        curvature = prior.information(mean)
        left = null_directions(problem.space, errors.jacobian, epsilon, known=curvature)
    return {
        "mean_se": np.where(determined(problem.space, left), errors.mean, np.nan),
        "scale_se": errors.scale,
        "variance_se": errors.variance,
        "degrees_of_freedom": errors.degrees,
        "correlation_se": errors.correlation,
        "identifiability": tuple(describe_not_identifiable(problem, mean, errors.jacobian, null)),
    }


def of_every_fit(problem: Problem, run: Run, fit: Fit) -> dict[str, Any]:
    """Return the fields that every fit has of its problem.

    Parameters
    ----------
    problem : Problem
    run : Run
        Counts the simulations.
    fit : Fit
        So far without them.

    Returns
    -------
    dict
        Warnings, truth and held-out errors.
    """
    return {
        "warnings": (*problem.warnings, *fit.warnings),
        "truth": dict(problem.truth or {}),
        "held_out": held_out_errors(problem, run, fit.mean),
    }


def with_model_check(problem: Problem, run: Run, fit: Fit) -> Fit:
    """Check whether the model of a fit can be right, at its means.

    Parameters
    ----------
    problem : Problem
    run : Run
    fit : Fit
        Of a method without a likelihood that is maximised.

    Returns
    -------
    Fit
        With the check, and what it says among the warnings. As it was where the search was
        interrupted, whose residuals are the search's too, or the simulation fails there.
    """
    run.best = fit
    if fit.status is Status.INTERRUPTED:
        return fit
    try:
        with run.counting(evaluations=1):
            noise = np.asarray(fit.epsilon)
            errors = standard_errors(problem, fit.mean, fit.sd, fit.correlation, noise)
            predicted = problem.simulator.predict(fit.mean[None], problem.segments)[0]
    except SimulationFailed:
        return fit
    if not np.isfinite(predicted).all():
        return fit
    check = check_model(problem, predicted, errors.jacobian, noise)
    narrow = _too_narrow(fit, errors)
    if narrow:
        check = replace(check, passed=False, sentences=(*check.sentences, *narrow))
    return _checked(problem, run, fit, errors, check)


def _too_narrow(
    fit: Fit, errors: StandardErrors, settings: SummarySettings = SETTINGS
) -> list[str]:
    """A sentence where scores scatter more than a likelihood says on which intervals rest.

    Parameters that differ from run to run do that, and noise that has a memory.
    """
    if errors.by_likelihood is None:
        return []
    claimed = np.fmax(errors.by_likelihood, fit.mean_se)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = errors.mean / claimed
        by_chance = special.chdtrc(errors.degrees, ratio**2 * errors.degrees)
    found = (ratio > settings.narrow) & (by_chance < settings.level / len(ratio))
    if not found.any():
        return []
    worst = int(np.where(found, ratio, 0.0).argmax())
    return [
        f"the intervals are too narrow: that of {fit.space.names[worst]} would be"
        f" {ratio[worst]:.2g} times as wide by how runs scatter. Parameters differ from run to run,"
        " or noise has a memory: use --method dropo or random-effects"
    ]


def _checked(
    problem: Problem,
    run: Run,
    fit: Fit,
    errors: StandardErrors,
    check: ModelCheck,
    settings: SummarySettings = SETTINGS,
) -> Fit:
    """A fit with its check, and what its residuals look like where they speak against the model."""
    affordable = settings.trials * run.steps if check.passed else np.inf
    cause: LikelyCause | None = None
    if check.structure is not None:  # else the residuals are rounding
        with run.counting():
            noise = np.asarray(fit.epsilon)
            cause = likely_cause(problem, fit.mean, errors.jacobian, noise, affordable)
    said = list(check.sentences)
    if cause is not None and cause.certain:
        said.append(f"the model is wrong: {cause.sentence}")
        check = replace(check, passed=False, sentences=tuple(said))
    elif cause is not None and not check.passed and cause.large:
        said.append(cause.sentence)
    return replace(fit, model_check=check, warnings=(*fit.warnings, *said))


def _standard_errors(
    problem: Problem,
    run: Run,
    family: Family,
    objective: LogLikelihood | None,
    phi: Array,
    epsilon: Array,
    weighted_by: Array | None,
    prior: MeanPrior,
    memory: MemorySettings,
) -> StandardErrors:
    """Standard errors, from the objective's own scores where it has such."""
    with run.counting():
        if isinstance(objective, LocalLogLikelihood):
            return local_standard_errors(
                problem, family, objective, phi, prior=prior, memory=memory
            )
        own = phi[: len(family.unknowns)]
        noise = epsilon if weighted_by is None else weighted_by
        mean = family.mean(own)
        sd = family.sd(own)
        return standard_errors(problem, mean, sd, family.correlation(own), noise, prior=prior)


def _prior_use(problem: Problem, found: OfPrior) -> PriorUse:
    """What the priors are to the fit, by name."""
    names = problem.space.names
    pull = dict(zip(names, found.pull.tolist(), strict=True))
    return PriorUse(
        laws={name: describe(prior) for name, prior in problem.priors.items()},
        share=dict(zip(names, found.fraction.tolist(), strict=True)),
        apart={name: pull[name] for name in problem.priors},
    )


def _against_priors(use: PriorUse, settings: SummarySettings) -> list[str]:
    """A sentence on each prior that the data contradict."""
    return [
        f"the data contradict the prior {use.laws[name]} of {name}: they are {apart:.3g} standard"
        " deviations apart, and the fit lies between them"
        for name, apart in use.apart.items()
        if apart > settings.apart
    ]


def _check_model(
    problem: Problem,
    family: Family,
    objective: LogLikelihood | None,
    phi: Array,
    mean_prediction: Array,
    errors: StandardErrors,
    epsilon: Array,
) -> ModelCheck:
    """The model check, by whitened residuals where the measurements' covariance is known."""
    learned = objective is None or len(objective.unknowns) > len(family.unknowns)
    whitened = None if objective is None else objective.whitened
    if objective is not None and not learned and problem.noise_degrees is None:
        of_rows = objective.whitened_residuals(phi)
        whitened = whitened if of_rows is None else of_rows
    return check_model(
        problem,
        mean_prediction,
        errors.jacobian,
        epsilon,
        whitened=whitened,
        learned=learned,
        unexplained=None if objective is None else objective.unexplained,
    )


def at_bounds(space: ParameterSpace, phi: Array, settings: SummarySettings = SETTINGS) -> list[str]:
    """Name the means on a bound, and the scales on their upper one: the search wanted to go on.

    Parameters
    ----------
    space : ParameterSpace
        The unknowns.
    phi : (m,) array
        Their values.
    settings : SummarySettings
        What counts as near.

    Returns
    -------
    list of str
        A sentence each.
    """
    sentences = []
    for i, (name, unit) in enumerate(zip(space.names, space.to_unit(phi), strict=True)):
        if name.startswith("partial."):  # of no meaning between parameters that do not vary
            continue
        if unit > 1 - settings.near:
            sentences.append(f"{name} ends on its upper bound {space.high[i]:.6g}: {WIDEN}")
        elif unit < settings.near and name.startswith("mean."):
            sentences.append(f"{name} ends on its lower bound {space.low[i]:.6g}: {WIDEN}")
    return sentences


def cut_off(
    space: ParameterSpace, mean: Array, sd: Array, settings: SummarySettings = SETTINGS
) -> list[str]:
    """Name the parameters whose posterior a bound of the box cuts off.

    Parameters
    ----------
    space : ParameterSpace
        Of the d parameters.
    mean, sd : (d,) array
        Of the posterior.
    settings : SummarySettings
        What counts as cut off.

    Returns
    -------
    list of str
        A sentence each; of a mean on its bound, `at_bounds` speaks.
    """
    sentences = []
    width = space.high - space.low
    for side, bound, room in (
        ("lower", space.low, mean - space.low),
        ("upper", space.high, space.high - mean),
    ):
        cut = (room < settings.cut * sd) & (room > settings.near * width)
        sentences += [
            f"the posterior of {space.names[i]} is cut off by its {side} bound {bound[i]:.6g}:"
            f" {WIDEN}"
            for i in np.flatnonzero(cut)
        ]
    return sentences
