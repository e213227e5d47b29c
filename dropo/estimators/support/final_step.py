"""The last step of a search that an emulator led: to where the simulator itself has its maximum."""

from dataclasses import dataclass, replace

import numpy as np

from dropo.core.contracts.estimator import Run
from dropo.core.contracts.family import Family
from dropo.core.contracts.likelihood import LocalLogLikelihood
from dropo.core.contracts.problem import Problem
from dropo.core.contracts.support.maximize import SearchResult
from dropo.core.contracts.support.mean_prior import MeanPrior, mean_places
from dropo.core.records.trajectories import Ints
from dropo.core.services.errors import SimulationFailed
from dropo.core.services.validation import Array


@dataclass(frozen=True)
class FinalStepSettings:
    """When the steps end.

    Attributes
    ----------
    simulations : int
        All segments are simulated so many times at most; a step follows each.
    settled : float
        A step below this fraction of the standard errors is the last.
    slopes : float
        Slopes of noisy starts are compared over steps of this fraction of the interval.
    affordable : float
        That is left out where it takes more than this fraction of the steps taken so far.
    """

    simulations: int = 2
    settled: float = 0.1
    slopes: float = 1e-3
    affordable: float = 1.0


SETTINGS = FinalStepSettings()


def corrected_by_simulation(
    problem: Problem,
    run: Run,
    family: Family,
    objective: LocalLogLikelihood,
    found: SearchResult,
    settings: FinalStepSettings = SETTINGS,
) -> tuple[LocalLogLikelihood, SearchResult]:
    """Move the means of a distribution without spread to the simulator's own maximum.

    An emulator is off by a little everywhere, its maximum with it. Shifted so that it is right at
    that maximum, it is off by what its slopes are wrong over a step: a Gauss-Newton step on the
    simulator, with the emulator's slopes. Its scores are those of the residuals alone: the least
    scale that a search allows would pull the means to where predictions spread less. Where starts
    carry noise, what it takes from the scores is added (errors in variables).

    Parameters
    ----------
    problem : Problem
    run : Run
        Counts the simulations.
    family : Family
    objective : LocalLogLikelihood
        Of all segments.
    found : SearchResult
        Its maximum.
    settings : FinalStepSettings

    Returns
    -------
    LocalLogLikelihood
        The objective that is right near its maximum; the given one where the simulation fails
        there, or a step leaves the region in which it holds.
    SearchResult
        Its maximum in the means.
    """
    places = mean_places(objective, problem.space)
    prior = MeanPrior(problem.priors, problem.space)
    targets = problem.simulator.targets(problem.segments)
    corrected = objective
    point = found.point
    of_starts = _of_noisy_starts(problem, run, objective, point, settings)
    for _ in range(settings.simulations):
        mean = family.mean(point[: len(family.unknowns)])
        with run.counting(evaluations=1):
            simulated = problem.simulator.predict(mean[None], problem.segments)[0]
        if not np.isfinite(simulated).all():
            break
        shifted = corrected.anchored(mean, simulated)
        without_residuals = corrected.anchored(mean, targets)
        step, errors = _fisher_step(shifted, without_residuals, of_starts, point, places, prior)
        moved = point.copy()
        moved[places] += step
        if np.any((moved < objective.unknowns.low) | (moved > objective.unknowns.high)):
            break
        corrected = shifted
        point = moved
        if np.all(np.abs(step) <= settings.settled * errors):
            break
    return corrected, replace(found, point=point, value=float(corrected(point)))


def _of_noisy_starts(
    problem: Problem,
    run: Run,
    objective: LocalLogLikelihood,
    phi: Array,
    settings: FinalStepSettings,
) -> Array | None:
    """(R, d) what the scores of the means lack by noise of the starts; None where there is none, or
    it is too costly.
    """
    space = problem.space
    step = settings.slopes * (space.high - space.low)
    evaluations = 2 * len(space) * (2 * len(problem.simulator.signals) + 1)
    actions = evaluations * int(problem.segments.lengths.sum())
    if actions * problem.simulator.steps_per_action > settings.affordable * run.steps:
        return None
    try:
        with run.counting():
            return objective.scores_of_noisy_starts(phi, problem.simulator, problem.segments, step)
    except SimulationFailed:
        return None


def _fisher_step(
    objective: LocalLogLikelihood,
    without_residuals: LocalLogLikelihood,
    of_starts: Array | None,
    phi: Array,
    places: Ints,
    prior: MeanPrior,
) -> tuple[Array, Array]:
    """(d,) the step of the means that residuals' and prior's scores ask for, 0 on a bound; (d,)
    the means' standard errors behind it, by the sandwich of what the step leaves of the scores.
    """
    low = objective.unknowns.low[places]
    high = objective.unknowns.high[places]
    free = (phi[places] > low) & (phi[places] < high)
    chosen = places[free]
    _, scores, information = objective.value_score_information(phi)
    of_residuals = scores[:, chosen]
    del scores
    of_residuals -= without_residuals.value_score_information(phi)[1][:, chosen]
    if of_starts is not None:
        of_residuals += of_starts[:, free]
    known = prior.information(phi[places])[free]
    of_prior = prior.score(phi[places])[free]
    both = information[np.ix_(chosen, chosen)] + np.diag(known)
    inverse = np.linalg.pinv(both, hermitian=True)
    own = of_residuals @ inverse
    step = np.zeros(len(places))
    errors = np.zeros(len(places))
    step[free] = own.sum(axis=0) + of_prior @ inverse
    errors[free] = np.sqrt(np.sum((own - own.mean(axis=0)) ** 2, axis=0))
    return step, errors
