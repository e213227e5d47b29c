"""What was guessed of a log: entries of a mapping, and a line with the reason of each."""

import json
import re
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
        What the names and numbers do not decide: questions.
    answers : dict
        Entries of a mapping that would answer these, with the first of the possible answers.
    drives : dict
        By joint what kind of command drives it, where the model has no actuators.
    sensor_units : dict
        By sensor why its unit was taken.
    """

    mapping: dict[str, Any] = field(default_factory=dict)
    lines: list[str] = field(default_factory=list)
    undecided: list[str] = field(default_factory=list)
    answers: dict[str, Any] = field(default_factory=dict)
    drives: dict[str, str] = field(default_factory=dict)
    sensor_units: dict[str, str] = field(default_factory=dict)

    def ask(self, question: str, answer: dict[str, Any]) -> None:
        """Note a question.

        Parameters
        ----------
        question : str
            What is not decided.
        answer : dict
            Entries of a mapping that would decide it.
        """
        self.undecided.append(question)
        for key, value in answer.items():
            if isinstance(value, dict):
                self.answers[key] = self.answers.get(key, {}) | value
            else:
                self.answers[key] = value


def in_one_line(content: object) -> str:
    """Write what a mapping file says in a line of YAML.

    Parameters
    ----------
    content : object
        Dictionaries, lists and texts.

    Returns
    -------
    str
        Texts of more than a word are in quotation marks.
    """
    if isinstance(content, dict):
        entries = [f"{in_one_line(key)}: {in_one_line(one)}" for key, one in content.items()]
        return f"{{{', '.join(entries)}}}"
    if isinstance(content, list):
        return f"[{', '.join(map(in_one_line, content))}]"
    text = str(content)
    return text if re.fullmatch(r"[A-Za-z]\w*", text) else json.dumps(text, ensure_ascii=False)


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
