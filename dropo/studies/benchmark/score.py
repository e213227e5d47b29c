"""The score of answers to the benchmark: by strength, and where nothing is hidden."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from dropo.core.services.errors import BadFile
from dropo.core.services.files.saved_files import read_json
from dropo.studies.benchmark.answers import Answers, Cause
from dropo.studies.benchmark.sets import TRUTH, VERSION
from dropo.studies.engine.study import Table
from dropo.studies.hidden_effects.study import interval

STRENGTHS = (1.0, 3.0, 10.0, 30.0, 100.0, 1000.0, np.inf)
"""Bounds of the classes of strength [nats]."""
HEADER = (
    "strength [nats]",
    "sets",
    "answered",
    "named",
    "95 %",
    "alone",
    "or in the set",
    "nothing said",
    "others named",
    "error of the size",
)


@dataclass(frozen=True)
class EvaluatedAnswer:
    """One answer, held against the truth.

    Attributes
    ----------
    answered : bool
        Whether there is one.
    named : bool
        The hidden effect, or one that no data tell from it, is a cause, at its place.
    among : bool
        It is a cause, or among those that a cause is said to be confused with.
    others : bool
        Something else is a cause.
    silent : bool
        Nothing is.
    error : float or None
        Relative error of the first size, where the answer has it.
    """

    answered: bool
    named: bool
    among: bool
    others: bool
    silent: bool
    error: float | None


def read_truth(folder: Path, path: Path | None = None) -> dict[str, dict[str, Any]]:
    """Read what is hidden in each data set.

    Parameters
    ----------
    folder : Path
        What `write_sets` wrote.
    path : Path, optional
        The truth's file, where it was kept elsewhere.

    Returns
    -------
    dict
        By data set.

    Raises
    ------
    BadFile
        If there is none, or it is of another version.
    """
    place = path or folder / TRUTH
    content = read_json(place, "the truth of the benchmark, as `dropo benchmark write` makes it")
    if not isinstance(content, dict) or content.get("version") != VERSION:
        got = repr(content.get("version")) if isinstance(content, dict) else "no mapping"
        raise BadFile(place, "version", repr(VERSION), got)
    truths: dict[str, dict[str, Any]] = content["sets"]
    return truths


def evaluate_answer(truth: Mapping[str, Any], causes: Sequence[Cause] | None) -> EvaluatedAnswer:
    """Hold one answer against the truth.

    Parameters
    ----------
    truth : mapping
        Of the data set.
    causes : sequence of dict, or None
        The answer; None: there is none.

    Returns
    -------
    EvaluatedAnswer
    """
    if causes is None:
        return EvaluatedAnswer(False, False, False, False, False, None)
    same = {(effect, target) for effect, target in truth["same"]}
    own = [cause for cause in causes if (cause["effect"], cause.get("target")) in same]
    others = [cause for cause in causes if cause not in own]
    confused = {(effect, target) for cause in causes for effect, target in cause.get("or", [])}
    error = None
    for cause in own:
        if cause["effect"] == truth["effect"]:
            error = _error(truth["sizes"], cause.get("sizes", {}))
    return EvaluatedAnswer(
        answered=True,
        named=bool(own),
        among=bool(own) or bool(same & confused),
        others=bool(others),
        silent=not causes,
        error=error,
    )


def _error(true: Mapping[str, float], found: Mapping[str, float]) -> float | None:
    """Relative error of the first size; None where the answer lacks it."""
    first = next(iter(true))
    return abs(found[first] / true[first] - 1) if first in found else None


def score(truths: Mapping[str, Mapping[str, Any]], answers: Answers) -> tuple[Table, ...]:
    """Count what answers say, by strength and by machine.

    Parameters
    ----------
    truths : mapping
        By data set.
    answers : dict
        By data set; those left out count as not named.

    Returns
    -------
    tuple of Table
        Hidden effects by strength, by machine, and what is said where nothing is hidden.
    """
    evaluated = {name: evaluate_answer(truth, answers.get(name)) for name, truth in truths.items()}
    hidden = [name for name, truth in truths.items() if truth["effect"] is not None]
    rows = []
    for low, high in pairwise(STRENGTHS):
        own = [evaluated[name] for name in hidden if low <= truths[name]["nats"] < high]
        if own:
            bounds = f"{low:g} to {high:g}" if np.isfinite(high) else f"{low:g} and more"
            rows.append((bounds, *_cells(own)))
    rows.append(("all", *_cells([evaluated[name] for name in hidden])))
    return (
        Table("One effect hidden, by strength", HEADER, tuple(rows)),
        Table(
            "One effect hidden, by machine",
            ("machine", *HEADER[1:]),
            tuple(_by_machine(truths, evaluated, hidden)),
        ),
        Table(
            "Nothing hidden",
            ("machine", "sets", "answered", "nothing said", "95 %"),
            tuple(_of_nothing(truths, evaluated)),
        ),
    )


def _cells(evaluated: Sequence[EvaluatedAnswer]) -> tuple[str, ...]:
    """What is said of some sets with an effect."""
    count = len(evaluated)
    named = [one for one in evaluated if one.named]
    errors = [one.error for one in named if one.error is not None]
    low, high = interval(len(named), count)
    return (
        str(count),
        str(sum(one.answered for one in evaluated)),
        f"{len(named)}/{count}",
        f"{low:.0%}-{high:.0%}",
        f"{sum(not one.others for one in named)}/{count}",
        f"{sum(one.among for one in evaluated)}/{count}",
        f"{sum(one.silent for one in evaluated)}/{count}",
        f"{sum(one.others for one in evaluated)}/{count}",
        f"{np.median(errors):.2%}" if errors else "-",
    )


def _by_machine(
    truths: Mapping[str, Mapping[str, Any]],
    evaluated: Mapping[str, EvaluatedAnswer],
    hidden: Sequence[str],
) -> list[tuple[str, ...]]:
    """A row for each machine."""
    machines = list(dict.fromkeys(truths[name]["machine"] for name in hidden))
    return [
        (
            machine,
            *_cells([evaluated[name] for name in hidden if truths[name]["machine"] == machine]),
        )
        for machine in machines
    ]


def _of_nothing(
    truths: Mapping[str, Mapping[str, Any]], evaluated: Mapping[str, EvaluatedAnswer]
) -> list[tuple[str, ...]]:
    """A row for each machine, and one for all, of the sets in which nothing is hidden."""
    empty = [name for name, truth in truths.items() if truth["effect"] is None]
    machines = list(dict.fromkeys(truths[name]["machine"] for name in empty))
    rows: list[tuple[str, ...]] = []
    for machine in [*machines, "all"]:
        own = [evaluated[name] for name in empty if machine in ("all", truths[name]["machine"])]
        silent = sum(one.silent for one in own)
        low, high = interval(silent, len(own))
        answered = str(sum(one.answered for one in own))
        cells = (str(len(own)), answered, f"{silent}/{len(own)}", f"{low:.0%}-{high:.0%}")
        rows.append((machine, *cells))
    return rows
