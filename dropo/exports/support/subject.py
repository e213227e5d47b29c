"""What is exported: a robot at its fitted means, and how its parameters vary."""

import copy
import math
import re
import textwrap
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import mujoco
import numpy as np

from dropo.core.contracts.effect import ActiveEffects, EffectInstance
from dropo.core.contracts.problem import Problem
from dropo.core.records.fits.fit import Fit
from dropo.core.services.errors import DropoError, Incompatible
from dropo.core.services.tables import number
from dropo.core.services.validation import Array
from dropo.exports.support.distribution import FittedDistribution, distribution_of
from dropo.mjmodel.dynamics.drives import Drive
from dropo.mjmodel.fields import OPTION, Binding, first_row, owner_of
from dropo.mjmodel.names import actuator_names
from dropo.mjmodel.numbers import array_of, changed_numbers
from dropo.mjmodel.options import physics_step
from dropo.problems.file.plain_model import active_effects
from dropo.simulators.mujoco.model_xml import format_model, is_in_model
from dropo.simulators.mujoco.simulator import MujocoSimulator

LINEAR = 1e-9
"""Fraction of a number's change by which half a step may be off half of its change."""
LABEL = re.compile(r'(?<=\s)input="\w+" ?')
"""An attribute of actuators that MuJoCo 3 refuses."""
WIDTH = 98
"""Characters of a line in the header of a file."""
STEP = 1e-3
"""The least step at which the model is probed, as a fraction of a search interval."""


class CannotHold(DropoError):
    """A parameter for which a target has no place; the message says why."""


@dataclass(frozen=True)
class DrawnNumber:
    """A number of the model that follows one drawn parameter in proportion.

    Attributes
    ----------
    parameter : str
        The parameter's name.
    field : str
        An MjModel array, or an entry of mjOption with "opt." before it.
    place : tuple of int
        Where in the array.
    owner : (str, str) or None
        Kind and name of the element; None where it has none.
    row : tuple of int
        Where within the element's numbers; `place` where it has no name.
    mean : float
        The number at the means.
    slope : float
        How much it changes with the parameter.
    """

    parameter: str
    field: str
    place: tuple[int, ...]
    owner: tuple[str, str] | None
    row: tuple[int, ...]
    mean: float
    slope: float


@dataclass(frozen=True)
class Written:
    """What a target makes of a subject.

    Attributes
    ----------
    files : dict of str to (str or bytes)
        The content of each file by its name, the main one first.
    left_out, approximated : tuple of str
        What the target cannot hold, and what it holds otherwise, a sentence each.
    model : str
        The MJCF that belongs beside the files as model.xml, with meshes and textures; empty for
        none.
    """

    files: dict[str, str | bytes]
    left_out: tuple[str, ...] = ()
    approximated: tuple[str, ...] = ()
    model: str = ""


Target = Callable[["Subject"], Written]
"""A plug-in of kind "exports"."""


