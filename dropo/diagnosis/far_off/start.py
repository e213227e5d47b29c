"""Whether a model is far off, and what regression then finds that it lacks."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dropo.core.contracts.effect import ActiveEffects, instances_of
from dropo.core.contracts.problem import Problem
from dropo.core.records.trajectories import Ints
from dropo.core.services.errors import BadArgument, Incompatible
from dropo.diagnosis.far_off.model import GAIN, FarOffModel, reaching
from dropo.diagnosis.findings.premises.chattering import chattering_sentences
from dropo.diagnosis.regression.equation import is_floating
from dropo.diagnosis.regression.missing import FoundNumber, Missing
from dropo.diagnosis.regression.quick import (
    QuickSettings,
    as_effects,
    estimate_missing,
    fixed_numbers,
)
from dropo.diagnosis.regression.readings import sides
from dropo.diagnosis.search.library import PARTNERS, changed_parameters, declared, robot_of
from dropo.mjmodel.robot_simulator import RobotSimulator

OF_ALL_DRIVES = (GAIN, "actuator_delay")
"""Effects that are fitted to whole motions in any case: the gain belongs to the scale of all
numbers, and smoothing hides a delay of stiff servos.
"""


@dataclass(frozen=True)
class FarOffLimits:
    """When a model is far off.

    Attributes
    ----------
    numbers : int
        A model is far off for certain if by regression at least this many numbers are missing.
    many : int
        Where fewer than so many are, a few causes may explain what regression took for more: they
        are looked for where whole motions leave something.
    gain : float
        A model is also far off for certain if the drives' gain is off by this fraction or more, and
        no few causes explain it.
    forces : float
        A model may be far off if it leaves more than this fraction of the drives' forces; motions
        are asked then.
    explained : float
        It may be far off only if numbers of several kinds explain at least this fraction of those
        forces.
    kinds : int
        Smallest number of such kinds.
    scale : float
        Where the drives' gain is not certain and without it at most this many times as much is left
        of the forces, the numbers count that are certain without it: all that a gain makes larger,
        the model's own rotors and friction too, seems to be missing beside it.
    """

    numbers: int = 4
    many: int = 8
    gain: float = 0.5
    forces: float = 0.1
    explained: float = 0.5
    kinds: int = 2
    scale: float = 1.25


@dataclass(frozen=True, eq=False)
class FarOffStart:
    """What a search by whole motions begins with.

    Attributes
    ----------
    model : FarOffModel
        With the data in those that are fitted and those by which it is decided what is.
    whole : Problem
        With all data that may be fitted, and those held out: the problem's own where it holds out
        some, which then decide nothing.
    sure : bool
        Whether the model is far off for certain. If not, it is if motions are explained then.
    few : bool
        Whether a few causes may explain what whole motions leave.
    """

    model: FarOffModel
    whole: Problem
    sure: bool
    few: bool


@dataclass(frozen=True, eq=False)
class RegressionStart:
    """What regression says before anything is searched for.

    Attributes
    ----------
    certain : sequence of (EffectInstance, (q,) array)
        What is missing for certain, with its sizes.
    far_off : FarOffStart or None
        What a search by whole motions begins with; None where little is missing.
    """

    certain: ActiveEffects
    far_off: FarOffStart | None


def start_of(
    problem: Problem, free: Ints, limits: FarOffLimits, settings: QuickSettings
) -> RegressionStart | None:
    """Find what a model lacks by regression.

    Parameters
    ----------
    problem : Problem
        Any, whose wiring fits.
    free : int array
        Indices of the declared parameters that are fitted.
    limits : FarOffLimits
        What is much.
    settings : QuickSettings
        Numbers that decide in the regression.

    Returns
    -------
    RegressionStart or None
        None where the robot or the data do not suit a regression.
    """
    simulator = robot_of(problem)
    if is_floating(simulator.model):  # motions through contacts are not replayed as a whole
        return None
    try:
        estimate = estimate_missing(problem, sides(problem, settings.checked)[0], settings)
    except (Incompatible, BadArgument):
        return None
    named = [one for one in estimate.numbers(simulator, settings.certain) if one.named]
    certain = () if chattering_sentences(problem) else as_effects(simulator, named)
    far_off = _far_off(problem, free, limits, settings, estimate, named)
    return RegressionStart(certain, far_off)


def _far_off(
    problem: Problem,
    free: Ints,
    limits: FarOffLimits,
    settings: QuickSettings,
    estimate: Missing,
    named: Sequence[FoundNumber],
) -> FarOffStart | None:
    """What a search by whole motions begins with, where much is missing."""
    simulator = robot_of(problem)
    sure = len(named) >= limits.numbers or abs(estimate.solution.gain) >= limits.gain
    if sure and not estimate.is_certain_gain(settings.certain):
        known = estimate.with_own_gain()
        if known.left <= limits.scale * estimate.left:
            count = known.certain_numbers(settings.certain)
            sure = count >= limits.numbers or abs(known.solution.gain) >= limits.gain
    if not sure and not _may_be(estimate, [one.effect for one in named], limits):
        return None
    space = simulator.space
    values = space.clip(simulator.nominal)
    numbers = []
    for instance, sizes in fixed_numbers(simulator, estimate):
        if not declared(simulator, instance, free):
            numbers.append((reaching(instance, sizes), sizes))
            continue
        for i, value in changed_parameters(simulator, instance, sizes).items():
            values[i] = np.clip(value, space.low[i], space.high[i])
    for effect in OF_ALL_DRIVES:
        numbers += _of_all_drives(simulator, effect, free, numbers)
    fitted, checked = sides(problem, settings.checked)
    whole = divided = replace(problem, trajectories=fitted, held_out=checked)
    if problem.held_out is not None:
        fitted, checked = sides(replace(problem, held_out=None), settings.checked)
        divided = replace(problem, trajectories=fitted, held_out=checked)
    few = len(named) < limits.many and abs(estimate.solution.gain) < limits.gain
    return FarOffStart(FarOffModel(divided, values, free, tuple(numbers)), whole, sure, few)


def _may_be(estimate: Missing, kinds: Sequence[str], limits: FarOffLimits) -> bool:
    """Whether several kinds of numbers explain most of forces that the model as it came leaves."""
    if len(set(kinds)) < limits.kinds:
        return False
    before = estimate.left_as_it_came
    return before > limits.forces and estimate.left < (1 - limits.explained) * before


def _of_all_drives(
    simulator: RobotSimulator, effect: str, free: Ints, numbers: ActiveEffects
) -> ActiveEffects:
    """An effect of all drives, of size 0, where neither it nor a partner is among the numbers."""
    either = (effect, PARTNERS.get(effect))
    if any(instance.effect in either for instance, _ in numbers):
        return ()
    every = list(instances_of(simulator.effect_context, effect))
    if not every or any(declared(simulator, instance, free) for instance in every):
        return ()
    # What acts on all of them stands behind the single ones.
    return ((every[-1], np.zeros(1)),)
