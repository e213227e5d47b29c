"""Answers to the benchmark: the file, what is refused in it, and those of dropo itself."""

from pathlib import Path
from typing import Any

from dropo import Diagnose, Diagnosis
from dropo.core.contracts.problem import Problem
from dropo.core.services.errors import BadFile
from dropo.core.services.files.saved_files import read_json
from dropo.core.services.validation import nearest
from dropo.problems.loading import load
from dropo.studies.benchmark.sets import PROTOCOL, VERSION
from dropo.studies.engine.work import Work

KEYS = ("version", "name", "answers")
CAUSE_KEYS = ("effect", "target", "sizes", "or")
Cause = dict[str, Any]
"""effect, target (null: the whole machine), sizes {quantity: value}, or [[effect, target], ...]."""
Answers = dict[str, list[Cause]]
"""The causes that are named in each data set; an empty list says that nothing is missing."""


def read_answers(path: Path, protocol: dict[str, Any]) -> tuple[str, Answers]:
    """Read the file of anyone's answers.

    Parameters
    ----------
    path : Path
        {"version": ..., "name": ..., "answers": {set: [{"effect": ..., "target": ...}, ...]}}.
    protocol : dict
        What `write_sets` wrote.

    Returns
    -------
    name : str
        Who answers.
    answers : dict
        By data set; a set that is left out is not answered.

    Raises
    ------
    BadFile
        If the file is none, or answers by a set, effect, target or quantity that does not exist;
        the message names the nearest one.
    """
    content = read_json(path, "answers to the benchmark")
    _require_keys(path, "", content, KEYS, KEYS)
    if content["version"] != protocol["version"]:
        raise BadFile(path, "version", repr(protocol["version"]), repr(content["version"]))
    name = content["name"]
    if not isinstance(name, str) or not name:
        raise BadFile(path, "name", "the method's name", repr(name))
    answers = content["answers"]
    if not isinstance(answers, dict):
        raise BadFile(path, "answers", "a mapping from data sets to lists of causes", repr(answers))
    for own, causes in answers.items():
        key = f"answers.{own}"
        machine = protocol["sets"].get(own)
        if machine is None:
            _refuse_name(path, "answers", "a data set", own, list(protocol["sets"]))
        if not isinstance(causes, list):
            raise BadFile(path, key, "a list of causes, empty where nothing is missing", causes)
        for i, cause in enumerate(causes):
            _check_cause(path, f"{key}.{i}", cause, protocol["targets"][machine])
    return name, answers


def read_protocol(folder: Path) -> dict[str, Any]:
    """Read what a folder of data sets says of them.

    Parameters
    ----------
    folder : Path

    Returns
    -------
    dict

    Raises
    ------
    BadFile
        If there is none, or it is of another version of the benchmark.
    """
    path = folder / PROTOCOL
    content = read_json(path, "the protocol of the benchmark, as `dropo benchmark write` makes it")
    _require_keys(path, "", content, ("version", "sets", "targets"), ())
    if content["version"] != VERSION:
        raise BadFile(path, "version", repr(VERSION), repr(content["version"]))
    protocol: dict[str, Any] = content
    return protocol


def _check_cause(path: Path, key: str, cause: Any, targets: dict[str, list[str | None]]) -> None:
    """Refuse a cause that the machine cannot have."""
    _require_keys(path, key, cause, ("effect",), CAUSE_KEYS)
    _check_place(path, key, cause["effect"], cause.get("target"), targets)
    sizes = cause.get("sizes", {})
    numbers = isinstance(sizes, dict) and all(
        isinstance(size, int | float) and not isinstance(size, bool) for size in sizes.values()
    )
    if not numbers:
        raise BadFile(path, f"{key}.sizes", "a mapping from quantities to numbers", repr(sizes))
    others = cause.get("or", [])
    if not isinstance(others, list):
        raise BadFile(path, f"{key}.or", "a list of [effect, target]", repr(others))
    for i, other in enumerate(others):
        if not (isinstance(other, list) and len(other) == 2):
            raise BadFile(path, f"{key}.or.{i}", "[effect, target]", repr(other))
        _check_place(path, f"{key}.or.{i}", other[0], other[1], targets)