@dataclass(frozen=True, eq=False)
class Subject:
    """A robot at its fitted means, and how its parameters vary.

    Attributes
    ----------
    name : str
        The problem's.
    simulator : MujocoSimulator
        The model, its d declared parameters and its effects.
    values : (d,) array
        The means, in the order of the simulator's space.
    distribution : FittedDistribution or None
        The distribution of the parameters; None where none was fitted.
    approximated : tuple of str
        What of the distribution is not as in the fit, a sentence each.
    """

    name: str
    simulator: MujocoSimulator
    values: Array
    distribution: FittedDistribution | None
    approximated: tuple[str, ...] = ()

    @cached_property
    def effects(self) -> ActiveEffects:
        """All effects at their means, fixed ones first; the sizes of some may be 0."""
        sizes = iter(self.values[len(self.simulator.bindings) :].tolist())
        free = [
            (instance, np.array([next(sizes) for _ in instance.quantities]))
            for instance in self.simulator.effects
        ]
        return [*self.simulator.fixed, *free]

    @cached_property
    def active(self) -> ActiveEffects:
        """The effects that are present at the means."""
        return [pair for pair in self.effects if np.any(pair[1])]

    @cached_property
    def model(self) -> mujoco.MjModel:
        """The model at the means, with the effects that are numbers of it."""
        return self.simulator.model_of(self.values, self.active)

    @property
    def around(self) -> list[tuple[EffectInstance, Array]]:
        """The effects that are no numbers of the model."""
        return [pair for pair in self.active if not is_in_model(pair[0])]

    @cached_property
    def xml(self) -> str:
        """The model at the means as MJCF, with absolute paths of meshes and textures."""
        return format_model(self.simulator, self.values, self.active)

    @property
    def older_xml(self) -> str:
        """The same for tools with MuJoCo 3, where `input` of an actuator is a label alone."""
        text = LABEL.sub("", self.xml)
        models = (mujoco.MjModel.from_xml_string(one) for one in (self.xml, text))
        return text if set(changed_numbers(*models)) <= {"actuator_ctrlspec"} else self.xml

    @cached_property
    def actuators(self) -> list[str]:
        """The names of the actuators, in the model's order."""
        return actuator_names(self.model)

    def binding(self, name: str) -> Binding | None:
        """Find a declared parameter.

        Parameters
        ----------
        name : str
            The parameter's name.

        Returns
        -------
        Binding or None
            Where the parameter is in the model; None where it is a magnitude of an effect.
        """
        found = [one for one in self.simulator.bindings if one.parameter.name == name]
        return found[0] if found else None

    def sd(self, name: str) -> float:
        """Give how much a parameter varies, what is not known of its mean included.

        Parameters
        ----------
        name : str
            The parameter's name, one of the distribution's.

        Returns
        -------
        float
            The standard deviation in the parameter's unit, before draws are cut at bounds.

        Raises
        ------
        ValueError
            If the distribution has no such parameter.
        """
        return float(self._moments[1][self._distribution.names.index(name)])

    def mean(self, name: str) -> float:
        """Give the mean of a parameter.

        Parameters
        ----------
        name : str
            The parameter's name, one of the distribution's.

        Returns
        -------
        float
            The mean in the parameter's unit, before draws are cut at bounds.

        Raises
        ------
        ValueError
            If the distribution has no such parameter.
        """
        return float(self._moments[0][self._distribution.names.index(name)])

    @cached_property
    def _distribution(self) -> FittedDistribution:
        """The distribution, of no parameter where none was fitted."""
        none = np.zeros(0)
        empty = FittedDistribution((), "normal", False, none, np.zeros((0, 0)), none, none, none)
        return self.distribution or empty

    @cached_property
    def _moments(self) -> tuple[Array, Array]:
        """Means and standard deviations (d,) of the distribution, before it is cut at bounds."""
        distribution = self._distribution
        variance = {"uniform": 1 / 3, "truncated normal": CUT_VARIANCE}.get(distribution.kind, 1.0)
        spread = variance * (distribution.factor**2).sum(axis=1)
        mean = distribution.centre
        if distribution.logarithmic:
            mean = np.exp(distribution.centre + spread / 2)
            spread = mean**2 * np.expm1(spread)
        return mean, np.sqrt(spread + distribution.error**2)

    @cached_property
    def probed(self) -> tuple[list[DrawnNumber], list[str]]:
        """The numbers that follow drawn parameters in proportion, and the parameters of others."""
        found: list[DrawnNumber] = []
        others: list[str] = []
        for name in self._distribution.names:
            numbers = self._probe(name)
            if numbers:
                found += numbers
            else:
                others.append(name)
        return found, others

    def _probe(self, name: str) -> list[DrawnNumber]:
        """The numbers that follow one parameter; none where they do so otherwise."""
        column = self.simulator.space.names.index(name)
        parameter = self.simulator.space[column]
        step = max(self.sd(name), STEP * parameter.width)
        ends = np.clip(self.values[column] + np.array([-step, step]), *_bounds(parameter))
        low, half, high = (self._numbers_at(column, x) for x in (ends[0], ends.mean(), ends[1]))
        found = []
        for key in self._fields(column):
            change = high[key] - low[key]
            off = np.abs(half[key] - (low[key] + high[key]) / 2)
            if np.any(off > LINEAR * np.maximum(np.abs(change), np.abs(high[key]))):
                return []
            for at in np.argwhere(change != 0):
                place = tuple(map(int, at))
                owner = None
                row = place
                if place and not key.startswith(OPTION):
                    owner = owner_of(self.model, key, place[0])
                if owner is not None:
                    row = (place[0] - first_row(self.model, key, place[0]), *place[1:])
                slope = float(change[place] / (ends[1] - ends[0]))
                mean = float(array_of(self.model, key)[place])
                found.append(DrawnNumber(name, key, place, owner, row, mean, slope))
        return found

    def _fields(self, column: int) -> list[str]:
        """The fields that a parameter sets, without constants that MuJoCo derives."""
        bindings = self.simulator.bindings
        if column < len(bindings):
            entries = bindings[column].entries(self.simulator.model)
            return list(dict.fromkeys(name for name, _, _ in entries))
        name = self.simulator.space.names[column]
        own = []
        for pair in self.effects:
            names = [one.name for one in pair[0].parameters]
            if name in names and is_in_model(pair[0]):
                own.append(pair)
        return list(changed_numbers(self.model, changed_by(own, self.model)))

    def _numbers_at(self, column: int, value: float) -> dict[str, Array]:
        """The fields that a parameter sets where it has another value."""
        values = np.array(self.values)
        values[column] = value
        model = self.simulator.model_of(values, active_effects(self.simulator, values))
        return {key: np.array(array_of(model, key), dtype=float) for key in self._fields(column)}


