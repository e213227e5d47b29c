"""Problems by a built-in name or from a YAML file: model, data, columns and parameters, all checked
before anything runs.
"""

import importlib
import inspect
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal, cast

import mujoco
import numpy as np

from dropo.core.contracts.prior import read_prior
from dropo.core.contracts.problem import Problem
from dropo.core.contracts.simulator import Simulator
from dropo.core.records.trajectories import Reset, Trajectories
from dropo.core.services.errors import BadArgument
from dropo.core.services.registry import find, names
from dropo.core.services.strict_yaml import BadEntry, Entries, read_yaml
from dropo.core.services.validation import Array, known
from dropo.data.checks.check import outside_control_range, verdict
from dropo.data.reading import MINARI, read
from dropo.data.reading import inputs_of as beside
from dropo.mjmodel.fields import PREFIXES, Binding, FieldParameter, model_fields, option_fields
from dropo.mjmodel.loading import load_model, specification
from dropo.mjmodel.motors import motor_of, mount
from dropo.mjmodel.names import element_names
from dropo.mjmodel.observation import Layout
from dropo.problems.file.effect_entries import read_effects
from dropo.problems.file.estimated_velocities import with_velocities
from dropo.problems.file.task_entries import read_task
from dropo.simulators.mujoco.simulator import MujocoSimulator, action_columns

KEYS = (
    "model",
    "frame_skip",
    "data",
    "observation",
    "action",
    "parameters",
    "epsilon",
    "start_noise",
    "student_t",
    "lambda",
    "reset",
    "held_out",
    "transitions",
    "effects",
    "motors",
    "task",
    "input",
)
PARAMETER_KEYS = ("field", "name", "index", "low", "high", "unit", "target", "derived", "prior")
MODELS = {"hopper": "dropo.problems.hopper.model:hopper_spec"}
"""Models of built-in problems, by the name that `model:` takes: functions that return an MjSpec."""
INPUTS = ("commanded", "current")
"""Of built-in problems that know both: the torque that was asked for, and the one from the motors'
current.
"""
RESETS = "'transition', 'start', or {set: [observation items]}"


def load(
    problem: str | Path, *, threads: int = 0, checked: bool = True, input: str | None = None
) -> Problem:
    """A built-in problem by its name, or the one that a YAML file describes; paths in it are
    relative to it.

    threads: of the simulator, 0 for all cores. checked: refuse data in which `dropo.check` finds an
    error, held-out ones too.
    input: which of several logged commands drives the model, one of `inputs_of`; None: as the
    problem says. UnknownName for a name that does not exist; BadFile for what is wrong in the file
    or its data, with the key, what was expected, what came, and the nearest valid name.
    """
    if is_file(problem):
        return _from_file(Path(problem), threads, checked, input)
    known("problem", str(problem), names("problems"))
    chosen = {} if input is None else {"input": known("input", input, inputs_of(problem))}
    found = cast(Problem, find("problems", str(problem))(threads=threads, **chosen))
    for key, trajectories in (
        (("data", found.everything or found.trajectories), ("held_out", found.held_out))
        if checked
        else ()
    ):
        error = _error(trajectories, found.simulator)
        if error is not None:
            raise BadArgument(f"{problem}: {key}: {error}")
    return found


def load_states(problem: str | Path, *, threads: int = 0) -> Problem:
    """Load what a problem says of the motion alone: all data of its `data` entry, with actions of
    0.

    Parameters
    ----------
    problem : str or Path
        A problem file, whose data need not hold actions, or a built-in name.
    threads : int
        Of the simulator, 0 for all cores.

    Returns
    -------
    Problem
        The model and the data with the columns that they hold. Velocities are not estimated.

    Raises
    ------
    BadFile
        As for `load`.
    """
    if not is_file(problem):
        known("problem", str(problem), names("problems"))
        found = cast(Problem, find("problems", str(problem))(threads=threads))
        return replace(found, trajectories=found.everything or found.trajectories)
    path = Path(problem)
    entries = read_yaml(path, KEYS, "a problem file")
    frame_skip = cast(int, entries.whole("frame_skip", 1, 1))
    simulator = _simulator(entries, frame_skip, threads)
    trajectories = _read(entries, "data", simulator, None, zero_actions=True)
    error = _error(trajectories, simulator)
    if error is not None:
        raise BadEntry(path, "data", error)
    return Problem(path.stem, simulator, trajectories)


