"""A page from its parts: sections of text, pictures and tables in one HTML file that loads nothing
else.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from importlib.resources import files

import numpy as np

from dropo._version import __version__


@dataclass(frozen=True)
class Cell:
    """A table's cell: what it shows, and the value by which it sorts where that is another; words:
    whether it is a sentence.
    """

    text: str
    value: float | None = None
    words: bool = False


@dataclass(frozen=True)
class Section:
    """A heading, a sentence on how to read what follows, and that, as HTML."""

    title: str
    lead: str
    body: str


SHORT = 250  # letters of a headline; the sentences behind them stand beneath it


def page(
    kicker: str, headline: str, cards: Sequence[tuple[str, str, str]], sections: Sequence[Section]
) -> str:
    """The whole file. cards: the figures beneath the headline, (name, value, "good", "bad" or "")."""
    first, rest = shortened(headline)
    beneath = f"<p>{escape(rest)}</p>" if rest else ""
    shown = "".join(
        f'<div><dt>{escape(name)}</dt><dd class="{kind}">{escape(value)}</dd></div>'
        for name, value, kind in cards
    )
    parts = "\n".join(
        f"<section><h2>{escape(s.title)}</h2>{f'<p class=lead>{escape(s.lead)}</p>' if s.lead else ''}\n{s.body}</section>"
        for s in sections
    )
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<link rel="icon" href="data:,">
<title>{escape(kicker)}</title>
<style>
{_part("page.css")}</style>
</head>
<body>
<header><p class="kicker">{escape(kicker)}</p><h1>{escape(first)}</h1>{beneath}<dl class="cards">{shown}</dl></header>
<main>
{parts}
</main>
<footer>Made by dropo {__version__}.</footer>
<script>
{_part("page.js")}</script>
</body>
</html>
"""


def shortened(text: str, most: int = SHORT) -> tuple[str, str]:
    """The sentences with which a text begins, at least one, of so many letters at most; and the
    others.
    """
    sentences = re.split(r"(?<=\.) (?=[A-Z])", text)
    lengths = np.cumsum([len(sentence) + 1 for sentence in sentences])
    count = max(1, int(np.sum(lengths - 1 <= most)))
    return " ".join(sentences[:count]), " ".join(sentences[count:])


def _part(name: str) -> str:
    return files("dropo.report").joinpath(name).read_text(encoding="utf-8")


def figure(svg: str, title: str, caption: str = "") -> str:
    """A picture with its title above and what it says beneath; without a title, where the picture
    has its own.
    """
    above = f"<h3>{escape(title)}</h3>" if title else ""
    below = f"<figcaption>{escape(caption)}</figcaption>" if caption else ""
    return f"<figure>{above}{svg}{below}</figure>"


def grid(*figures: str) -> str:
    """Pictures side by side, one below the other on a phone."""
    return f'<div class="grid">{"".join(figures)}</div>'


def table(header: Sequence[str], rows: Sequence[Sequence[Cell]], *, told: bool = False) -> str:
    """A table that sorts by the column whose head is clicked. told: whether its last column holds
    words.
    """
    head = "".join(
        f'<th scope="col"><button type="button">{escape(name)}</button></th>' for name in header
    )
    body = "".join(f"<tr>{''.join(map(_cell, row))}</tr>" for row in rows)
    kind = "told" if told else "numbers"
    return (
        '<div class="scroll" tabindex="0"><table '
        f'class="{kind}"><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>'
    )


def _cell(cell: Cell) -> str:
    value = (
        ""
        if cell.value is None or not np.isfinite(cell.value)
        else f' data-value="{float(cell.value)!r}"'
    )
    return f"<td{' class=text' if cell.words else ''}{value}>{escape(cell.text)}</td>"


def legend(*entries: tuple[str, str, bool]) -> str:
    """(name, CSS variable, whether dots)."""
    items = "".join(
        f'<li{" class=dots" if dots else ""} style="--swatch: var(--{color})">{escape(name)}</li>'
        for name, color, dots in entries
    )
    return f'<ul class="legend">{items}</ul>'


def notes(sentences: Sequence[str]) -> str:
    """A list of sentences."""
    return f'<ul class="notes">{"".join(f"<li>{_prose(sentence)}</li>" for sentence in sentences)}</ul>'


def paragraph(text: str) -> str:
    """A paragraph of plain text; what stands in backticks is code."""
    return f"<p>{_prose(text)}</p>"


def _prose(text: str) -> str:
    return re.sub(r"`([^`]+)`", r"<code>\1</code>", escape(text))


def plain(value: float, digits: int = 4) -> str:
    """A number; a dash where there is none."""
    return f"{value:.{digits}g}" if np.isfinite(value) else "–"


def percent(share: float) -> str:
    """A share in per cent, with three digits."""
    if not np.isfinite(share):
        return "–"
    return "less than 0.001 %" if 0 < share < 1e-5 else f"{100 * share:.3g} %"
