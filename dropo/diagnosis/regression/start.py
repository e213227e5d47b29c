"""Where a search by simulation begins when a model is far off: with what regression finds."""

import copy
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dropo.core.contracts.effect import ActiveEffects, EffectInstance, Quantity
from dropo.core.contracts.problem import Problem
from dropo.core.records.trajectories import Ints
from dropo.core.services.errors import BadArgument, Incompatible
from dropo.core.services.validation import Array
from dropo.diagnosis.parts import Cause
from dropo.diagnosis.regression.quick import (
    QuickSettings,
    estimate_missing,
    fixed_numbers,
    sides,
)
from dropo.diagnosis.regression.wiring import wiring_faults
from dropo.diagnosis.search.library import declared, robot_of
from dropo.mjmodel.robot_simulator import RobotSimulator


@dataclass(frozen=True, eq=False)
class Start:
    """A model that lacks many numbers, with a first estimate of each.

    Attributes
    ----------
    problem : Problem
        The model as it is; the data in those that were fitted and those held out.
    parameters : mapping of int to float
        What is missing of declared parameters: their values by index.
    numbers : sequence of (EffectInstance, (q,) array)
        What else is missing, with its magnitudes inside of its bounds.
    errors : mapping of (str, str or None, str) to float
        By effect, place and quantity, the regression's standard errors.
    """

    problem: Problem
    parameters: Mapping[int, float]
    numbers: ActiveEffects
    errors: Mapping[tuple[str, str | None, str], float]

    @property
    def extended(self) -> Problem:
        """The problem with the numbers that are no declared parameters in its simulator."""
        simulator = robot_of(self.problem)
        return replace(self.problem, simulator=simulator.with_effects((), self.numbers))

    def among(self, instances: Sequence[EffectInstance]) -> list[EffectInstance]:
        """Return effects to look for, with those of the start in the place of their own kind."""
        own = {instance.label: instance for instance, _ in self.numbers}
        others = [instance for instance in instances if instance.label not in own]
        return [*own.values(), *others]

    def with_errors(self, causes: Sequence[Cause]) -> tuple[Cause, ...]:
        """Return causes whose standard errors are no smaller than the regression's.

        Those hold what a log leaves open of the scale of all numbers; windows do not.
        """
        found = []
        for cause in causes:
            estimates = {}
            for name, one in cause.estimate.items():
                least = self.errors.get((cause.effect, cause.target, name), 0.0)
                # An unknown error is as large as the number.
                least = least if np.isfinite(least) else abs(one.value)
                estimates[name] = replace(one, se=max(one.se, least))
            found.append(replace(cause, estimate=estimates))
        return tuple(found)


def start_of(
    problem: Problem, free: Ints, fewest: int, gain: float, settings: QuickSettings
) -> Start | None:
    """Find what a model lacks by regression, where that is much.

    Parameters
    ----------
    problem : Problem
        Any.
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
    Start or None
        None where fewer numbers are missing, where the log does not fit the model's wiring, or
        where the robot or the data do not suit a regression.
    """
    if wiring_warnings(problem):
        return None
    simulator = robot_of(problem)
    fitted, checked = sides(problem, settings.checked)
    try:
        estimate = estimate_missing(problem, fitted, settings)
    except (Incompatible, BadArgument):
        return None
    named = [one for one in estimate.numbers(simulator, settings.certain) if one.named]
    if len(named) < fewest and abs(estimate.solution.gain) < gain:
        return None
    parameters: dict[int, float] = {}
    numbers = []
    for instance, sizes in fixed_numbers(simulator, estimate):
        if declared(simulator, instance, free):
            parameters |= _declared_values(simulator, instance, sizes)
        else:
            numbers.append((_reaching(instance, sizes), sizes))
    divided = replace(problem, trajectories=fitted, held_out=checked)
    errors = {
        (number.effect, number.target, name): one.se
        for number in estimate.numbers(simulator, 0.0)
        for name, one in number.estimates
    }
    return Start(divided, parameters, numbers, errors)


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


def _declared_values(
    simulator: RobotSimulator, instance: EffectInstance, sizes: Array
) -> dict[int, float]:
    """The values, by index, of the declared parameters that an effect's magnitudes (q,) stand for.

    They are kept inside of their search interval.
    """
    space = simulator.space
    found = {}
    for quantity, size in zip(instance.quantities, sizes.tolist(), strict=True):
        name = f"{instance.label}/{quantity.name}"
        if name in space.names:
            found[space.names.index(name)] = size
    if instance.model is not None:
        changed = copy.copy(simulator.model)
        instance.model(changed, sizes)
        for i, binding in enumerate(simulator.bindings):
            if not np.array_equal(binding.read(changed), binding.read(simulator.model)):
                scale = binding.read(simulator.model) if binding.parameter.relative else 1.0
                found[i] = float(np.mean(binding.read(changed) / scale))
    return {i: float(np.clip(value, space.low[i], space.high[i])) for i, value in found.items()}


def _reaching(instance: EffectInstance, sizes: Array) -> EffectInstance:
    """An effect whose bounds hold the magnitudes (q,)."""
    quantities = [
        _reaching_quantity(quantity, size)
        for quantity, size in zip(instance.quantities, sizes.tolist(), strict=True)
    ]
    return replace(instance, quantities=tuple(quantities))


def _reaching_quantity(quantity: Quantity, size: float) -> Quantity:
    """A quantity whose bounds hold a magnitude, with room."""
    low = quantity.low if size >= quantity.low else 2 * size
    high = quantity.high if size <= quantity.high else 2 * size
    return replace(quantity, low=low, high=high)
