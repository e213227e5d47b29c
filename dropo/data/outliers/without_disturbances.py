"""A problem's data, those to fit and those held out, without the spans in which something pushes."""

from dataclasses import dataclass, replace

import numpy as np

from dropo.core.contracts.problem import Problem
from dropo.core.contracts.simulator import Simulator
from dropo.core.records.trajectories import Trajectories
from dropo.core.services.errors import BadArgument, SimulationFailed
from dropo.core.services.validation import Array
from dropo.data.outliers.disturbances import (
    MUCH,
    Disturbances,
    Span,
    find_disturbances,
    robust_values,
)

# trajectories, of which no more than this share is pushed: what comes back in so many is the
# model's own
MANY = 8
OFTEN = 1 / 3


@dataclass(frozen=True, eq=False)
class WithoutDisturbances:
    """problem: without the spans; share: of all transitions that lie in them."""

    problem: Problem
    spans: tuple[Span, ...]
    share: float


def without_disturbances(
    problem: Problem, simulator: Simulator, values: Array
) -> WithoutDisturbances | None:
    """The problem without the spans that the simulator with these values (d,) cannot explain.

    None where there are none, where so much, or in so many trajectories, stands out that the model
    is rather at fault, and where too few data would be left. What is usual is taken from both
    sides, so that spans of data held out are found by the same measure as those of data to fit.
    """
    step = simulator.control_step
    if step is None:
        return None
    found = find_disturbances(simulator, both_sides(problem), values, step)
    pushed = len({span.trajectory for span in found.spans})
    runs = len(found.trajectories.spans)
    if not found.spans or found.share > MUCH or (runs >= MANY and pushed > OFTEN * runs):
        return None
    count = len(problem.trajectories.spans)
    fitted = tuple(span for span in found.spans if span.trajectory < count)
    later = tuple(
        replace(span, trajectory=span.trajectory - count, held_out=True)
        for span in found.spans
        if span.trajectory >= count
    )
    try:
        quiet = replace(
            problem,
            trajectories=Disturbances(problem.trajectories, fitted).left_out(),
            everything=None,
            held_out=None
            if problem.held_out is None
            else Disturbances(problem.held_out, later).left_out(),
        )
    except BadArgument:  # no trajectory is as long as a segment any more
        return None
    return WithoutDisturbances(quiet, (*fitted, *later), found.share)


def remove_disturbances(problem: Problem) -> WithoutDisturbances | None:
    """The problem without the spans that its own simulator, robustly fitted to most of the data,
    cannot explain; None as of `undisturbed`.

    Only where segments start from measurements: elsewhere they cannot begin anew behind a span. A
    model that lacks much finds fewer spans.
    """
    simulator = problem.simulator
    step = simulator.control_step
    if step is None or problem.reset != "transition":
        return None
    space = problem.space
    start = (
        np.clip(simulator.nominal, space.low, space.high)
        if simulator.nominal is not None
        else (space.low + space.high) / 2
    )
    try:
        return without_disturbances(
            problem, simulator, robust_values(simulator, problem.trajectories, step, start)
        )
    except SimulationFailed:  # a search has nothing to start from; the fit itself will say so
        return None


def both_sides(problem: Problem) -> Trajectories:
    """The trajectories to fit, then those held out; groups, or trajectories where there are none,
    are counted on.
    """
    sides = [side for side in (problem.trajectories, problem.held_out) if side is not None]
    labels = [side.trajectory if side.group is None else side.group for side in sides]
    ahead = [0, int(labels[0].max()) + 1]
    return Trajectories(
        np.concatenate([side.observations for side in sides]),
        np.concatenate([side.actions for side in sides]),
        np.concatenate([side.next_observations for side in sides]),
        np.concatenate([side.terminals for side in sides]),
        np.concatenate([label + first for label, first in zip(labels, ahead, strict=False)]),
    )
