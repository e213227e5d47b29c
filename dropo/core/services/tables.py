"""Tables of text, and reports: results that print themselves."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from html import escape
from typing import Any

import numpy as np

LATEX = str.maketrans(
    {character: f"\\{character}" for character in "&%$#_{}"}
    | {"\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}"}
)
"""Characters that LaTeX reads as commands, and how they are written."""


@dataclass(frozen=True)
class Table:
    """A table of cells as they are printed.

    Attributes
    ----------
    title : str
        Printed above; empty for none.
    header : tuple of str
        The columns' titles.
    rows : tuple of tuple of str
        The cells, each row as long as the header.
    """

    title: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]

    def __str__(self) -> str:
        text = text_table(list(self.header), [list(row) for row in self.rows])
        return f"{self.title}\n{text}" if self.title else text

    def to_latex(self) -> str:
        """Write a LaTeX tabular.

        Returns
        -------
        str
            With booktabs' rules, the title as its caption.
        """
        columns = "l" + "r" * (len(self.header) - 1)
        lines = [_latex_row(self.header), r"\midrule", *map(_latex_row, self.rows)]
        body = "\n".join([r"\toprule", *lines, r"\bottomrule"])
        tabular = f"\\begin{{tabular}}{{{columns}}}\n{body}\n\\end{{tabular}}"
        caption = f"\\caption{{{_latex(self.title)}}}\n" if self.title else ""
        return f"\\begin{{table}}\n{caption}{tabular}\n\\end{{table}}\n"

    def to_markdown(self) -> str:
        """Write a Markdown table.

        Returns
        -------
        str
            The title stands above it.
        """
        rule = "|".join(["---", *["---:"] * (len(self.header) - 1)])
        lines = [_markdown_row(self.header), f"|{rule}|", *map(_markdown_row, self.rows)]
        table = "\n".join(lines) + "\n"
        return f"**{self.title}**\n\n{table}" if self.title else table

    def to_pandas(self) -> Any:
        """Make a pandas.DataFrame of the cells as they are printed; needs the extra `tables`.

        Raises
        ------
        MissingPackage
            If pandas is not installed.
        """
        from dropo.core.services.data_frames import frame

        # By their places, since columns may share a title.
        rows = [{str(place): cell for place, cell in enumerate(row)} for row in self.rows]
        cells = frame(rows, "0")
        if self.rows:
            cells.columns = list(self.header[1:])
            cells.index.name = self.header[0]
        return cells

    def _repr_html_(self) -> str:
        caption = f"<caption>{escape(self.title)}</caption>" if self.title else ""
        head = f"<thead>{_html_row('th', self.header)}</thead>"
        rows = "".join(_html_row("td", row) for row in self.rows)
        return f"<table>{caption}{head}<tbody>{rows}</tbody></table>"


def _latex_row(cells: tuple[str, ...]) -> str:
    """A row of a tabular."""
    return f"{' & '.join(map(_latex, cells))} \\\\"


def _latex(text: str) -> str:
    """Text with the characters escaped that LaTeX reads as commands."""
    return text.translate(LATEX)


def _markdown_row(cells: tuple[str, ...]) -> str:
    """A row of a Markdown table."""
    escaped = [cell.replace("|", r"\|") for cell in cells]
    return f"| {' | '.join(escaped)} |"


def _html_row(tag: str, cells: tuple[str, ...]) -> str:
    """A row of cells, the first aligned to the left, the others to the right."""
    sides = ["left", *["right"] * (len(cells) - 1)]
    shown = (
        f'<{tag} style="text-align: {side}; padding: 0 0.6em">{escape(cell)}</{tag}>'
        for side, cell in zip(sides, cells, strict=True)
    )
    return f"<tr>{''.join(shown)}</tr>"


class Report(ABC):
    """A result that prints itself: as text, in a notebook as HTML, on a terminal with colours.

    A subclass writes `parts`.
    """

    @abstractmethod
    def parts(self) -> list[str | Table]:
        """Give the sentences and tables in the order in which they are read.

        Returns
        -------
        list of str or Table
        """

    def __str__(self) -> str:
        return "\n".join(map(str, self.parts()))

    def __repr__(self) -> str:
        return str(self)

    def to_latex(self) -> str:
        """Write all tables in LaTeX.

        Returns
        -------
        str
            With booktabs' rules; sentences are left out.
        """
        return "\n".join(part.to_latex() for part in self.parts() if isinstance(part, Table))

    def _repr_html_(self) -> str:
        pieces = []
        for part in self.parts():
            if isinstance(part, Table):
                pieces.append(part._repr_html_())
            elif part:
                pieces.append(_html_text(part))
        return "\n".join(pieces)


def _html_text(text: str) -> str:
    """A sentence as a paragraph; several lines, which may be a table, as they stand."""
    if "\n" in text:
        return f"<pre>{escape(text)}</pre>"
    return f'<p style="margin: 0.2em 0">{escape(text)}</p>'


def text_table(header: list[str], rows: list[list[str]]) -> str:
    """Print a table with blanks between its columns, the first one to the left.

    Parameters
    ----------
    header : list of str
        The columns' titles.
    rows : list of list of str
        The cells, each row as long as the header.

    Returns
    -------
    str
        Lines without trailing blanks.
    """
    widths = [max(len(row[i]) for row in [header, *rows]) for i in range(len(header))]

    def line(row: list[str]) -> str:
        others = [cell.rjust(width) for cell, width in zip(row[1:], widths[1:], strict=True)]
        return "  ".join([row[0].ljust(widths[0]), *others]).rstrip()

    rule = "  ".join("-" * width for width in widths)
    return "\n".join([line(header), rule, *(line(row) for row in rows)])


def number(value: float, digits: int = 5) -> str:
    """Print a number; a dash where it is not finite.

    Parameters
    ----------
    value : float
        The number.
    digits : int
        Significant digits.

    Returns
    -------
    str
        Without zeros at its end.
    """
    return f"{value:.{digits}g}" if np.isfinite(value) else "-"


def steps_text(count: int, seconds: float | None = None) -> str:
    """Write "1 step" or "20 steps, 0.4 s".

    Parameters
    ----------
    count : int
        Control steps.
    seconds : float, optional
        The time that they take [s].

    Returns
    -------
    str
    """
    time = "" if seconds is None else f", {number(seconds, 3)} s"
    return f"{count} step{'s' if count > 1 else ''}{time}"


def duration_text(seconds: float) -> str:
    """Write a time in words, such as "20 s" or "4 minutes".

    Parameters
    ----------
    seconds : float
        The time [s].

    Returns
    -------
    str
        At least "1 s"; in minutes from a minute and a half on.
    """
    if seconds < 90:
        return f"{max(seconds, 1):.0f} s"
    return f"{seconds / 60:.0f} minutes"


MOST_DIGITS = 15
"""Digits that a float64 holds."""


def estimate(value: float, error: float) -> str:
    """Print a number with as many decimals as two digits of its standard error have.

    Parameters
    ----------
    value : float
        The number.
    error : float
        Its standard error.

    Returns
    -------
    str
        With fifteen digits at most, which is what a float64 holds; with seven where there is no
        error, or the number is very small or large.
    """
    has_error = np.isfinite(value) and np.isfinite(error) and error > 0
    if not (has_error and 1e-6 < abs(value) < 1e7):
        return number(value, 7)
    most = MOST_DIGITS - 1 - np.floor(np.log10(abs(value)))
    decimals = int(np.clip(1 - np.floor(np.log10(error)), 0, most))
    return f"{value:.{decimals}f}"
