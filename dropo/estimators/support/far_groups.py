"""Groups far from the population's centre: local models of their own, checked by simulation."""

from dataclasses import dataclass, replace

import numpy as np

from dropo.core.contracts.estimator import Run
from dropo.core.contracts.likelihood import GroupedLogLikelihood
from dropo.core.contracts.support.fisher_scoring import maximize_locally
from dropo.core.contracts.support.maximize import SearchResult
from dropo.core.contracts.support.mean_prior import MeanPrior, local_with_prior
from dropo.core.services.validation import Array


@dataclass(frozen=True)
class FarGroupSettings:
    """When a group needs a local model of its own, and which are warned of.

    Attributes
    ----------
    rounds : int
        Simulations of all groups at their modes, at most; after each but the last, groups get
        models of their own.
    settled : float
        A mode that is off by less than so many standard deviations of its group is right.
    off : float
        A mode that is off by more standard deviations in the end is warned of.
    named : int
        Groups named in a warning, at most.
    """

    rounds: int = 10
    settled: float = 0.2
    off: float = 0.5
    named: int = 5


SETTINGS = FarGroupSettings()


def with_models_of_their_own(
    run: Run,
    objective: GroupedLogLikelihood,
    found: SearchResult,
    rng: np.random.Generator,
    prior: MeanPrior | None = None,
    settings: FarGroupSettings = SETTINGS,
) -> tuple[GroupedLogLikelihood, SearchResult, list[str]]:
    """Give groups local models of their own until a simulation at each group's mode confirms it.

    Parameters
    ----------
    run : Run
        Counts the simulations.
    objective : GroupedLogLikelihood
        Of all segments.
    found : SearchResult
        Its maximum.
    rng : numpy.random.Generator
        For the designs.
    prior : MeanPrior, optional
        Of the means.
    settings : FarGroupSettings

    Returns
    -------
    GroupedLogLikelihood
        With local models that hold where the groups are.
    SearchResult
        Its maximum.
    list of str
        A sentence on the groups that remain off.
    """
    for last in [*[False] * (settings.rounds - 1), True]:
        with run.counting(evaluations=1):
            errors = objective.mode_errors(found.point)
        off = errors > settings.settled
        if last or not off.any():
            break
        with run.counting(evaluations=1):
            objective = objective.with_own_models(found.point, off, rng)
        point = maximize_locally(local_with_prior(objective, prior), found.point).phi
        found = replace(found, point=point, value=objective(point))
    return objective, found, _warnings(objective, found, errors, settings)


def _warnings(
    objective: GroupedLogLikelihood, found: SearchResult, errors: Array, settings: FarGroupSettings
) -> list[str]:
    """A sentence that names the groups whose parameters are off."""
    off = np.flatnonzero(errors > settings.off)
    if not len(off):
        return []
    label = objective.groups(found.point).label
    names = ", ".join(map(str, label[off[: settings.named]]))
    names += ", ..." if len(off) > settings.named else ""
    worst = errors[off].max()
    size = f", by up to {worst:.2g} of their standard deviations" if np.isfinite(worst) else ""
    return [
        f"simulations at the parameters of {len(off)} of {len(errors)} groups ({names}) do not"
        f" confirm them{size}, and the population rests on them: leave these groups out, or fit"
        " them apart"
    ]
