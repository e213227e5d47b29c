"""The key `task` of a problem file: what a policy is to do, as Python functions named by module or
by file.
"""

import importlib
import importlib.util
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from dropo.core.records.task import Task
from dropo.core.records.trajectories import Trajectories
from dropo.core.services.errors import BadFile
from dropo.core.services.strict_yaml import BadEntry, Entries
from dropo.core.services.validation import Array
from dropo.simulators.mujoco.simulator import MujocoSimulator

KEYS = ("reward", "alive", "starts", "steps", "bonus")
EXPECTED = "a function as module:name, or file.py:name beside the problem file"
STEPS = 500


def read_task(entries: Entries, simulator: MujocoSimulator, data: Trajectories) -> Task | None:
    """The task that a problem file names: a function that makes one, or a mapping with its reward."""
    value = entries.content.get("task")
    if "task" not in entries:
        return None
    if isinstance(value, str):
        task = _made(entries, value)
        if not isinstance(task, Task):
            raise entries.bad(
                "task", "a Task, or a function that returns one", f"a {type(task).__name__}"
            )
        return task
    level = entries.level("task", KEYS, f"a mapping with reward, or {EXPECTED}")
    found = {
        name: _function(level, name, level.text(name, EXPECTED))
        for name in ("reward", "alive", "starts")
        if name in level
    }
    if "reward" not in found:
        raise level.bad("reward", EXPECTED)
    steps = level.whole("steps", 1, STEPS)
    bonus = level.number("bonus") if "bonus" in level else 0.0
    found.setdefault("starts", measured_starts(simulator, data))
    source = {
        **level.content,
        **{name: _absolute(entries.path, level.content[name]) for name in found if name in level},
    }
    return Task(**found, steps=steps or STEPS, bonus=bonus, source=source)


def measured_starts(
    simulator: MujocoSimulator, data: Trajectories
) -> Callable[[np.random.Generator, int], Array]:
    """Episodes begin where one of the recordings did; what is not observed, at the model's qpos0 or
    at rest.
    """
    model = simulator.model
    rows = data.observations[[first for first, _ in data.spans]]
    states = simulator.layout.full_states(rows, model)
    kept = states[:, 1 : 1 + model.nq + model.nv]
    return lambda rng, n: kept[rng.integers(len(kept), size=n)]


def _function(entries: Entries, key: str, text: str) -> Any:
    """What "module:name" or "file.py:name" stands for."""
    module, colon, name = text.rpartition(":")
    if not (colon and module and name):
        raise entries.bad(key, EXPECTED)
    try:
        return getattr(
            _from_file(entries.path.parent / module)
            if module.endswith(".py")
            else importlib.import_module(module),
            name,
        )
    except Exception as error:  # whatever the code behind it raises
        raise BadEntry(
            entries.path, entries.key(key), f"expected {EXPECTED}; {text!r} cannot be used: {error}"
        ) from None


def _made(entries: Entries, text: str) -> Any:
    """The task that is named, or what the function makes that is named."""
    named = _function(entries, "task", text)
    try:
        return named() if callable(named) and not isinstance(named, Task) else named
    except Exception as error:  # whatever the function raises
        raise BadEntry(entries.path, "task", f"{text!r} makes no task: {error}") from None


def _from_file(path: Path) -> Any:
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
