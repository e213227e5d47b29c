"""The key `task` of a problem file: what a policy is to do, as Python functions."""

import importlib
import importlib.util
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from dropo.core.records.task import Task
from dropo.core.records.trajectories import Trajectories
from dropo.core.services.errors import BadEntry, BadFile
from dropo.core.services.files.file_content import FileContent, describe_value
from dropo.core.services.files.places import way_to
from dropo.core.services.validation import Array
from dropo.problems.file.schema import FUNCTION, ProblemFile, TaskEntry
from dropo.simulators.mujoco.simulator import MujocoSimulator

FUNCTIONS = ("reward", "alive", "starts")
"""Entries of a task that name Python functions."""


def make_task(
    file: FileContent[ProblemFile],
    simulator: MujocoSimulator,
    data: Trajectories,
    *,
    trusted: bool,
) -> Task | None:
    """Make the task that a problem file names.

    Parameters
    ----------
    file : FileContent[ProblemFile]
        The problem file.
    simulator : MujocoSimulator
        Its simulator.
    data : Trajectories
        Its recordings, in whose start states episodes begin where the file names no others.
    trusted : bool
        Whether the functions that are named may be imported.

    Returns
    -------
    Task or None
        None where the file names none. Where it is not trusted, a task that is refused when it is
        used.

    Raises
    ------
    BadFile
        If a function that is named cannot be imported, or makes no task.
    """
    entry = file.content.task
    if entry is None:
        return None
    if not trusted:
        return _refused_task(file, entry)
    if isinstance(entry, str):
        return replace(_call(file, entry), source=_absolute(file.path, entry))
    functions = _import_functions(file, entry)
    functions.setdefault("starts", start_as_measured(simulator, data))
    source = _source(file.path, entry)
    return Task(**functions, steps=entry.steps, bonus=entry.bonus, source=source)


def start_as_measured(
    simulator: MujocoSimulator, data: Trajectories
) -> Callable[[np.random.Generator, int], Array]:
    """Make episodes begin where one of the recordings did.

    Parameters
    ----------
    simulator : MujocoSimulator
        Its model has nq positions and nv velocities.
    data : Trajectories
        The recordings.

    Returns
    -------
    callable
        starts(rng, n) -> (n, nq + nv); what is not observed is at the model's qpos0, or at rest.
    """
    layout = simulator.layout
    model = simulator.model
    rows = data.observations[[first for first, _ in data.spans]]
    states = layout.full_states(rows, model)
    kept = states[:, 1 : 1 + model.nq + model.nv]
    return lambda rng, n: kept[rng.integers(len(kept), size=n)]


def _refused_task(file: FileContent[ProblemFile], entry: str | TaskEntry) -> Task:
    """A task in the place of one whose functions may not be imported."""
    text = entry if isinstance(entry, str) else entry.reward

    def refuse(*_: object) -> NoReturn:
        raise BadEntry(
            file.path,
            "task",
            f"{text!r} is Python code, which runs only where it is trusted: give --trust, or "
            "load the problem in Python.",
        )

    steps = 1 if isinstance(entry, str) else entry.steps
    return Task(reward=refuse, starts=refuse, steps=steps, source=_source(file.path, entry))


def _source(path: Path, entry: str | TaskEntry) -> Any:
    """How a problem file in another folder names the task."""
    if isinstance(entry, str):
        return _absolute(path, entry)
    source = entry.model_dump(exclude_unset=True)
    for name in FUNCTIONS:
        if name in source:
            source[name] = _absolute(path, source[name])
    return source


def locate_from(source: Any, folder: Path) -> Any:
    """Name the Python files of a task by their way from a folder, which may move with them.

    Parameters
    ----------
    source : Any
        `Task.source` of a task that a problem file names.
    folder : Path
        Where the problem file is going to be.

    Returns
    -------
    Any
        The same with relative paths.
    """
    if isinstance(source, dict):
        return {
            name: locate_from(text, folder) if name in FUNCTIONS else text
            for name, text in source.items()
        }
    module, _, name = str(source).rpartition(":")
    if not module.endswith(".py"):
        return source
    return f"{way_to(module, folder)}:{name}"


def _import_functions(file: FileContent[ProblemFile], entry: TaskEntry) -> dict[str, Any]:
    """The functions that an entry names."""
    functions = {}
    for name in FUNCTIONS:
        text = getattr(entry, name)
        if text is not None:
            functions[name] = _import(file, f"task.{name}", text)
    return functions


def _import(file: FileContent[ProblemFile], key: str, text: str) -> Any:
    """What "module:name" or "file.py:name" stands for."""
    module, _, name = text.rpartition(":")
    if not (module and name):
        raise file.refusal(key, FUNCTION, describe_value(text))
    try:
        if module.endswith(".py"):
            return getattr(_import_file(file.path.parent / module), name)
        return getattr(importlib.import_module(module), name)
    except Exception as error:  # whatever the code behind it raises
        sentence = f"expected {FUNCTION}; {text!r} cannot be used: {error}"
        raise BadEntry(file.path, key, sentence) from None


def _call(file: FileContent[ProblemFile], text: str) -> Task:
    """The task that is named, or what the function makes that is named."""
    named = _import(file, "task", text)
    try:
        task = named() if callable(named) and not isinstance(named, Task) else named
    except Exception as error:  # whatever the function raises
        raise BadEntry(file.path, "task", f"{text!r} makes no task: {error}") from None
    if not isinstance(task, Task):
        expected = "a Task, or a function that returns one"
        raise file.refusal("task", expected, f"a {type(task).__name__}")
    return task


def _import_file(path: Path) -> Any:
    """The module in a Python file."""
    if not path.is_file():
        raise BadFile(path, "", "a Python file", "no such file")
    spec = importlib.util.spec_from_file_location(f"task_{path.stem}", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def _absolute(path: Path, text: str) -> str:
    """The same name in a problem file in another folder."""
    module, _, name = text.rpartition(":")
    return f"{(path.parent / module).resolve()}:{name}" if module.endswith(".py") else text
