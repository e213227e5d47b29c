"""A problem's data, to fit and held out, without the spans in which something pushes."""

from dataclasses import dataclass, replace

import numpy as np

from dropo.core.contracts.problem import Problem
from dropo.core.contracts.simulator import Simulator
from dropo.core.records.trajectories import Trajectories
from dropo.core.services.errors import BadArgument, SimulationFailed
from dropo.core.services.validation import Array
from dropo.data.outliers.disturbances import (
    SETTINGS,
    Disturbances,
    DisturbanceSettings,
    Span,
    find_disturbances,
    robust_values,
)


@dataclass(frozen=True, eq=False)
class WithoutDisturbances:
    """A problem without disturbed spans.

    Attributes
    ----------
    problem : Problem
        Without the spans.
    spans : tuple of Span
        What was left out, data held out last.
    share : float
        The fraction of all transitions that lies in them.
    """

    problem: Problem
    spans: tuple[Span, ...]
    share: float


def without_disturbances(
    problem: Problem,
    simulator: Simulator,
    values: Array,
    settings: DisturbanceSettings = SETTINGS,
) -> WithoutDisturbances | None:
    """Leave out the spans of a problem that a simulator cannot explain.

    What errors are usual is taken from the data to fit and those held out together, so that the
    same measure applies to both.

    Parameters
    ----------
    problem : Problem
        Whose data are cut.
    simulator : Simulator
        Of d parameters; it should explain most of the data.
    values : (d,) array
        Its parameters.
    settings : DisturbanceSettings
        What stands out.

    Returns
    -------
    WithoutDisturbances or None
        None if there are no such spans. None, too, if more than 20 % of the data, or more than a
        third of eight or more trajectories, stands out: then the model, not the data, is wrong.
        And None if too few data would be left.
    """
    step = simulator.control_step
    if step is None:
        return None
    found = find_disturbances(
        simulator, both_sides(problem), values, step, estimated=problem.estimated, settings=settings
    )
    disturbed = len({span.trajectory for span in found.spans})
    runs = len(found.trajectories.spans)
    too_much = found.share > settings.too_much
    too_often = runs >= settings.many_runs and disturbed > settings.too_often * runs
    if not found.spans or too_much or too_often:
        return None

    # Spans of data held out are numbered from their first trajectory on.
    count = len(problem.trajectories.spans)
    fitted = []
    held_out = []
    for span in found.spans:
        if span.trajectory < count:
            fitted.append(span)
        else:
            held_out.append(replace(span, trajectory=span.trajectory - count, held_out=True))
    try:
        train = Disturbances(problem.trajectories, tuple(fitted)).left_out()
        test: Trajectories | None = None
        if problem.held_out is not None:
            test = Disturbances(problem.held_out, tuple(held_out)).left_out()
        undisturbed = replace(problem, trajectories=train, everything=None, held_out=test)
    except BadArgument:
        # No trajectory is as long as a segment any more.
        return None
    return WithoutDisturbances(undisturbed, (*fitted, *held_out), found.share)


def remove_disturbances(
    problem: Problem, settings: DisturbanceSettings = SETTINGS
) -> WithoutDisturbances | None:
    """Leave out the spans that a problem's own simulator, robustly fitted, cannot explain.

    A model that lacks much finds fewer spans.

    Parameters
    ----------
    problem : Problem
        Only where its segments start from measurements: elsewhere they cannot begin anew behind a
        span.
    settings : DisturbanceSettings
        What stands out.

    Returns
    -------
    WithoutDisturbances or None
        None as of `without_disturbances`, and where the simulator cannot be fitted.
    """
    simulator = problem.simulator
    step = simulator.control_step
    if step is None or problem.reset != "transition":
        return None
    space = problem.space
    start = (space.low + space.high) / 2
    if simulator.nominal is not None:
        start = space.clip(simulator.nominal)
    try:
        values = robust_values(simulator, problem.trajectories, step, start, settings=settings)
        return without_disturbances(problem, simulator, values, settings)
    except SimulationFailed:
        # A search has nothing to start from; the fit itself will say so.
        return None


def both_sides(problem: Problem) -> Trajectories:
    """Return the trajectories to fit, then those held out.

    Parameters
    ----------
    problem : Problem
        With data held out, or without.

    Returns
    -------
    Trajectories
        Groups, or trajectories where there are no groups, are numbered on as groups.
    """
    sides = [problem.trajectories]
    if problem.held_out is not None:
        sides.append(problem.held_out)
    groups = []
    first = 0
    for side in sides:
        label = side.trajectory if side.group is None else side.group
        groups.append(label + first)
        first = int(label.max()) + 1
    return Trajectories(
        np.concatenate([side.observations for side in sides]),
        np.concatenate([side.actions for side in sides]),
        np.concatenate([side.next_observations for side in sides]),
        np.concatenate([side.terminals for side in sides]),
        np.concatenate(groups),
    )
