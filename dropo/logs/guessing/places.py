"""Which column is which joint: by the words that are left of its name, or by its number."""

import difflib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from dropo.logs.guessing.words import ColumnName, tokens


@dataclass(frozen=True)
class PlaceSettings:
    """From when on a column's name is that of a joint.

    Attributes
    ----------
    alike : float
        Fraction of two names that must be the same (Ratcliff and Obershelp).
    possible : float
        Fraction from which on a column may be a joint's, so that it is asked for.
    clear : float
        By how much the best joint of a column must be better than the second.
    """

    alike: float = 0.6
    possible: float = 0.4
    clear: float = 0.05


DEFAULTS = PlaceSettings()


def match(
    columns: Sequence[ColumnName], names: Sequence[str], settings: PlaceSettings = DEFAULTS
) -> tuple[dict[str, ColumnName], list[ColumnName]]:
    """Find which column belongs to which joint or actuator.

    Parameters
    ----------
    columns : sequence of ColumnName
        Of one quantity.
    names : sequence of str
        Joints or actuators, in the model's order.
    settings : PlaceSettings, optional
        How alike they must be.

    Returns
    -------
    found : dict
        By name its column.
    left : list of ColumnName
        Columns without a name, or which two names fit as well.
    """
    idle = _idle_words(columns, names)
    numbers = [_only_number(column, idle) for column in columns]
    found: dict[str, ColumnName] = {}
    if columns and None not in numbers:
        found = _by_number(dict(zip(numbers, columns, strict=True)), names)  # type: ignore[arg-type]
    else:
        found = _by_words(columns, names, idle, settings)
        pairs = zip(numbers, columns, strict=True)
        numbered = {number: column for number, column in pairs if number is not None}
        if not found and len(numbered) == len(names):
            found = _by_number(numbered, names)
        if not found and len(columns) == len(names) == 1:
            found = {names[0]: columns[0]}
    taken = {id(column) for column in found.values()}
    left = [column for column in columns if id(column) not in taken]
    return {name: found[name] for name in names if name in found}, left


def _by_words(
    columns: Sequence[ColumnName], names: Sequence[str], idle: set[str], settings: PlaceSettings
) -> dict[str, ColumnName]:
    """By name the column whose words are most alike, where that is clear."""
    scores = np.array([[likeness(column, name, idle) for name in names] for column in columns])
    found: dict[str, ColumnName] = {}
    if scores.size:
        rows, places = linear_sum_assignment(-scores)
        for i, j in zip(rows.tolist(), places.tolist(), strict=True):
            if scores[i, j] >= settings.alike and _is_clear(scores, i, j, settings):
                found[names[j]] = columns[i]
    return found


def _only_number(column: ColumnName, idle: set[str]) -> int | None:
    """The number of a column whose name says nothing else; None of others."""
    rest = [word for word in column.rest if word not in idle]
    return int(rest[0]) if len(rest) == 1 and rest[0].isdigit() else None


def _idle_words(columns: Sequence[ColumnName], names: Sequence[str]) -> set[str]:
    """Words that all columns have and no name: they tell none from another."""
    if len(columns) < 2:
        return set()
    common = set.intersection(*(set(column.rest) for column in columns))
    return common - {word for name in names for word in tokens(name)}


def _is_clear(scores: np.ndarray, i: int, j: int, settings: PlaceSettings) -> bool:
    """Whether no other name fits a column, and no other column the name, as well."""
    others = [*np.delete(scores[i], j), *np.delete(scores[:, j], i)]
    return scores[i, j] >= max(others, default=0.0) + settings.clear


def likeness(column: ColumnName, name: str, idle: set[str] | frozenset[str] = frozenset()) -> float:
    """Say how much the words left of a column are a name.

    Parameters
    ----------
    column : ColumnName
        The column.
    name : str
        Of a joint or actuator.
    idle : set of str
        Words that do not count.

    Returns
    -------
    float
        From 0 to 1.
    """
    wanted = tokens(name)
    rest = [word for word in column.rest if word not in idle]
    if not rest:
        return 0.0
    if rest == wanted:
        return 1.0
    one = set(rest)
    other = set(wanted)
    numbers = {word for word in one if word.isdigit()}
    if numbers and numbers != {word for word in other if word.isdigit()}:
        return 0.0
    if one <= other or other <= one:
        return 0.7 + 0.25 * len(one & other) / len(one | other)
    return 0.95 * difflib.SequenceMatcher(None, "".join(rest), "".join(wanted)).ratio()


def _by_number(columns: dict[int, ColumnName], names: Sequence[str]) -> dict[str, ColumnName]:
    """By name the column of its number, or at its place where columns count from 0 or 1."""
    own = {}
    for name in names:
        digits = [int(word) for word in tokens(name) if word.isdigit()]
        if len(digits) == 1:
            own[digits[0]] = name
    are_numbered = len(own) == len(names)
    if are_numbered and set(own) == set(columns):
        return {own[number]: column for number, column in columns.items()}
    places = sorted(columns)
    if len(places) == len(names) and places in (
        list(range(len(names))),
        list(range(1, 1 + len(names))),
    ):
        ordered = [own[number] for number in sorted(own)] if are_numbered else list(names)
        return {name: columns[place] for name, place in zip(ordered, places, strict=True)}
    from_zero = 0 in columns and 0 not in own
    if are_numbered and not from_zero:
        return {own[number]: column for number, column in columns.items() if number in own}
    return {}
