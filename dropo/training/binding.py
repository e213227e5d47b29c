"""Where a law's parameters go in a simulator: by name, by their place in the model, or as the size
of an effect.
"""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from dropo.core.contracts.effect import ActiveEffects, EffectInstance
from dropo.core.records.parameters import Parameter
from dropo.core.services.errors import Incompatible, InvalidInput
from dropo.core.services.registry import find, names
from dropo.core.services.validation import Array, known
from dropo.mjmodel.fields import FieldParameter
from dropo.simulators.mujoco.simulator import MujocoSimulator
from dropo.training.distributions import ParameterDistribution, places_of


def bind(
    simulator: MujocoSimulator, distribution: ParameterDistribution, owner: str
) -> tuple[MujocoSimulator, Callable[[Array], Array]]:
    """The simulator, with the effects free whose sizes the law draws, and what makes its vectors
    (m, D) of the law's draws (m, d).

    What the law does not draw keeps its nominal value. Refused where the simulator lacks a
    parameter, or has it elsewhere.
    """
    declared = simulator.space.names
    sizes = [name for name in distribution.space.names if name not in declared]
    labels = dict.fromkeys(_label(name, simulator, owner) for name in sizes)
    free = (
        simulator.with_effects([_atom(label, simulator, owner) for label in labels])
        if labels
        else simulator
    )
    _refuse_moved(distribution, simulator, owner)
    columns = [
        free.space.names.index(known(f"parameter of {owner}", name, free.space.names))
        for name in distribution.space.names
    ]

    def fill(values: Array) -> Array:
        out = np.tile(np.asarray(free.nominal), (len(values), 1))
        out[:, columns] = values
        return out

    return free, fill


def field_parameters(distribution: ParameterDistribution, owner: str) -> list[FieldParameter]:
    """The law's parameters that are numbers of a model, to be declared in another simulator; sizes
    of effects are left out.
    """
    places = places_of(distribution)
    for p in distribution.space:
        if p.name not in places and "/" not in p.name:
            raise Incompatible(
                f"The fit does not say where in a model its parameter {p.name!r} is, so it "
                f"cannot be set in {owner}. Fit a problem"
                " whose simulator is a MujocoSimulator, and save it anew, or randomize "
                "that problem."
            )
    return [_field_parameter(p, places[p.name]) for p in distribution.space if p.name in places]


def _field_parameter(p: Parameter, place: Mapping[str, Any]) -> FieldParameter:
    return FieldParameter(
        p.name, p.low, p.high, p.unit, lower=p.lower, upper=p.upper, scale=p.scale, **place
    )


def declaring(
    model: Any,
    distribution: ParameterDistribution,
    owner: str,
    observation: tuple[str, ...],
    frame_skip: int,
    fixed: ActiveEffects,
) -> MujocoSimulator:
    """A simulator of a compiled model in which the law's numbers of the model are parameters, with
    fixed effects.
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
    """The label of the effect whose size a parameter is; UnknownName where it is none."""
    label, slash, _ = name.rpartition("/")
    effect = label.split(":")[0].split(".")[0]
    if not slash or effect not in names("effects"):
        known(f"parameter of {owner}", name, simulator.space.names)
    return label


def _atom(label: str, simulator: MujocoSimulator, owner: str) -> EffectInstance:
    effect = label.split(":")[0].split(".")[0]
    instances: dict[str, EffectInstance] = {
        instance.label: instance for instance in find("effects", effect)(simulator.effect_context)
    }
    return instances[known(f"effect in {owner}", label, instances)]


def _refuse_moved(
    distribution: ParameterDistribution, simulator: MujocoSimulator, owner: str
) -> None:
    """The same name must stand for the same number of the model."""
    places = places_of(distribution)
    for p in (binding.parameter for binding in simulator.bindings):
        here = p.place
        there = places.get(p.name, here) if p.name in distribution.space.names else here
        if there != here:
            differ = ", ".join(
                f"{key} {there.get(key)!r} instead of {here[key]!r}"
                for key in here
                if there.get(key) != here[key]
            )
            raise Incompatible(
                f"The fit is of another model: its parameter {p.name!r} has {differ} in "
                f"{owner}. Fit that problem."
            )
