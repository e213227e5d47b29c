"""Whether a model is far off, and what regression then finds that it lacks."""

from dataclasses import replace

import numpy as np

from dropo.core.contracts.effect import ActiveEffects, instances_of
from dropo.core.contracts.problem import Problem
from dropo.core.records.trajectories import Ints
from dropo.core.services.errors import BadArgument, Incompatible
from dropo.diagnosis.far_off.model import GAIN, FarOffModel, reaching
from dropo.diagnosis.regression.quick import (
    QuickSettings,
    estimate_missing,
    fixed_numbers,
    sides,
)
from dropo.diagnosis.regression.wiring import wiring_faults
from dropo.diagnosis.search.library import changed_parameters, declared, robot_of
from dropo.mjmodel.robot_simulator import RobotSimulator


def start_of(
    problem: Problem, free: Ints, fewest: int, gain: float, settings: QuickSettings
) -> FarOffModel | None:
    """Find what a model lacks by regression, where that is much.

    Parameters
    ----------
    problem : Problem
        Any, whose wiring fits.
    free : int array
        Indices of the declared parameters that are fitted.
    fewest : int
        How many numbers must be missing for certain ...
    gain : float
        ... unless the drives' gain is off by more than this fraction.
    settings : QuickSettings
        Numbers that decide in the regression.

    Returns
    -------
    FarOffModel or None
        With the data in those that are fitted and those held out. None where fewer numbers are
        missing, or where the robot or the data do not suit a regression.
    """
    simulator = robot_of(problem)
    fitted, checked = sides(problem, settings.checked)
    try:
        estimate = estimate_missing(problem, fitted, settings)
    except (Incompatible, BadArgument):
        return None
    named = [one for one in estimate.numbers(simulator, settings.certain) if one.named]
    if len(named) < fewest and abs(estimate.solution.gain) < gain:
        return None
    space = simulator.space
    values = np.clip(np.asarray(simulator.nominal, dtype=float), space.low, space.high)
    numbers = []
    for instance, sizes in fixed_numbers(simulator, estimate):
        if not declared(simulator, instance, free):
            numbers.append((reaching(instance, sizes), sizes))
            continue
        for i, value in changed_parameters(simulator, instance, sizes).items():
            values[i] = np.clip(value, space.low[i], space.high[i])
    divided = replace(problem, trajectories=fitted, held_out=checked)
    return FarOffModel(divided, values, free, (*numbers, *_gain(simulator, free, numbers)))


def _gain(simulator: RobotSimulator, free: Ints, numbers: ActiveEffects) -> ActiveEffects:
    """The gain of all drives, 0, where it is not among the numbers: it belongs to their scale."""
    if any(instance.effect == GAIN for instance, _ in numbers):
        return ()
    every = list(instances_of(simulator.effect_context, GAIN))
    if not every or any(declared(simulator, instance, free) for instance in every):
        return ()
    # What acts on all of them stands behind the single ones.
    return ((every[-1], np.zeros(1)),)


def wiring_warnings(problem: Problem) -> tuple[str, ...]:
    """Say which signs, units and names of commands do not fit the joints that should follow them.

    Parameters
    ----------
    problem : Problem
        Any.

    Returns
    -------
    tuple of str
        A sentence each; none where the robot does not suit a regression.
    """
    try:
        faults = wiring_faults(robot_of(problem), problem.trajectories)
    except (Incompatible, BadArgument):
        return ()
    return tuple(fault.text for fault in faults)
