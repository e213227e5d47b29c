"""Segments that start from estimated states and touch something: how their fit is searched.

A smoother does not see the impact at which a velocity jumps, and an error of a start makes or
breaks contacts: what it leads to is no linear function of it. Such errors are not carried through
the motion. They are part of what learned noise and standard errors of dependent rows hold.
"""

from dataclasses import dataclass, field

from dropo.core.contracts.problem import Problem
from dropo.estimators.support.first_mean.global_search import SETTINGS as EVERYWHERE
from dropo.estimators.support.first_mean.global_search import GlobalSearchSettings
from dropo.estimators.support.trust_region import TrustRegionSettings

SMOOTHED = (
    "Estimated states touch something: errors of starts are part of the noise, not carried through"
    " contacts."
)
ROUGH = TrustRegionSettings(
    minimum_width=1e-3,
    coarse_iterations=4,
    errors_wide=5.0,
    settled_width=0.6,
    settled_error=0.5,
    patience=2,
)
"""Predictions jump where contacts begin. Slopes are those of regions that hold many jumps, and
maxima come out a little different from each design."""
FEW_SEGMENTS = GlobalSearchSettings(segments=16, descents=False)
"""Machines in contact are costly, and misfits jump: few segments from all over the box say where to
begin, and wide regions of coarse models go on from there."""


@dataclass(frozen=True)
class RoughStartSettings:
    """How segments are fitted that start from estimated states and touch something.

    Attributes
    ----------
    regions : TrustRegionSettings
        How trust regions move where predictions jump.
    points : GlobalSearchSettings
        How much of the box and of the data is tried before.
    degrees : float
        Degrees of freedom of the noise where none are given: an error that makes or breaks a
        contact is large, and seldom.
    """

    regions: TrustRegionSettings = ROUGH
    points: GlobalSearchSettings = FEW_SEGMENTS
    degrees: float = 4.0


@dataclass(frozen=True)
class SearchSettings:
    """How the maximum of a likelihood of segments is searched.

    Attributes
    ----------
    regions : TrustRegionSettings
        How trust regions move, and when the outer iterations end.
    points : GlobalSearchSettings
        How much of the box and of the data is tried before, where there may be several optima.
    rough : RoughStartSettings
        What takes the place of both where errors of start states must not be carried through the
        motion.
    """

    regions: TrustRegionSettings = field(default_factory=TrustRegionSettings)
    points: GlobalSearchSettings = EVERYWHERE
    rough: RoughStartSettings = field(default_factory=RoughStartSettings)


SEARCH = SearchSettings()


def starts_are_rough(problem: Problem) -> bool:
    """Tell whether errors of start states must not be carried through the motion.

    Parameters
    ----------
    problem : Problem

    Returns
    -------
    bool
        True where part of the start states was estimated, and some segments start in contact.
    """
    if not problem.estimated:
        return False
    return bool(problem.simulator.in_contact(problem.segments).any())


def search_settings(
    problem: Problem, settings: SearchSettings = SEARCH
) -> tuple[TrustRegionSettings, GlobalSearchSettings]:
    """Return how a problem is searched: in regions, and before, over the whole box.

    Parameters
    ----------
    problem : Problem
        Whose start states decide.
    settings : SearchSettings
        How problems are searched.

    Returns
    -------
    regions : TrustRegionSettings
    points : GlobalSearchSettings
    """
    if starts_are_rough(problem):
        return settings.rough.regions, settings.rough.points
    return settings.regions, settings.points