CUT_VARIANCE = 1 - 4 * math.exp(-2) / math.sqrt(2 * math.pi) / math.erf(math.sqrt(2))
"""Variance of a standard normal distribution cut at two standard deviations."""


def _bounds(parameter: Any) -> tuple[float, float]:
    """What is physically possible."""
    return parameter.lower, parameter.upper


def changed_by(pairs: ActiveEffects, model: mujoco.MjModel) -> mujoco.MjModel:
    """Change a copy of a model by effects; constants that MuJoCo derives stay as they are.

    A magnitude of 0 is taken as `STEP`, so that all numbers that can change do.

    Parameters
    ----------
    pairs : sequence of (EffectInstance, (q,) array)
        Effects and their magnitudes, each in the unit of its quantity.
    model : mujoco.MjModel
        The model, which is left as it is.

    Returns
    -------
    mujoco.MjModel
        The changed copy.
    """
    changed = copy.copy(model)
    for instance, sizes in pairs:
        if instance.model is not None:
            instance.model(changed, np.where(sizes == 0, STEP, sizes))
    return changed


NO_SPREAD = (
    "Draws are left out: a diagnosis has no distribution. Fit extended/fit.yaml, and export "
    "that fit."
)
"""What targets say of an extended model."""


def remarks_of(left_out: Sequence[str], approximated: Sequence[str]) -> str:
    """Write sentences as the last paragraphs of a file's header.

    Parameters
    ----------
    left_out, approximated : sequence of str
        What the target cannot hold, and what it holds otherwise, a sentence each.

    Returns
    -------
    str
        A paragraph for each sentence, in lines of at most `WIDTH` characters; empty for none.
    """
    paragraphs = (textwrap.fill(sentence, WIDTH) for sentence in (*left_out, *approximated))
    return "".join(f"\n{paragraph}\n" for paragraph in paragraphs)


def describe(instance: EffectInstance, sizes: Array) -> str:
    """Write an effect with its sizes, such as "actuator_delay:elbow (delay 0.01 s)".

    Parameters
    ----------
    instance : EffectInstance
        The effect, with q quantities.
    sizes : (q,) array
        The magnitudes, in the quantities' units.

    Returns
    -------
    str
        The label, and each magnitude with four digits and its unit.
    """
    pairs = zip(instance.quantities, np.asarray(sizes).tolist(), strict=True)
    shares = [f"{q.name} {number(x, 4)} {q.unit}".removesuffix(" 1") for q, x in pairs]
    return f"{instance.label} ({', '.join(shares)})"


