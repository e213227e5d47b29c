"""What was guessed of a log: entries of a mapping, and a line with the reason of each."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from dropo.logs.guessing.words import ColumnName

NAMED = "its name says so"
"""Why a unit is taken."""
LISTED = 8
"""Columns that a line names."""


@dataclass
class Guess:
    """What was guessed.

    Attributes
    ----------
    mapping : dict
        The content of a mapping file.
    lines : list of str
        Every guess, with its reason.
    undecided : list of str
        What the names and numbers do not decide.
    drives : dict
        By joint what kind of command drives it, where the model has no actuators.
    sensor_units : dict
        By sensor why its unit was taken.
    """

    mapping: dict[str, Any] = field(default_factory=dict)
    lines: list[str] = field(default_factory=list)
    undecided: list[str] = field(default_factory=list)
    drives: dict[str, str] = field(default_factory=dict)
    sensor_units: dict[str, str] = field(default_factory=dict)


def quote(columns: Sequence[ColumnName]) -> str:
    """Write the names of columns, for a line.

    Parameters
    ----------
    columns : sequence of ColumnName
        The columns; the first `LISTED` are named.

    Returns
    -------
    str
        Their names, and how many more there are.
    """
    shown = ", ".join(repr(column.column) for column in columns[:LISTED])
    more = len(columns) - LISTED
    return f"{shown} and {more} more" if more > 0 else shown