def is_file(problem: str | Path) -> bool:
    """Whether `problem` means a YAML file rather than a built-in name."""
    return (
        isinstance(problem, Path) or problem.endswith((".yaml", ".yml")) or Path(problem).is_file()
    )


def inputs_of(problem: str | Path) -> tuple[str, ...]:
    """The logged commands of a problem by name, where there are several: `actions.NAME` in its
    data, or what a built-in one takes.
    """
    if is_file(problem):
        entries = read_yaml(Path(problem), KEYS, "a problem file")
        return beside(next(iter(_sources(entries, "data").values())))
    made = find("problems", known("problem", str(problem), names("problems")))
    return INPUTS if "input" in inspect.signature(made).parameters else ()


def _from_file(path: Path, threads: int, checked: bool, input: str | None) -> Problem:
    entries = read_yaml(path, KEYS, "a problem file")
    if input is None and "input" in entries:
        input = entries.text("input", "the name of a logged command, where the data hold several")
    frame_skip = entries.whole("frame_skip", 1, 1)
    length = entries.whole("lambda", 1, 1)
    simulator = _simulator(entries, cast(int, frame_skip), threads)
    fitted, held_out = _data(entries, simulator, input)
    for key, trajectories in (("data", fitted), ("held_out", held_out)) if checked else ():
        error = _error(trajectories, simulator)
        if error is not None:
            raise BadEntry(path, key, error)
    reset, set_columns = _reset(entries, simulator)
    epsilon = _epsilon(entries, simulator)
    warnings = _warnings(fitted, simulator)
    priors = _priors(entries, simulator)
    start_noise = _start_noise(entries)
    degrees = _degrees(entries)
    with entries.blaming("lambda"):
        problem = Problem(
            path.stem,
            simulator,
            fitted,
            length=cast(int, length),
            reset=reset,
            set_columns=set_columns,
            epsilon=epsilon,
            start_noise=start_noise,
            noise_degrees=degrees,
            held_out=held_out,
            warnings=warnings,
            priors=priors,
            task=read_task(entries, simulator, fitted),
        )
    return with_velocities(problem)


# The model and what is fitted in it


def _simulator(entries: Entries, frame_skip: int, threads: int) -> MujocoSimulator:
    parameters = _parameters(entries)
    source = _model(entries)
    with entries.blaming("model"):
        model = load_model(source, [p.field for p in parameters])
    _check_parameters(entries, parameters, model)
    observation = entries.texts(
        "observation", ("qpos", "qvel"), "a list of items such as [qpos, qvel]"
    )
    action = entries.texts("action", ("ctrl",), "a list of items such as [ctrl]")
    with entries.blaming("observation"):
        layout = Layout(model, observation)
    twice = next((name for i, name in enumerate(layout.names) if name in layout.names[:i]), None)
    if twice is not None:
        raise entries.bad("observation", "each column once", f"{twice!r} twice")
    with entries.blaming("action"):
        action_columns(model, action)
    simulator = MujocoSimulator(
        source,
        parameters,
        observation=observation,
        action=action,
        frame_skip=frame_skip,
        threads=threads,
    )
    free, fixed = read_effects(entries, simulator.effect_context)
    return simulator.with_effects(free, fixed) if free or fixed else simulator


def _model(entries: Entries) -> str | mujoco.MjSpec:
    """The path of an MJCF file, or the spec of a built-in model."""
    expected = f"an MJCF file, or the name of a built-in model ({', '.join(MODELS)})"
    name = entries.text("model", expected)
    path = entries.path.parent / name
    if path.is_file():
        return _with_motors(entries, str(path)) if "motors" in entries else str(path)
    if name not in MODELS:
        raise entries.bad("model", expected, f"{name!r}, which is neither (no such file: {path})")
    module, attribute = MODELS[name].split(":")
    return _with_motors(entries, getattr(importlib.import_module(module), attribute)())


def _with_motors(entries: Entries, model: str | mujoco.MjSpec) -> mujoco.MjSpec:
    """The model with the motors that `motors` names by joint, each from the library or with its
    numbers.
    """
    level = entries.level(
        "motors", what="a mapping from joints to motors, such as {shoulder: ak80-6}"
    )
    with entries.blaming("model"):
        spec = specification(model)
    for joint, value in level.content.items():
        with level.blaming(joint):
            mount(spec, joint, motor_of(value, joint))
    return spec


