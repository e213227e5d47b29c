"""Finds where a distribution's parameters are in a simulator.

A parameter is found by its name, by its place in the model, or as the magnitude of an effect.
"""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from dropo.core.contracts.effect import ActiveEffects, EffectInstance, instances_of
from dropo.core.records.parameters import Parameter
from dropo.core.services.errors import Incompatible, InvalidInput
from dropo.core.services.registry import names
from dropo.core.services.validation import Array, known
from dropo.mjmodel.fields import FieldParameter
from dropo.simulators.mujoco.simulator import MujocoSimulator
from dropo.training.distributions import ParameterDistribution, places_of


def bind(
    simulator: MujocoSimulator, distribution: ParameterDistribution, owner: str
) -> tuple[MujocoSimulator, Callable[[Array], Array]]:
    """Prepares a simulator for draws of a distribution.

    Parameters
    ----------
    simulator : MujocoSimulator
        The simulator.
    distribution : ParameterDistribution
        A distribution of d parameters, which the simulator declares or whose effects it can have.
    owner : str
        What is simulated, for messages.

    Returns
    -------
    simulator : MujocoSimulator
        The simulator with D parameters: its own, and the magnitudes of effects that are drawn.
    fill : callable
        Parameter vectors (m, D) of that simulator from draws (m, d). What is not drawn keeps its
        nominal value.

    Raises
    ------
    UnknownName
        If the simulator has no such parameter or effect.
    Incompatible
        If a parameter is at another place of its model.
    """
    declared = simulator.space.names
    magnitudes = [name for name in distribution.space.names if name not in declared]
    # the effects' labels, each once, in the order of the parameters
    labels = dict.fromkeys(_label(name, simulator, owner) for name in magnitudes)
    extended = simulator
    if labels:
        extended = simulator.with_effects([_instance(label, simulator, owner) for label in labels])
    _check_places(distribution, simulator, owner)
    columns = []
    for name in distribution.space.names:
        known(f"parameter of {owner}", name, extended.space.names)
        columns.append(extended.space.names.index(name))

    def fill(values: Array) -> Array:
        filled = np.tile(np.asarray(extended.nominal), (len(values), 1))
        filled[:, columns] = values
        return filled

    return extended, fill


def field_parameters(distribution: ParameterDistribution, owner: str) -> list[FieldParameter]:
    """Return a distribution's parameters that are numbers of a model.

    They can be declared in another simulator. Magnitudes of effects are left out.

    Parameters
    ----------
    distribution : ParameterDistribution
        The distribution.
    owner : str
        Where they are to be set, for the message.

    Returns
    -------
    list of FieldParameter
        The parameters, in the order of the distribution's space.

    Raises
    ------
    Incompatible
        If a fit does not say where in a model a parameter is.
    """
    places = places_of(distribution)
    parameters = []
    for parameter in distribution.space:
        if parameter.name in places:
            parameters.append(_field_parameter(parameter, places[parameter.name]))
        elif "/" not in parameter.name:
            raise Incompatible(
                f"The fit does not say where in a model its parameter {parameter.name!r} is, so it "
                f"cannot be set in {owner}. Fit a problem whose simulator is a MujocoSimulator, "
                "and save it anew, or randomize that problem."
            )
    return parameters


def _field_parameter(p: Parameter, place: Mapping[str, Any]) -> FieldParameter:
    """Returns a parameter at a place of a model."""
    return FieldParameter(
        p.name, p.low, p.high, p.unit, lower=p.lower, upper=p.upper, scale=p.scale, **place
    )


def declare(
    model: Any,
    distribution: ParameterDistribution,
    owner: str,
    observation: tuple[str, ...],
    frame_skip: int,
    fixed: ActiveEffects,
) -> MujocoSimulator:
    """Return a simulator of a compiled model that declares a distribution's parameters.

    Parameters
    ----------
    model : mujoco.MjModel
        The compiled model.
    distribution : ParameterDistribution
        A distribution whose parameters are numbers of the model or magnitudes of effects. The
        latter are not declared.
    owner : str
        What is simulated, for messages.
    observation : tuple of str
        The columns of an observation row.
    frame_skip : int
        Physics steps for which one action is held.
    fixed : sequence of (EffectInstance, array)
        Effects with fixed magnitudes.

    Returns
    -------
    MujocoSimulator
        The simulator, on one thread.

    Raises
    ------
    Incompatible
        If a fit does not say where in a model a parameter is, or the model has no such place.
    """
    parameters = field_parameters(distribution, owner)
    try:
        simulator = MujocoSimulator(
            model, parameters, observation=observation, frame_skip=frame_skip, threads=1
        )
    except InvalidInput as error:
        raise Incompatible(f"The fit's parameters do not fit {owner}: {error}") from None
    return simulator.with_effects((), fixed) if fixed else simulator


def _label(name: str, simulator: MujocoSimulator, owner: str) -> str:
    """Returns the label of the effect whose magnitude a parameter is; refuses where it is none."""
    label, slash, _ = name.rpartition("/")
    if not slash or _effect(label) not in names("effects"):
        known(f"parameter of {owner}", name, simulator.space.names)
    return label


def _effect(label: str) -> str:
    """Returns the name of the effect in a label."""
    return label.split(":")[0].split(".")[0]


def _instance(label: str, simulator: MujocoSimulator, owner: str) -> EffectInstance:
    """Returns the effect instance with a label; refuses where the simulator has none."""
    instances: dict[str, EffectInstance] = {}
    for instance in instances_of(simulator.effect_context, _effect(label)):
        instances[instance.label] = instance
    return instances[known(f"effect in {owner}", label, instances)]


def _check_places(
    distribution: ParameterDistribution, simulator: MujocoSimulator, owner: str
) -> None:
    """The same name must stand for the same number of the model."""
    places = places_of(distribution)
    for binding in simulator.bindings:
        parameter = binding.parameter
        here = parameter.place
        if parameter.name not in distribution.space.names or parameter.name not in places:
            continue
        there = places[parameter.name]
        if there == here:
            continue
        differences = ", ".join(
            f"{key} {there.get(key)!r} instead of {here[key]!r}"
            for key in here
            if there.get(key) != here[key]
        )
        raise Incompatible(
            f"The fit is of another model: its parameter {parameter.name!r} has {differences} in "
            f"{owner}. Fit that problem."
        )