def _check_place(
    path: Path, key: str, effect: Any, target: Any, targets: dict[str, list[str | None]]
) -> None:
    """Refuse an effect that does not exist, or that cannot be there."""
    if not isinstance(effect, str) or effect not in targets:
        _refuse_name(path, f"{key}.effect", "an effect of this machine", effect, list(targets))
    places = targets[effect]
    if target not in places:
        shown = [place for place in places if place is not None]
        if not shown:
            rule = f"none, as {effect} is of the whole machine"
            raise BadFile(path, f"{key}.target", rule, repr(target))
        _refuse_name(path, f"{key}.target", f"a place of {effect}", target, shown)


def _require_keys(
    path: Path, key: str, content: Any, needed: tuple[str, ...], possible: tuple[str, ...]
) -> None:
    """Refuse what is no mapping, lacks a key, or has one that means nothing."""
    if not isinstance(content, dict):
        raise BadFile(path, key, f"a mapping with {', '.join(needed)}", type(content).__name__)
    for name in needed:
        if name not in content:
            raise BadFile(path, f"{key}.{name}".strip("."), "an entry", "none")
    for name in content if possible else ():
        if name not in possible:
            _refuse_name(path, key, "a key", name, list(possible))


def _refuse_name(path: Path, key: str, what: str, name: Any, valid: list[str]) -> None:
    """Refuse a name, with the nearest valid one."""
    raise BadFile(path, key, what, f"{name!r}. {nearest(name, valid)}".rstrip("."))


# --- dropo's own


def answer_all(work: Work, folder: Path) -> dict[str, Any]:
    """Diagnose every data set of a folder, knowing no more than its files say.

    Parameters
    ----------
    work : Work
        Runs the diagnoses.
    folder : Path
        What `write_sets` wrote.

    Returns
    -------
    dict
        The content of a file of answers.
    """
    sets = list(read_protocol(folder)["sets"])
    files = [str(folder / "sets" / name / "problem.yaml") for name in sets]
    found = work.map(diagnosed, files)
    answers = {name: one["causes"] for name, one in zip(sets, found, strict=True)}
    return {"version": VERSION, "name": "dropo diagnose", "answers": answers}


def diagnosed(path: str) -> dict[str, Any]:
    """Diagnose one problem file, with every setting as it comes.

    Parameters
    ----------
    path : str

    Returns
    -------
    dict
        causes as a file of answers has them, verdict, steps.
    """
    return answer_of(load(path, threads=1))


def answer_of(problem: Problem) -> dict[str, Any]:
    """Diagnose a problem, and write down what is said of it.

    Parameters
    ----------
    problem : Problem
        A data set of the benchmark.

    Returns
    -------
    dict
        The causes as an answer has them, the verdict, and the number of simulator steps.
    """
    found: Diagnosis = Diagnose().run(problem, rng=0)
    return {
        "causes": causes_of(found),
        "verdict": found.verdict,
        "steps": found.simulator_steps,
    }


def causes_of(found: Diagnosis) -> list[Cause]:
    """Make the answer of a diagnosis.

    Parameters
    ----------
    found : Diagnosis

    Returns
    -------
    list of dict
        Its stated causes that are effects; a formula, which has no name of its own, is left out.
    """
    causes = []
    for cause in found.stated:
        if cause.formula:
            continue
        others = [[other.effect, other.target] for other in cause.confused_with]
        sizes = {name: estimate.value for name, estimate in cause.estimate.items()}
        causes.append(
            {"effect": cause.effect, "target": cause.target, "sizes": sizes, "or": others}
        )
    return causes
