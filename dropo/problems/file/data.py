"""The measured data that a problem file names: those to fit, and those held out."""

from fnmatch import fnmatchcase
from pathlib import Path
from typing import TypeGuard, cast

from dropo.core.records.trajectories import Trajectories
from dropo.core.services.files.file_content import FileContent
from dropo.data.reading import MINARI, read, run_names
from dropo.problems.file.schema import HeldOutEntry, ProblemFile
from dropo.simulators.mujoco.simulator import MujocoSimulator


def read_data(
    file: FileContent[ProblemFile], simulator: MujocoSimulator, input: str | None
) -> tuple[Trajectories, Trajectories | None]:
    """Read the data of a problem file.

    Parameters
    ----------
    file : FileContent[ProblemFile]
        The problem file.
    simulator : MujocoSimulator
        Its simulator, which says how many columns the data have.
    input : str or None
        Which of several logged commands are the actions.

    Returns
    -------
    fitted, held_out
        The trajectories to fit, and those that no fit sees, where there are some.

    Raises
    ------
    BadFile
        If data are missing, cannot be read or have other columns.
    """
    content = file.content
    fitted = _read(file, "data", content.data, simulator, input)
    held_out = None
    if _are_numbers(content.held_out):
        fitted, held_out = _split(file, fitted, content.held_out)
    elif isinstance(content.held_out, HeldOutEntry):
        numbers = _numbers_of_runs(file, content.held_out.runs)
        fitted, held_out = _split(file, fitted, numbers, "held_out.runs")
    elif content.held_out is not None:
        named = cast("str | list[str]", content.held_out)
        held_out = _read(file, "held_out", named, simulator, input)
    if content.transitions is not None:
        fitted = fitted.head(content.transitions)
    return fitted, held_out


def read_run_names(
    file: FileContent[ProblemFile], fitted: Trajectories, held_out: Trajectories | None
) -> tuple[str, ...]:
    """Name the run of every trajectory, those held out last.

    Parameters
    ----------
    file : FileContent[ProblemFile]
        The problem file.
    fitted, held_out : Trajectories
        As `read_data` gives them.

    Returns
    -------
    tuple of str
        Empty where the data name no runs.

    Raises
    ------
    BadFile
        If `reference` has a pattern that no run's name fits.
    """
    content = file.content
    names = _names_in(file, content.data)
    entry = content.held_out
    apart: list[str] = []
    if _are_numbers(entry) or isinstance(entry, HeldOutEntry):
        numbers = _numbers_of_runs(file, entry.runs) if isinstance(entry, HeldOutEntry) else entry
        apart = [names[i] for i in sorted(set(numbers))]
        names = [name for i, name in enumerate(names) if i not in set(numbers)]
    elif held_out is not None:
        apart = _names_in(file, cast("str | list[str]", entry))
    names = [*names[: len(fitted.spans)], *apart]
    if not any(names):
        return ()
    for pattern in content.reference:
        if not any(fnmatchcase(name, pattern) for name in names):
            file.require_known("reference", pattern, dict.fromkeys(names), "the name of a run")
    return tuple(names)


def _names_in(file: FileContent[ProblemFile], named: str | list[str]) -> list[str]:
    """The run of every trajectory of data that a problem file names."""
    return [name for place in locate_data(file, named).values() for name in run_names(place)]


def read_states(file: FileContent[ProblemFile], simulator: MujocoSimulator) -> Trajectories:
    """Read all data of the entry `data`, with actions of 0 whether or not it holds any.

    Parameters
    ----------
    file : FileContent[ProblemFile]
        The problem file.
    simulator : MujocoSimulator
        Its simulator, which says how many columns the data have.

    Returns
    -------
    Trajectories
        As they stand, with actions of 0.

    Raises
    ------
    BadFile
        If data are missing, cannot be read or have other columns.
    """
    return _read(file, "data", file.content.data, simulator, None, zero_actions=True)


def locate_data(file: FileContent[ProblemFile], named: str | list[str]) -> dict[str, str | Path]:
    """Find where data are that a problem file names.

    Parameters
    ----------
    file : FileContent[ProblemFile]
        The problem file, whose folder paths are relative to.
    named : str or list of str
        One or several of them.

    Returns
    -------
    dict
        The place of each, by what the file calls it: a path, or the name of a Minari data set.
    """
    listed = [named] if isinstance(named, str) else named
    folder = file.path.parent
    return {name: name if name.startswith(MINARI) else folder / name for name in listed}


def _are_numbers(held_out: object) -> TypeGuard[list[int]]:
    """Whether trajectories are held out by number, rather than other data."""
    return isinstance(held_out, list) and isinstance(held_out[0], int)


def _read(
    file: FileContent[ProblemFile],
    key: str,
    named: str | list[str],
    simulator: MujocoSimulator,
    input: str | None,
    *,
    zero_actions: bool = False,
) -> Trajectories:
    """The data under a key, with as many columns as the items give."""
    places = locate_data(file, named)
    columns = len(simulator.controls) if zero_actions else None
    trajectories = read(list(places.values()), input=input, zero_actions=columns)
    for what, wanted, columns in (
        ("observation", len(simulator.layout), trajectories.observations.shape[1]),
        ("action", len(simulator.controls), trajectories.actions.shape[1]),
    ):
        if columns != wanted:
            expected = f"{wanted} {what} columns, as the {what} items give"
            raise file.refusal(key, expected, f"{columns} in {', '.join(places)}")
    return trajectories


def _numbers_of_runs(file: FileContent[ProblemFile], patterns: list[str]) -> list[int]:
    """The numbers of the trajectories of runs, by name or pattern."""
    names = _names_in(file, file.content.data)
    found = []
    for pattern in patterns:
        fitting = [
            i for i, name in enumerate(names) if name == pattern or fnmatchcase(name, pattern)
        ]
        if not fitting:
            file.require_known("held_out.runs", pattern, dict.fromkeys(names), "the name of a run")
        found += fitting
    return sorted(set(found))


def _split(
    file: FileContent[ProblemFile],
    everything: Trajectories,
    numbers: list[int],
    key: str = "held_out",
) -> tuple[Trajectories, Trajectories]:
    """The trajectories without and with the numbers given."""
    last = len(everything.spans) - 1
    wrong = next((number for number in numbers if not 0 <= number <= last), None)
    if wrong is not None:
        raise file.refusal(key, f"trajectory numbers from 0 to {last}", str(wrong))
    rest = sorted(set(range(last + 1)) - set(numbers))
    if not rest:
        raise file.refusal(key, "some trajectories left to fit", f"all {last + 1} of them")
    return everything.select(rest), everything.select(numbers)
