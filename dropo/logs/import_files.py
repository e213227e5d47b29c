"""The files that an import writes: data, a complete problem file, and a record."""

import hashlib
import json
from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from dropo.core.services.errors import BadFile
from dropo.core.services.files.atomic_write import atomic_write, write_json, write_npz, write_text
from dropo.core.services.files.places import way_to
from dropo.core.services.validation import Array
from dropo.logs.problem_text import format_problem, held_out_runs, segment_steps
from dropo.mjmodel.joints import ModelJoints

if TYPE_CHECKING:
    from dropo.logs.importing import Import

PROBLEM = "problem.yaml"
RECORD = "import.json"
SUM = "problem_sum"
"""In import.json the SHA-256 of the problem file as it was written."""
BEFORE = "before"
"""In import.json those of files as the import before wrote them, where it wrote others."""


def check_place(out: Path) -> None:
    """Refuse a place that is no .npz file, or beside which someone changed a problem file.

    Parameters
    ----------
    out : Path
        Of the data file.

    Raises
    ------
    BadFile
        If nothing may be written there.
    """
    if out.suffix != ".npz":
        raise BadFile(out, "--out", "a file that ends in .npz", repr(out.suffix))
    problem = out.parent / PROBLEM
    if problem.exists() and not is_as_written(problem, out.parent / RECORD, SUM):
        expected = (
            "no file, or one that an import wrote, since this one would be lost (move it, or "
            "import into another folder)"
        )
        raise BadFile(problem, "", expected, "one that was changed")


def sum_of(content: bytes) -> str:
    """Compute the checksum of a file.

    Parameters
    ----------
    content : bytes
        The file's content.

    Returns
    -------
    str
        SHA-256 in hexadecimal digits.
    """
    return hashlib.sha256(content).hexdigest()


def is_as_written(path: Path, record: Path, key: str) -> bool:
    """Tell whether a file is as the last import wrote it, or the one before.

    An import that is killed may have replaced the record alone.

    Parameters
    ----------
    path : Path
        The file.
    record : Path
        The import's import.json.
    key : str
        Under which the file's SHA-256 stands there.

    Returns
    -------
    bool
    """
    return sum_of(path.read_bytes()) in _written_sums(record, key)


def _written_sums(record: Path, key: str) -> list[str]:
    """The SHA-256 of a file as the last import wrote it, and as the one before did, where known."""
    try:
        content = json.loads(record.read_text())
        known = [content.get(key), content.get(BEFORE, {}).get(key)]
    except (OSError, ValueError, AttributeError):
        return []
    return [one for one in known if isinstance(one, str)]


def write_import(
    found: "Import",
    out: Path,
    model: str,
    robot: ModelJoints,
    command: str,
    facts: Mapping[str, Any] = MappingProxyType({}),
    files: Mapping[str, str] = MappingProxyType({}),
) -> None:
    """Write data, problem file and record, each whole; none where one cannot be written.

    Parameters
    ----------
    found : Import
        What an import made of the logs.
    out : Path
        The data file.
    model : str
        The model, by its path from there.
    robot : ModelJoints
        Its joints and actuators.
    command : str
        What writes them.
    facts : mapping
        More for import.json.
    files : mapping
        Other files by name, with their text.
    """
    out.parent.mkdir(parents=True, exist_ok=True)
    problem = _problem_text(found, out.name, model, robot, command, str(facts.get("robot", "")))
    record = found.to_json() | dict(facts) | {SUM: sum_of(problem.encode())}
    before = {}
    for key in (SUM, *facts):
        known = _written_sums(out.parent / RECORD, key)
        if key.endswith("_sum") and known and known[0] != record[key]:
            before[key] = known[0]
    if before:
        record[BEFORE] = before
    for rows in record["runs"].values():
        rows["log"] = way_to(rows["log"], out.parent)
    with ExitStack() as stack:
        # The record appears first, so that no file is there of which it does not know, then the
        # problem file, which tells that all others are an import's.
        names = (out.name, *files, PROBLEM, RECORD)
        parts = [stack.enter_context(atomic_write(out.parent / name)) for name in names]
        write_npz(parts[0], found.arrays)
        for part, text in zip(parts[1:-2], files.values(), strict=True):
            write_text(part, text)
        write_text(parts[-2], problem)
        write_json(parts[-1], record)


def _problem_text(
    found: "Import", data: str, model: str, robot: ModelJoints, command: str, name: str
) -> str:
    """The problem file."""
    content: dict[str, Any] = {"robot": name or robot.name} if name or robot.name else {}
    content |= {
        "model": model,
        "frame_skip": found.frame_skip,
        "data": data,
        "observation": found.observation,
        "action": found.action,
        "lambda": segment_steps(found.control_step, found.trajectories),
        "whole_runs": True,
        "start_noise": True,
    }
    estimated = _estimated(found)
    if estimated:
        content["estimated"] = estimated
    held_out = held_out_runs([run for run, rows in found.rows.items() if rows["trajectories"]])
    if held_out:
        content["held_out"] = {"runs": held_out}
    motion = _whole_states(found, robot)
    return format_problem(content, command, robot, _variances(found), motion, found.control_step)


def _estimated(found: "Import") -> dict[str, float]:
    """The velocities that were smoothed from positions, with the error of each."""
    return {
        name: float(f"{noise.sd:.3g}")
        for name, noise in found.noise.items()
        if noise.estimated and noise.sd is not None
    }


def _variances(found: "Import") -> dict[str, float]:
    """The variance of every signal's noise; empty where one is not known, or joints turn freely."""
    levels = {
        name: noise.sd
        for name, noise in found.noise.items()
        if name.startswith(("qpos", "qvel", "sensordata"))
    }
    known = {name: sd**2 for name, sd in levels.items() if sd is not None and sd > 0}
    turned = [name for name in known if "[" in name and not name.startswith("sensordata")]
    turned += [name for name in known if name.endswith("[3]")]  # of a quaternion
    are_whole = len(known) == len(levels) and not turned
    fields = ("qpos", "qvel", "sensordata")
    ordered = sorted(known, key=lambda name: fields.index(name.partition(".")[0]))
    return {name: known[name] for name in ordered} if are_whole else {}


def _whole_states(found: "Import", robot: ModelJoints) -> tuple[Array, Array] | None:
    """The rows of the longest trajectory as positions and velocities, where all were measured."""
    if found.observation[:2] != ["qpos", "qvel"]:
        return None
    longest = int(np.argmax(found.trajectories))
    first = sum(found.trajectories[:longest])
    rows = found.arrays["observations"][first : first + found.trajectories[longest]]
    nq, nv = robot.model.nq, robot.model.nv
    return rows[:, :nq], rows[:, nq : nq + nv]
