"""Which column is which joint: by the words that are left of its name, or by its number."""

import difflib
from collections.abc import Sequence

import numpy as np
from scipy.optimize import linear_sum_assignment

from dropo.logs.guessing.words import ColumnName, tokens

ALIKE = 0.6
"""Share of two names that must be the same (Ratcliff and Obershelp)."""
CLEAR = 0.05
"""By how much the best joint of a column must be better than the second."""


def match(
    columns: Sequence[ColumnName], names: Sequence[str]
) -> tuple[dict[str, ColumnName], list[ColumnName]]:
    """Find which column belongs to which joint or actuator.

    Parameters
    ----------
    columns : sequence of ColumnName
        Of one quantity.
    names : sequence of str
        Joints or actuators, in the model's order.

    Returns
    -------
    found : dict
        By name its column.
    left : list of ColumnName
        Columns without a name, or which two names fit as well.
    """
    idle = _idle_words(columns, names)
    scores = np.array([[_likeness(column, name, idle) for name in names] for column in columns])
    found: dict[str, ColumnName] = {}
    if scores.size:
        rows, places = linear_sum_assignment(-scores)
        for i, j in zip(rows.tolist(), places.tolist(), strict=True):
            if scores[i, j] >= ALIKE and _is_clear(scores, i, j):
                found[names[j]] = columns[i]
    taken = {id(column) for column in found.values()}
    left = [column for column in columns if id(column) not in taken]
    if not found:
        found = _by_number(left, names)
        taken = {id(column) for column in found.values()}
        left = [column for column in left if id(column) not in taken]
    ordered = {name: found[name] for name in names if name in found}
    return ordered, left


def _idle_words(columns: Sequence[ColumnName], names: Sequence[str]) -> set[str]:
    """Words that all columns have and no name: they tell none from another."""
    if len(columns) < 2:
        return set()
    common = set.intersection(*(set(column.rest) for column in columns))
    return common - {word for name in names for word in tokens(name)}


def _is_clear(scores: np.ndarray, i: int, j: int) -> bool:
    """Whether no other name fits a column, and no other column the name, as well."""
    others = [*np.delete(scores[i], j), *np.delete(scores[:, j], i)]
    return scores[i, j] >= max(others, default=0.0) + CLEAR


def _likeness(column: ColumnName, name: str, idle: set[str]) -> float:
    """How much the words left of a column, without idle ones, are a name, from 0 to 1."""
    wanted = tokens(name)
    rest = [word for word in column.rest if word not in idle]
    if not rest:
        return 0.0
    if rest == wanted:
        return 1.0
    one, other = set(rest), set(wanted)
    numbers = {word for word in one if word.isdigit()}
    if numbers and numbers != {word for word in other if word.isdigit()}:
        return 0.0
    if one <= other or other <= one:
        return 0.7 + 0.25 * len(one & other) / len(one | other)
    likeness = difflib.SequenceMatcher(None, "".join(rest), "".join(wanted)).ratio()
    return 0.95 * likeness


def _by_number(columns: Sequence[ColumnName], names: Sequence[str]) -> dict[str, ColumnName]:
    """By name the column that stands at its place, where columns are numbered as many as names."""
    numbered = []
    for column in columns:
        numbers = [int(word) for word in column.rest if word.isdigit()]
        if len(numbers) == 1:
            numbered.append((numbers[0], column))
    numbered.sort(key=lambda pair: pair[0])
    places = [number for number, _ in numbered]
    begins_well = bool(places) and places == list(range(places[0], places[0] + len(names)))
    if len(numbered) == len(names) and begins_well and places[0] in (0, 1):
        return {name: column for name, (_, column) in zip(names, numbered, strict=True)}
    if len(columns) == len(names) == 1:
        return {names[0]: columns[0]}
    return {}
