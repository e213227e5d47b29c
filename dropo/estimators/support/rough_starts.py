"""Segments that start from estimated states and touch something: how their fit is searched.

A smoother does not see the impact at which a velocity jumps, and an error of a start makes or
breaks contacts: what it leads to is no linear function of it. Such errors are not carried through
the motion. They are part of what learned noise and standard errors of dependent rows hold.
"""

from dataclasses import dataclass, field

import numpy as np

from dropo.core.contracts.estimator import Run
from dropo.core.contracts.likelihood import LocalLogLikelihood
from dropo.core.contracts.problem import Problem
from dropo.core.records.fit import Fit
from dropo.core.services.validation import Array
from dropo.estimators.support.first_mean.global_search import SETTINGS as EVERYWHERE
from dropo.estimators.support.first_mean.global_search import GlobalSearchSettings
from dropo.estimators.support.standard_errors import local_jacobian
from dropo.estimators.support.trust_region import TrustRegionSettings
from dropo.mjmodel.options import physics_step
from dropo.mjmodel.robot_simulator import RobotSimulator

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


def of_the_physics_step(
    problem: Problem,
    run: Run,
    fit: Fit,
    objective: LocalLogLikelihood,
    point: Array,
    settings: RoughStartSettings = SEARCH.rough,
) -> tuple[str, ...]:
    """Say which estimates are those of the model's physics step.

    Parameters
    ----------
    problem : Problem
        Whose robot is simulated once more, with steps of half the length.
    run : Run
        Counts the simulations.
    fit : Fit
    objective : LocalLogLikelihood
        Of which the fit is the maximum; by its slopes and weights the estimates would move.
    point : (m,) array
        Its unknowns at the fit.
    settings : RoughStartSettings
        How rows far from the fit are weighed.

    Returns
    -------
    tuple of str
        A sentence where one would move by more than its standard error.
    """
    simulator = problem.simulator
    if not isinstance(simulator, RobotSimulator):
        return ()
    finer = simulator.with_finer_steps(2)
    segments = problem.segments
    with run.counting(evaluations=1):
        own = simulator.predict(fit.mean[None], segments)[0]
        other = finer.predict(fit.mean[None], segments)[0]
    simulator.steps += finer.steps
    slopes = np.asarray(local_jacobian(objective, fit.mean, problem)[:])
    moments = objective.moments(point)
    spread = np.diag(np.maximum(fit.epsilon, 1e-300))
    covariance = spread[None] if moments is None else moments[1]
    whiten = np.linalg.inv(np.linalg.cholesky(covariance))
    there = np.isfinite(other) & np.isfinite(own)
    residual = np.where(there, simulator.targets(segments) - own, 0.0)
    change = np.where(there, other - own, 0.0)
    z = (whiten @ residual[:, :, None])[:, :, 0]
    weight = 1 / (settings.degrees + np.sum(z**2, axis=1))
    along = whiten @ slopes
    gram = np.einsum("rpi,r,rpj->ij", along, weight, along)
    moment = np.einsum("rpi,r,rpq,rq->i", along, weight, whiten, change, optimize=True)
    moved = -np.linalg.pinv(gram, hermitian=True) @ moment
    far = np.flatnonzero(np.abs(moved) > fit.mean_se)
    if not len(far):
        return ()
    step = 500 * physics_step(simulator.model)
    sizes = ", ".join(
        f"{problem.space.names[i]} by {moved[i]:+.2g} ({abs(moved[i]) / fit.mean_se[i]:.1f} se)"
        for i in far.tolist()
    )
    return (
        f"physics steps of half the length ({step:.3g} ms) would move {sizes}: intervals hold for"
        " the model at its own step",
    )
