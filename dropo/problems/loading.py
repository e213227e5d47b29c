"""Problems by a built-in name or from a problem file, with their data checked."""

import inspect
from dataclasses import replace
from pathlib import Path
from typing import cast

from dropo.core.contracts.problem import Problem
from dropo.core.services.errors import BadArgument, BadFile
from dropo.core.services.registry import find, names
from dropo.core.services.validation import known
from dropo.problems.file.data_errors import find_data_error

INPUTS = ("commanded", "current")
"""Inputs of built-in problems that know several: the torque asked for, and the motors' current."""


def load(
    problem: str | Path,
    *,
    threads: int = 0,
    checked: bool = True,
    input: str | None = None,
    trusted: bool = True,
) -> Problem:
    """Load a built-in problem by its name, or the one that a YAML file describes.

    Parameters
    ----------
    problem : str or Path
        The name, or the path of the file; paths in the file are relative to it.
    threads : int
        Threads of the simulator; 0 for all cores.
    checked : bool
        Refuse data, held-out ones too, in which `dropo.check` finds an error.
    input : str or None
        Which of several logged commands drives the model, one of `inputs_of`; by default as the
        problem says.
    trusted : bool
        Import the Python functions that a problem file names under `task`, and the files under
        `plugins`. Without it the place of functions is kept, and a task that is used is refused;
        files are refused at once, unless this process has imported them as they are.

    Returns
    -------
    Problem
        Simulator, data, and how they are compared.

    Raises
    ------
    UnknownName
        If there is no built-in problem of that name.
    BadFile
        If something is wrong in the file or its data; the message names the key, what was
        expected, what was got, and the nearest valid name.
    BadArgument
        If the data of a built-in problem hold an error.
    """
    if is_file(problem):
        from dropo.problems.file.reader import read_problem

        read = read_problem(
            Path(problem), threads=threads, checked=checked, input=input, trusted=trusted
        )
        return replace(read, source=str(Path(problem).resolve()))
    refuse_folder(problem)
    make = find("problems", known("problem", str(problem), names("problems")))
    chosen = {} if input is None else {"input": known("input", input, inputs_of(problem))}
    found = cast(Problem, make(threads=threads, **chosen))
    if checked:
        _require_sound_data(found, str(problem))
    return replace(found, source=str(problem))


def load_states(problem: str | Path, *, threads: int = 0, trusted: bool = True) -> Problem:
    """Load what a problem says of the motion alone: all its data, without commands.

    Parameters
    ----------
    problem : str or Path
        A problem file, whose data need not hold actions, or a built-in name.
    threads : int
        Threads of the simulator; 0 for all cores.
    trusted : bool
        As of `load`.

    Returns
    -------
    Problem
        The model and the data with the columns that they hold. Velocities are not estimated.

    Raises
    ------
    UnknownName
        If there is no built-in problem of that name.
    BadFile
        If something is wrong in the file or its data.
    """
    if is_file(problem):
        from dropo.problems.file.reader import read_motion

        return read_motion(Path(problem), threads=threads, trusted=trusted)
    make = find("problems", known("problem", str(problem), names("problems")))
    found = cast(Problem, make(threads=threads))
    return replace(found, trajectories=found.everything or found.trajectories)


def refuse_folder(problem: str | Path) -> None:
    """Refuse a folder in the place of the problem file in it.

    Parameters
    ----------
    problem : str or Path
        As `load` takes it.

    Raises
    ------
    BadFile
        If it is a folder with a problem file and no built-in problem; the message names the file.
    """
    inside = Path(problem) / "problem.yaml"
    if str(problem) not in names("problems") and inside.is_file():
        raise BadFile(problem, "", "a problem file", f"a folder; give {inside}")


def is_file(problem: str | Path) -> bool:
    """Tell whether a problem file is meant, rather than a built-in name.

    Parameters
    ----------
    problem : str or Path
        As `load` takes it.

    Returns
    -------
    bool
        True for a path, for a name that ends in .yaml or .yml, and for any file that exists.
    """
    if isinstance(problem, Path):
        return True
    return problem.endswith((".yaml", ".yml")) or Path(problem).is_file()


def inputs_of(problem: str | Path) -> tuple[str, ...]:
    """Name the logged commands of a problem, where there are several.

    Parameters
    ----------
    problem : str or Path
        As `load` takes it.

    Returns
    -------
    tuple of str
        NAME of every `actions.NAME` in a file's data, or what a built-in problem takes.

    Raises
    ------
    UnknownName
        If there is no built-in problem of that name.
    BadFile
        If something is wrong in the problem file or its data.
    """
    if is_file(problem):
        from dropo.problems.file.reader import read_inputs

        return read_inputs(Path(problem))
    make = find("problems", known("problem", str(problem), names("problems")))
    return INPUTS if "input" in inspect.signature(make).parameters else ()


def _require_sound_data(problem: Problem, name: str) -> None:
    """Refuse a built-in problem whose data, as far as they are used, hold an error."""
    whole = problem.everything or problem.trajectories
    for key, trajectories in (("data", whole), ("held_out", problem.held_out)):
        error = find_data_error(trajectories, problem.simulator)
        if error is not None:
            raise BadArgument(f"{name}: {key}: {error}")
