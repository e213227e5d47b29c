"""The simulator of a problem file: its model, motors, parameters, columns and effects."""

import importlib
from collections.abc import Sequence
from pathlib import Path

import mujoco

from dropo.core.services.file_content import FileContent, describe_value
from dropo.mjmodel.fields import (
    PREFIXES,
    Binding,
    FieldParameter,
    model_fields,
    option_fields,
)
from dropo.mjmodel.loading import load_model, specification
from dropo.mjmodel.motors import motor_of, mount
from dropo.mjmodel.names import element_names
from dropo.mjmodel.observation import Layout
from dropo.problems.file.effects import read_effects
from dropo.problems.file.schema import (
    BUILT_IN_MODELS,
    MODEL,
    MotorEntry,
    ParameterEntry,
    ProblemFile,
)
from dropo.simulators.mujoco.simulator import MujocoSimulator, action_columns


def make_simulator(file: FileContent[ProblemFile], threads: int) -> MujocoSimulator:
    """Make the simulator of a problem file.

    Parameters
    ----------
    file : FileContent[ProblemFile]
        The problem file.
    threads : int
        Of the simulator, 0 for all cores.

    Returns
    -------
    MujocoSimulator
        With the file's parameters, columns and effects.

    Raises
    ------
    BadFile
        If the model cannot be used, or lacks what the file names.
    """
    content = file.content
    parameters = []
    for name, entry in content.parameters.items():
        with file.at(f"parameters.{name}"):
            parameters.append(_make_parameter(name, entry))
    source = _find_model(file)
    with file.at("model"):
        model = load_model(source, [parameter.field for parameter in parameters])
    _check_parameters(file, parameters, model)
    _check_columns(file, model)
    with file.at("model"):
        simulator = MujocoSimulator(
            source,
            parameters,
            observation=content.observation,
            action=content.action,
            frame_skip=content.frame_skip,
            threads=threads,
        )
    free, fixed = read_effects(file, simulator.effect_context)
    return simulator.with_effects(free, fixed) if free or fixed else simulator


def _find_model(file: FileContent[ProblemFile]) -> str | mujoco.MjSpec:
    """The path of an MJCF file, or the specification of a built-in model or one with motors."""
    name = file.content.model
    path = file.path.parent / name
    if _is_file(path):
        return _mount_motors(file, str(path)) if file.content.motors else str(path)
    if name not in BUILT_IN_MODELS:
        got = f"{describe_value(name)}, which is neither (no such file: {path})"
        raise file.refusal("model", MODEL, got)
    module, attribute = BUILT_IN_MODELS[name].split(":")
    return _mount_motors(file, getattr(importlib.import_module(module), attribute)())


def _is_file(path: Path) -> bool:
    """Whether there is such a file; a name too long for one is none."""
    try:
        return path.is_file()
    except OSError:
        return False


def _mount_motors(file: FileContent[ProblemFile], model: str | mujoco.MjSpec) -> mujoco.MjSpec:
    """The model with the motors that the file names by joint."""
    with file.at("model"):
        spec = specification(model)
    for joint, entry in file.content.motors.items():
        with file.at(f"motors.{joint}"):
            mount(spec, joint, motor_of(_motor_numbers(entry), joint))
    return spec


def _motor_numbers(entry: str | MotorEntry) -> object:
    """A motor's name in the library, or the numbers that the file gives."""
    return entry if isinstance(entry, str) else entry.model_dump(exclude_unset=True)


def _make_parameter(name: str, entry: ParameterEntry) -> FieldParameter:
    """The parameter that an entry describes."""
    return FieldParameter(
        name,
        entry.low,
        entry.high,
        entry.unit,
        field=entry.field,
        element=entry.name,
        index=entry.index,
        relative=entry.target == "relative",
        derived=entry.derived == "follow",
    )


def _check_parameters(
    file: FileContent[ProblemFile], parameters: Sequence[FieldParameter], model: mujoco.MjModel
) -> None:
    """Refuse fields, elements and indices that the model lacks, and a number that is set twice."""
    fields = [*model_fields(model), *option_fields(model)]
    before: list[FieldParameter] = []
    for parameter in parameters:
        key = f"parameters.{parameter.name}"
        what = "a field of MjModel or mjOption"
        file.require_known(f"{key}.field", parameter.field, fields, what)
        _check_element(file, parameter, model)
        with file.at(f"{key}.index"):
            Binding(parameter, model)
        same = next((other for other in before if _overlap(parameter, other)), None)
        if same is not None:
            expected = "a number that no other parameter sets"
            raise file.refusal(f"{key}.field", expected, f"the one of {same.name!r}")
        before.append(parameter)


def _check_element(
    file: FileContent[ProblemFile], parameter: FieldParameter, model: mujoco.MjModel
) -> None:
    """Refuse the name of an element that the model lacks, or that the field has no place for."""
    key = f"parameters.{parameter.name}.name"
    prefix, underscore, _ = parameter.field.partition("_")
    kind = PREFIXES.get(prefix) if underscore else None
    if kind is not None:
        names = element_names(model, kind)
        file.require_known(key, parameter.element, names, f"the name of a {kind}")
    elif parameter.element is not None:
        expected = f"no name, since the field {parameter.field!r} has no elements"
        raise file.refusal(key, expected, describe_value(parameter.element))


def _overlap(one: FieldParameter, other: FieldParameter) -> bool:
    """Whether two parameters set the same number."""
    same_row = (one.field, one.element) == (other.field, other.element)
    return same_row and (one.index == other.index or one.index is None or other.index is None)


def _check_columns(file: FileContent[ProblemFile], model: mujoco.MjModel) -> None:
    """Refuse items of observation and action that the model lacks, and a column named twice."""
    with file.at("observation"):
        names = Layout(model, file.content.observation).names
    twice = next((name for i, name in enumerate(names) if name in names[:i]), None)
    if twice is not None:
        raise file.refusal("observation", "each column once", f"{twice!r} twice")
    with file.at("action"):
        action_columns(model, file.content.action)