def effects_left_out(pairs: Sequence[tuple[EffectInstance, Array]], why: str) -> list[str]:
    """Say of each effect that it is left out, and why.

    Parameters
    ----------
    pairs : sequence of (EffectInstance, (q,) array)
        Effects and their magnitudes.
    why : str
        The reason, the end of a sentence without its full stop.

    Returns
    -------
    list of str
        A sentence for each effect.
    """
    return [f"{describe(instance, sizes)} is left out: {why}." for instance, sizes in pairs]


def delays_of(
    subject: Subject, drives: Sequence[Drive], approximated: list[str]
) -> tuple[dict[str, int], list[tuple[EffectInstance, Array]]]:
    """Find the delays of drives, for tools that delay commands by whole physics steps.

    Parameters
    ----------
    subject : Subject
        With its effects.
    drives : sequence of Drive
        Of its model.
    approximated : list of str
        To which a sentence is added for every delay.

    Returns
    -------
    delays : dict of str to int
        Physics steps, by joint.
    others : list of (EffectInstance, (q,) array)
        The effects beside the model that are no such delays.
    """
    delays: dict[str, int] = {}
    others = []
    step = physics_step(subject.model)
    for instance, sizes in subject.around:
        if instance.effect != "actuator_delay":
            others.append((instance, sizes))
            continue
        steps = round(float(sizes[0]) / step)
        for drive in drives:
            if drive.actuator is None:
                continue
            if instance.target in (None, subject.actuators[drive.actuator]):
                delays[drive.joint] = delays.get(drive.joint, 0) + steps
        approximated.append(
            f"{instance.label} is {steps} physics steps of {step:g} s, for {float(sizes[0]):.4g} s."
        )
    return delays, others


def others_left_out(subject: Subject, names: Sequence[str]) -> list[str]:
    """Say of parameters whose numbers do not follow in proportion that they keep their means.

    Parameters
    ----------
    subject : Subject
        What is exported.
    names : sequence of str
        The parameters.

    Returns
    -------
    list of str
        A sentence for each parameter.
    """
    return [
        f"The spread of {name} is left out: it is no number of a model, or several that do not "
        f"change in proportion; its mean {number(subject.mean(name), 4)} is kept."
        for name in names
    ]


def subject_of_fit(fit: Fit, problem: Problem) -> Subject:
    """Put a fit and what was fitted together.

    Parameters
    ----------
    fit : Fit
        The fit.
    problem : Problem
        What was fitted.

    Returns
    -------
    Subject

    Raises
    ------
    Incompatible
        If the problem has no MuJoCo model, or other parameters than the fit.
    """
    simulator = simulator_of(problem)
    ours, theirs = fit.space.names, simulator.space.names
    if ours != theirs:
        raise Incompatible(
            f"The fit has the parameters {', '.join(ours)}, and problem {problem.name!r} has "
            f"{', '.join(theirs) or 'none'}. Name the problem that was fitted."
        )
    for parameter in simulator.space:
        place = fit.model_places.get(parameter.name)
        if place is not None and place != parameter.place:
            raise Incompatible(
                f"The fit's parameter {parameter.name!r} is at another place of a model than that "
                f"of problem {problem.name!r}. Name the problem that was fitted."
            )
    distribution, approximated = distribution_of(fit)
    return Subject(problem.name, simulator, fit.mean, distribution, approximated)


def simulator_of(problem: Problem) -> MujocoSimulator:
    """Give the simulator of a problem, if it has a model that can be written.

    Parameters
    ----------
    problem : Problem
        The problem.

    Returns
    -------
    MujocoSimulator
        Its simulator.

    Raises
    ------
    Incompatible
        If the simulator has no MuJoCo model.
    """
    simulator = problem.simulator
    if not isinstance(simulator, MujocoSimulator):
        raise Incompatible(
            f"{type(simulator).__name__} of problem {problem.name!r} has no MuJoCo model to export."
        )
    return simulator
