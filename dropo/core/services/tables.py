"""Tables of text, and reports: results that print themselves."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from html import escape

import numpy as np


@dataclass(frozen=True)
class Table:
    """Cells as they are printed; rows as long as the header."""

    title: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]

    def __str__(self) -> str:
        text = text_table(list(self.header), [list(row) for row in self.rows])
        return f"{self.title}\n{text}" if self.title else text

    def _repr_html_(self) -> str:
        caption = f"<caption>{escape(self.title)}</caption>" if self.title else ""
        rows = "".join(_html_row("td", row) for row in self.rows)
        return f"<table>{caption}<thead>{_html_row('th', self.header)}</thead><tbody>{rows}</tbody></table>"


def _html_row(tag: str, cells: tuple[str, ...]) -> str:
    """The first cell to the left, the others to the right."""
    sides = ["left", *["right"] * (len(cells) - 1)]
    shown = (
        f'<{tag} style="text-align: {side}; padding: 0 0.6em">{escape(cell)}</{tag}>'
        for side, cell in zip(sides, cells, strict=True)
    )
    return f"<tr>{''.join(shown)}</tr>"


class Report(ABC):
    """A result that prints itself: as text, in a notebook as HTML, and on a terminal as the command
    line draws it.
    """

    @abstractmethod
    def parts(self) -> list[str | Table]:
        """Sentences and tables, in the order in which they are read."""

    def __str__(self) -> str:
        return "\n".join(map(str, self.parts()))

    def __repr__(self) -> str:
        return str(self)

    def _repr_html_(self) -> str:
        return "\n".join(
            part._repr_html_() if isinstance(part, Table) else _html_text(part)
            for part in self.parts()
            if part
        )


def _html_text(text: str) -> str:
    """A sentence as a paragraph; several lines, which may be a table, as they stand."""
    return (
        f"<pre>{escape(text)}</pre>"
        if "\n" in text
        else f'<p style="margin: 0.2em 0">{escape(text)}</p>'
    )


def text_table(header: list[str], rows: list[list[str]]) -> str:
    """Columns padded with blanks; the first one to the left, the others to the right."""
    widths = [max(len(row[i]) for row in [header, *rows]) for i in range(len(header))]

    def line(row: list[str]) -> str:
        cells = [
            row[0].ljust(widths[0]),
            *(cell.rjust(width) for cell, width in zip(row[1:], widths[1:], strict=True)),
        ]
        return "  ".join(cells).rstrip()

    return "\n".join(
        [line(header), "  ".join("-" * width for width in widths), *(line(row) for row in rows)]
    )


def number(value: float, digits: int = 5) -> str:
    """A number for a table; a dash where there is none."""
    return f"{value:.{digits}g}" if np.isfinite(value) else "-"


def estimate(value: float, error: float) -> str:
    """A number with the decimals of its standard error's two digits, twelve at most; with seven
    digits where there is no error.
    """
    if not (np.isfinite(value) and np.isfinite(error) and error > 0 and 1e-6 < abs(value) < 1e7):
        return number(value, 7)
    return f"{value:.{int(np.clip(1 - np.floor(np.log10(error)), 0, 12))}f}"
