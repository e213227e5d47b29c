"""The simulator of a problem file: its model, motors, parameters, columns and effects."""

import importlib
from collections.abc import Sequence
from fnmatch import fnmatchcase
from pathlib import Path
from typing import cast

import mujoco

from dropo.core.services.files.file_content import FileContent, describe_value
from dropo.mjmodel.fields import (
    PREFIXES,
    Binding,
    FieldParameter,
    model_fields,
    option_fields,
)
from dropo.mjmodel.files.loading import load_model, specification
from dropo.mjmodel.files.motors import motor_of, mount
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
    source = _find_model(file)
    with file.at("model"):
        model = load_model(source, [entry.field for entry in content.parameters.values()])
    parameters = []
    for key, own in parameter_names(file, model).items():
        for name, element in own.items():
            with file.at(f"parameters.{key}"):
                parameters.append((key, _make_parameter(name, element, content.parameters[key])))
    _check_parameters(file, parameters, model)
    _check_columns(file, model)
    with file.at("model"):
        simulator = MujocoSimulator(
            source,
            [parameter for _, parameter in parameters],
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


def parameter_names(
    file: FileContent[ProblemFile], model: mujoco.MjModel
) -> dict[str, dict[str, str | tuple[str, ...] | None]]:
    """Name the parameters for which every entry stands.

    Parameters
    ----------
    file : FileContent[ProblemFile]
        The problem file.
    model : MjModel
        Its model.

    Returns
    -------
    dict
        By key, then by the name of each of its parameters, the element or elements. An entry of one
        element, or whose elements share the value, stands for the parameter of its key; any other
        for "ELEMENT_KEY" of each element.

    Raises
    ------
    BadFile
        If the model has no element of a name, or none that fits a pattern.
    """
    found: dict[str, dict[str, str | tuple[str, ...] | None]] = {}
    for key, entry in file.content.parameters.items():
        elements = _elements(file, key, entry, model)
        if entry.shared and elements is None:
            expected = "false where `name` is no list and no pattern"
            raise file.refusal(f"parameters.{key}.shared", expected, "true")
        if elements is None:
            found[key] = {key: cast("str | None", entry.name)}
        elif entry.shared:
            found[key] = {key: tuple(elements)}
        else:
            found[key] = {f"{element}_{key}": element for element in elements}
    return found


def _elements(
    file: FileContent[ProblemFile], key: str, entry: ParameterEntry, model: mujoco.MjModel
) -> list[str] | None:
    """The elements of a list or a pattern, in the model's order; None for a single name."""
    prefix, _, _ = entry.field.partition("_")
    names = element_names(model, PREFIXES[prefix]) if prefix in PREFIXES else {}
    if isinstance(entry.name, list):
        what = f"the name of a {PREFIXES.get(prefix, 'thing')}"
        for name in entry.name:
            file.require_known(f"parameters.{key}.name", name, names, what)
        return [name for name in names if name in entry.name]
    is_pattern = entry.name is not None and set(entry.name) & set("*?")
    if not is_pattern or entry.name in names or prefix not in PREFIXES:
        return None
    fitting = [name for name in names if fnmatchcase(name, str(entry.name))]
    if not fitting:
        expected = f"a pattern that fits a {PREFIXES[prefix]}: {', '.join(names) or 'none'}"
        raise file.refusal(f"parameters.{key}.name", expected, describe_value(entry.name))
    return fitting


def _make_parameter(
    name: str, element: str | tuple[str, ...] | None, entry: ParameterEntry
) -> FieldParameter:
    """The parameter of an element, or of several, that an entry describes."""
    return FieldParameter(
        name,
        entry.low,
        entry.high,
        entry.unit,
        field=entry.field,
        element=element,
        index=entry.index,
        relative=entry.target == "relative",
        derived=entry.derived == "follow",
    )


def _check_parameters(
    file: FileContent[ProblemFile],
    parameters: Sequence[tuple[str, FieldParameter]],
    model: mujoco.MjModel,
) -> None:
    """Refuse fields, elements and indices that the model lacks, and a number that is set twice.

    Each parameter comes with the key of its entry.
    """
    fields = [*model_fields(model), *option_fields(model)]
    before: list[FieldParameter] = []
    for entry, parameter in parameters:
        key = f"parameters.{entry}"
        what = "a field of MjModel or mjOption"
        file.require_known(f"{key}.field", parameter.field, fields, what)
        _check_element(file, key, parameter, model)
        with file.at(f"{key}.index"):
            Binding(parameter, model)
        same = next((other for other in before if _overlap(parameter, other)), None)
        if same is not None:
            expected = "a number that no other parameter sets"
            raise file.refusal(f"{key}.field", expected, f"the one of {same.name!r}")
        before.append(parameter)


def _check_element(
    file: FileContent[ProblemFile], entry: str, parameter: FieldParameter, model: mujoco.MjModel
) -> None:
    """Refuse the name of an element that the model lacks, or that the field has no place for."""
    key = f"{entry}.name"
    prefix, underscore, _ = parameter.field.partition("_")
    kind = PREFIXES.get(prefix) if underscore else None
    if kind is not None:
        names = element_names(model, kind)
        for element in _listed(parameter):
            file.require_known(key, element, names, f"the name of a {kind}")
    elif parameter.element is not None:
        expected = f"no name, since the field {parameter.field!r} has no elements"
        raise file.refusal(key, expected, describe_value(parameter.element))


def _listed(parameter: FieldParameter) -> tuple[str | None, ...]:
    """The elements of a parameter."""
    element = parameter.element
    return element if isinstance(element, tuple) else (element,)


def _overlap(one: FieldParameter, other: FieldParameter) -> bool:
    """Whether two parameters set the same number."""
    same_row = one.field == other.field and bool(set(_listed(one)) & set(_listed(other)))
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
