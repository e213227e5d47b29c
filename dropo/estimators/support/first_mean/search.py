"""A local search that ends in a result: from the first mean, else from the best of the box, else
without what blows up.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

from dropo.core.contracts.estimator import Run
from dropo.core.contracts.family import Family
from dropo.core.contracts.likelihood import LocalLogLikelihood
from dropo.core.contracts.noise import Noise
from dropo.core.contracts.problem import Problem
from dropo.core.contracts.support.maximize import SearchResult
from dropo.core.records.fits.fit import Status
from dropo.core.services.errors import SimulationFailed
from dropo.core.services.validation import Array
from dropo.estimators.support.epsilon import noise_scale
from dropo.estimators.support.first_mean.exploding import without_exploded, without_exploding
from dropo.estimators.support.first_mean.global_search import (
    GlobalSearchSettings,
    GlobalStart,
    best_start,
)

Search = Callable[[Problem, Noise, Array, Array | None], tuple[LocalLogLikelihood, SearchResult]]
"""From a problem, its noise, a first mean (d,) and the first region's width (d,) to a maximum."""


@dataclass(frozen=True, eq=False)
class Searched:
    """Where a search ended, and what it was about.

    Attributes
    ----------
    problem : Problem
        Without segments that blew up.
    noise : Noise
    objective : LocalLogLikelihood
    found : SearchResult
    width : (d,) array, optional
        Of a region that holds no other optimum, where there are several.
    """

    problem: Problem
    noise: Noise
    objective: LocalLogLikelihood
    found: SearchResult
    width: Array | None = None

    def mean(self, family: Family) -> Array:
        """Return the means that were found.

        Parameters
        ----------
        family : Family
            In which the search was.

        Returns
        -------
        (d,) array
            In the parameters' units.
        """
        return family.mean(self.found.point[: len(family.unknowns)])


def search_from(
    problem: Problem,
    run: Run,
    family: Family,
    noise: Noise,
    mean: Array,
    elsewhere: GlobalStart | None,
    search: Search,
    settings: GlobalSearchSettings,
) -> Searched:
    """Search from a first mean, and again where that fails, blows up, or loses a better optimum.

    Parameters
    ----------
    problem : Problem
    run : Run
        Counts the simulations.
    family : Family
    noise : Noise
    mean : (d,) array
        Where to begin.
    elsewhere : GlobalStart, optional
        The best of the box, where it was looked for.
    search : callable
        Finds a maximum.
    settings : GlobalSearchSettings
        How the box is looked over where the search fails.

    Returns
    -------
    Searched

    Raises
    ------
    SimulationFailed
        Where simulations of too many segments diverge.
    """
    width = elsewhere.width if elsewhere else None
    try:
        done = Searched(problem, noise, *search(problem, noise, mean, width))
    except SimulationFailed:
        # Most of the box may explode.
        elsewhere = best_start(problem, run, mean, settings)
        mean = elsewhere.best
        width = elsewhere.width
        try:
            done = Searched(problem, noise, *search(problem, noise, mean, width))
        except SimulationFailed:
            rest = without_exploding(problem, run, mean)
            if rest is None:
                raise
            done = Searched(rest, noise, *search(rest, noise, mean, width))
    if done.found.status is Status.INTERRUPTED:
        return done

    # Rows that a regression took for signals of great length.
    predicted = done.objective.mean(done.found.point)
    rest = without_exploded(done.problem, run, done.mean(family), predicted)
    if rest is not None:
        if noise.learned == "each":  # what blew up is no measure of noise
            noise = replace(noise, variance=noise_scale(rest, run))
        done = Searched(rest, noise, *search(rest, noise, mean, width))

    # A search that lost the best optimum begins again there, and does not look far around.
    if elsewhere is not None and elsewhere.is_better_than(done.mean(family)):
        objective, found = search(done.problem, done.noise, elsewhere.best, elsewhere.near)
        if found.value > done.found.value:
            done = replace(done, objective=objective, found=found)
    return replace(done, width=elsewhere.width if elsewhere else None)