def _parameters(entries: Entries) -> list[FieldParameter]:
    level = entries.level("parameters", what="a mapping from names to parameters")
    return [
        _parameter(level.level(name, PARAMETER_KEYS, "a mapping with field, low and high"), name)
        for name in level.content
    ]


def _parameter(entry: Entries, name: str) -> FieldParameter:
    field = entry.text("field", "a field of MjModel or mjOption, such as body_mass")
    element = entry.text("name", "the name of an element") if "name" in entry else None
    low = entry.number("low")
    high = entry.number("high")
    if low >= high:
        raise entry.bad("low", f"a number below high = {high:g}")
    unit = entry.text("unit", "a text, such as kg") if entry.content.get("unit", "") != "" else ""
    relative = entry.choice("target", ("absolute", "relative"), "a known target") == "relative"
    derived = entry.choice("derived", ("follow", "keep"), "what derived constants do") == "follow"
    return FieldParameter(
        name,
        low,
        high,
        unit,
        field=field,
        element=element,
        index=entry.whole("index", 0, None),
        relative=relative,
        derived=derived,
    )


def _priors(entries: Entries, simulator: Simulator) -> dict[str, str]:
    """The priors of the parameters that name one."""
    out = {}
    for parameter in simulator.space:
        entry = entries.level("parameters").level(parameter.name)
        if "prior" in entry:
            out[parameter.name] = entry.text("prior", "a text such as 'normal(3.5, 0.2)'")
            with entry.blaming("prior"):
                read_prior(out[parameter.name], parameter)
    return out


def _check_parameters(
    entries: Entries, parameters: Iterable[FieldParameter], model: mujoco.MjModel
) -> None:
    """Every field, element and index must be the model's, and no number of it may be set twice."""
    valid = [*model_fields(model), *option_fields(model)]
    before: list[FieldParameter] = []
    for parameter in parameters:
        entry = entries.level("parameters").level(parameter.name)
        entry.known("field", parameter.field, valid, "a field of MjModel or mjOption")
        _check_element(entry, parameter, model)
        with entry.blaming("index"):
            Binding(parameter, model)
        same = next((other for other in before if _overlap(parameter, other)), None)
        if same is not None:
            raise entry.bad(
                "field", "a number that no other parameter sets", f"the one of {same.name!r}"
            )
        before.append(parameter)


def _check_element(entry: Entries, parameter: FieldParameter, model: mujoco.MjModel) -> None:
    kind = PREFIXES.get(parameter.field.split("_")[0]) if "_" in parameter.field else None
    if kind is not None:
        entry.known("name", parameter.element, element_names(model, kind), f"the name of a {kind}")
    elif parameter.element is not None:
        raise entry.bad("name", f"no name, since the field {parameter.field!r} has no elements")


def _overlap(one: FieldParameter, other: FieldParameter) -> bool:
    same_row = (one.field, one.element) == (other.field, other.element)
    return same_row and (one.index == other.index or one.index is None or other.index is None)


# The data


def _data(
    entries: Entries, simulator: MujocoSimulator, input: str | None
) -> tuple[Trajectories, Trajectories | None]:
    """The trajectories to fit and those held out."""
    everything = _read(entries, "data", simulator, input)
    fitted = everything
    held_out = None
    value = entries.content.get("held_out")
    if (
        isinstance(value, list)
        and value
        and all(isinstance(i, int) and not isinstance(i, bool) for i in value)
    ):
        fitted, held_out = _split(entries, everything, value)
    elif "held_out" in entries:
        held_out = _read(
            entries,
            "held_out",
            simulator,
            input,
            "a list of trajectory numbers, or data as in `data`",
        )
    count = entries.whole("transitions", 1, None)
    return (fitted if count is None else fitted.head(count)), held_out


def _sources(
    entries: Entries, key: str, expected: str = "a file, a folder or a list of them"
) -> dict[str, str | Path]:
    """The data that an entry names, as it does, and where they are."""
    value = entries.content.get(key)
    listed: list[Any] = value if isinstance(value, list) else [value]
    if not listed or not all(isinstance(item, str) and item for item in listed):
        raise entries.bad(key, expected)
    return {
        item: item if item.startswith(MINARI) else entries.path.parent / item for item in listed
    }


