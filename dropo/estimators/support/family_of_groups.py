"""What groups of recordings say against the family of a fit."""

from dataclasses import dataclass

import numpy as np

from dropo.core.contracts.family import Family
from dropo.core.contracts.likelihood import GroupedLogLikelihood, LocalLogLikelihood
from dropo.core.contracts.problem import Problem
from dropo.core.contracts.simulator import Simulator
from dropo.core.contracts.support.fisher_scoring import maximize_locally
from dropo.core.records.fits.fit import Fit
from dropo.core.records.trajectories import Segments
from dropo.core.services.registry import find
from dropo.core.services.validation import Array
from dropo.evaluation.family_check import check_family


@dataclass(frozen=True)
class GroupsOfRowsSettings:
    """How groups are found behind a fit by rows.

    Attributes
    ----------
    segments : int
        About so many segments are taken at most, evenly spread.
    width : float
        Smallest width of the groups' emulator, as a fraction of the search interval.
    """

    segments: int = 20000
    width: float = 1e-4


SETTINGS = GroupsOfRowsSettings()


def family_warnings(
    problem: Problem,
    family: Family,
    objective: LocalLogLikelihood,
    phi: Array,
    fit: Fit,
    rng: np.random.Generator,
    settings: GroupsOfRowsSettings = SETTINGS,
) -> list[str]:
    """Test the family of a fit on the parameters of the data's groups.

    A likelihood of rows knows no groups: where the data name some, their parameters are those of
    random effects, with the fit's local model in the simulator's place, so that nothing is
    simulated. Trajectories are groups for random effects alone: errors that their rows share, such
    as those of noisy starts, look like a spread of the parameters to a fit by rows.

    Parameters
    ----------
    problem : Problem
    family : Family
        Of the fit.
    objective : LocalLogLikelihood
        Whose local model follows the simulator over the whole spread.
    phi : (m,) array
        Its maximum.
    fit : Fit
        What was found there.
    rng : numpy.random.Generator
    settings : GroupsOfRowsSettings

    Returns
    -------
    list of str
        A sentence for each thing that the family does not have; none where nothing varies.
    """
    varies = np.isfinite(fit.scale_se)
    if not varies.any() or len(np.unique(problem.segments.group)) < 2:
        return []
    is_named = problem.segments.trajectories.group is not None
    if not (is_named or isinstance(objective, GroupedLogLikelihood)):
        return []
    has_correlations = any(name.startswith("partial.") for name in family.unknowns.names)
    population: Family = family
    if isinstance(objective, GroupedLogLikelihood):
        grouped = objective
    else:
        name = "full" if has_correlations else "truncated_gaussian"
        population = find("families", name)(problem.space)
        segments = problem.segments.take(problem.segments.thin(settings.segments))
        # A scale of 0 has no slope to begin with: the spread that the mean's error leaves room for.
        room = np.nan_to_num(fit.mean_se * np.sqrt(len(np.unique(segments.group))))
        sd = np.maximum(fit.sd, room)
        width = np.maximum(sd, settings.width * (problem.space.high - problem.space.low))
        grouped = find("likelihoods", "random-effects")().linearize_at(
            _LocalModel(problem, objective),
            segments,
            population,
            objective.epsilon(phi),
            fit.mean,
            width,
            rng.spawn(1)[0],
        )
        start = population.phi(fit.mean, sd)
        phi = maximize_locally(grouped, grouped.unknowns.clip(start)).phi
    member = phi[: len(population.unknowns)]
    sd = population.sd(member)
    return check_family(
        problem.space,
        fit.family,
        grouped.groups(phi),
        population.mean(member),
        population.correlation(member) * np.outer(sd, sd),
        rng,
        logarithmic=family.logarithmic,
        correlated=has_correlations,
    )


class _LocalModel(Simulator):
    """A local model in its simulator's place; it makes no steps."""

    steps_per_action = 0

    def __init__(self, problem: Problem, objective: LocalLogLikelihood):
        self.space = problem.space
        self.signals = problem.simulator.signals
        self.problem = problem
        self.objective = objective
        self._starts = problem.segments.steps[:, 0]

    def targets(self, segments: Segments) -> Array:
        """Measured signals (R, p), as the simulator has them."""
        return self.problem.simulator.targets(segments)

    def _predict(self, values: Array, segments: Segments, offsets: Array | None) -> Array:
        own = np.isin(self._starts[self.problem.segments.rows[0]], segments.steps[:, 0])
        rows = np.flatnonzero(own)
        predictions = [self.objective.predict_rows(value[None], rows) for value in values]
        return np.concatenate(predictions)