def _read(
    entries: Entries,
    key: str,
    simulator: MujocoSimulator,
    input: str | None,
    *expected: str,
    zero_actions: bool = False,
) -> Trajectories:
    listed = _sources(entries, key, *expected)
    columns = len(simulator.controls) if zero_actions else None
    trajectories = read(list(listed.values()), input=input, zero_actions=columns)
    have = {
        "observation": trajectories.observations.shape[1],
        "action": trajectories.actions.shape[1],
    }
    for what, want in (("observation", len(simulator.layout)), ("action", len(simulator.controls))):
        if have[what] != want:
            raise entries.bad(
                key,
                f"{want} {what} columns, as the {what} items give",
                f"{have[what]} in {', '.join(listed)}",
            )
    return trajectories


def _split(
    entries: Entries, everything: Trajectories, numbers: list[int]
) -> tuple[Trajectories, Trajectories]:
    last = len(everything.spans) - 1
    wrong = next((i for i in numbers if not 0 <= i <= last), None)
    if wrong is not None:
        raise entries.bad("held_out", f"trajectory numbers from 0 to {last}", str(wrong))
    rest = sorted(set(range(last + 1)) - set(numbers))
    if not rest:
        raise entries.bad("held_out", "some trajectories left to fit", f"all {last + 1} of them")
    return everything.select(rest), everything.select(numbers)


def _error(trajectories: Trajectories | None, simulator: Simulator) -> str | None:
    """Why a fit of the data cannot work, what to do, and how to go on all the same; None where
    nothing is in its way.
    """
    found = None if trajectories is None else verdict(trajectories, simulator)
    text = "" if found is None else f"{found.signal}: {found.sentence} {found.advice}".strip()
    return (
        f"{text} If they are right all the same: --unchecked, or load(..., checked=False)."
        if text
        else None
    )


def _warnings(trajectories: Trajectories, simulator: Simulator) -> tuple[str, ...]:
    return tuple(
        f"{finding.signal}: {finding.sentence}"
        for finding in outside_control_range(trajectories, simulator)
    )


# How segments are cut and compared


def _reset(entries: Entries, simulator: MujocoSimulator) -> tuple[Reset, Any]:
    """The reset mode, and for `partial` which columns are set."""
    value = entries.content.get("reset", "transition")
    if value == "start" and "lambda" in entries:
        raise entries.bad(
            "lambda", "none with `reset: start`, where a segment is a whole trajectory"
        )
    if value in ("transition", "start"):
        return cast(Literal["transition", "start"], value), None
    if not isinstance(value, dict):
        raise entries.bad("reset", RESETS)
    level = entries.level("reset", ("set",))
    items = level.texts("set", (), "a list of observation items such as [qpos]")
    with level.blaming("set"):
        chosen = simulator.layout.places_of(items, simulator.model)
        named = Layout(simulator.model, items)
    missing = sorted(set(named.names) - set(simulator.layout.names))
    if missing:
        raise level.bad("set", "columns that the observation holds", ", ".join(missing))
    return "partial", chosen


def _epsilon(entries: Entries, simulator: MujocoSimulator) -> float | Array | None:
    """The noise variance: one number, one for each signal in order, or by the signals' names."""
    value = entries.content.get("epsilon")
    signals = [signal.name for signal in simulator.signals]
    if "epsilon" not in entries:
        return None
    if isinstance(value, dict):
        level = entries.level("epsilon")
        for name in value:
            level.known(name, name, signals, "a signal")
        missing = [name for name in signals if name not in value]
        if missing:
            raise entries.bad(
                "epsilon",
                f"a variance for each of the {len(signals)} signals",
                f"none for {', '.join(missing)}",
            )
        return np.array([level.variance(name, value[name]) for name in signals])
    if isinstance(value, list):
        if len(value) != len(signals):
            raise entries.bad(
                "epsilon",
                f"one number, or one for each of the {len(signals)} signals",
                f"{len(value)} numbers",
            )
        return np.array([entries.variance("epsilon", number) for number in value])
    return entries.variance("epsilon", value)


def _start_noise(entries: Entries) -> bool:
    value = entries.content.get("start_noise", False)
    if not isinstance(value, bool):
        raise entries.bad(
            "start_noise", "true, where the measured start states carry the noise too, or false"
        )
    return value


def _degrees(entries: Entries) -> float | None:
    """nu of the Student t."""
    if "student_t" not in entries:
        return None
    value = entries.content["student_t"]
    if isinstance(value, bool) or not isinstance(value, int | float) or not 2 < value < np.inf:
        raise entries.bad("student_t", "degrees of freedom, a number above 2")
    return float(value)
