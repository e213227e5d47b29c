"""A page from its parts: text, figures and tables in one HTML file that loads nothing else."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from importlib.resources import files

import numpy as np

from dropo._version import __version__
from dropo.report.glossary import explained, list_of, meaning


@dataclass(frozen=True)
class Cell:
    """A table's cell.

    Attributes
    ----------
    text : str
        What it shows.
    value : float or None
        The number by which it sorts; None: its text.
    words : bool
        Whether it is a sentence.
    """

    text: str
    value: float | None = None
    words: bool = False


@dataclass(frozen=True)
class Section:
    """A section of a page.

    Attributes
    ----------
    title : str
        The heading.
    lead : str
        A sentence on how to read what follows; empty for none.
    body : str
        The content, as HTML.
    """

    title: str
    lead: str
    body: str


SHORT = 250
"""Letters of a headline; the sentences behind them stand beneath it."""


def page(
    kicker: str, headline: str, cards: Sequence[tuple[str, str, str]], sections: Sequence[Section]
) -> str:
    """Write the whole file.

    Parameters
    ----------
    kicker : str
        The line above the headline, also the file's title.
    headline : str
        The finding, in sentences.
    cards : sequence of (str, str, str)
        The figures beneath the headline: name, value, and "good", "bad" or "".
    sections : sequence of Section
        The content.

    Returns
    -------
    str
        The HTML file's text.
    """
    first, rest = shortened(headline)
    beneath = f"<p>{escape(rest)}</p>" if rest else ""
    shown = "".join(
        f'<div><dt>{escape(name)}</dt><dd class="{kind}">{escape(value)}</dd></div>'
        for name, value, kind in cards
    )
    parts = "\n".join(_section(section) for section in sections)
    beneath = explained(beneath)
    words = list_of(beneath + parts)
    top = (
        f'<p class="kicker">{escape(kicker)}</p><h1>{escape(first)}</h1>{beneath}'
        f'<dl class="cards">{shown}</dl>'
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
<header>{top}</header>
<main>
{parts}
</main>
<footer>{words}Made by dropo {__version__}.</footer>
<script>
{_part("page.js")}{_part("motion.js")}</script>
</body>
</html>
"""


def _section(section: Section) -> str:
    """A section as HTML."""
    lead = f"<p class=lead>{escape(section.lead)}</p>" if section.lead else ""
    body = explained(f"{lead}\n{section.body}")
    return f"<section><h2>{escape(section.title)}</h2>{body}</section>"


def shortened(text: str, maximum: int = SHORT) -> tuple[str, str]:
    """Split a text into its first sentences and the others.

    Parameters
    ----------
    text : str
        Sentences.
    maximum : int
        Letters of the first part at most, but for its first sentence.

    Returns
    -------
    first, others : str
    """
    sentences = re.split(r"(?<=\.) (?=[A-Z])", text)
    lengths = np.cumsum([len(sentence) + 1 for sentence in sentences])
    count = max(1, int(np.sum(lengths - 1 <= maximum)))
    return " ".join(sentences[:count]), " ".join(sentences[count:])


def _part(name: str) -> str:
    """The text of a file in assets."""
    return files("dropo.report").joinpath("assets", name).read_text(encoding="utf-8")


def figure(svg: str, title: str, caption: str = "") -> str:
    """Put a title above a picture and a caption beneath.

    Parameters
    ----------
    svg : str
        The picture.
    title, caption : str
        Empty for none.

    Returns
    -------
    str
        HTML.
    """
    above = f"<h3>{escape(title)}</h3>" if title else ""
    below = f"<figcaption>{escape(caption)}</figcaption>" if caption else ""
    return f"<figure>{above}{svg}{below}</figure>"


def grid(*figures: str, small: bool = False) -> str:
    """Put figures side by side, one below the other on a phone.

    Parameters
    ----------
    *figures : str
        Their HTML.
    small : bool
        Whether they stay two by two on a phone.

    Returns
    -------
    str
        HTML.
    """
    return f'<div class="grid{" small" * small}">{"".join(figures)}</div>'


def table(header: Sequence[str], rows: Sequence[Sequence[Cell]], *, told: bool = False) -> str:
    """Make a table that sorts by the column whose head is clicked.

    Parameters
    ----------
    header : sequence of str
        The columns' titles.
    rows : sequence of sequence of Cell
        The cells.
    told : bool
        Whether the last column holds words.

    Returns
    -------
    str
        HTML.
    """
    head = "".join(
        f'<th scope="col"><button type="button"{_explained(name)}>{escape(name)}</button></th>'
        for name in header
    )
    body = "".join(f"<tr>{''.join(map(_cell, row))}</tr>" for row in rows)
    kind = "told" if told else "numbers"
    return (
        '<div class="scroll" tabindex="0"><table '
        f'class="{kind}"><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>'
    )


def _explained(name: str) -> str:
    """The attribute that says what a column's title means, where the glossary has it."""
    says = meaning(name)
    return f' title="{escape(says)}"' if says else ""


def _cell(cell: Cell) -> str:
    """A cell as HTML."""
    value = ""
    if cell.value is not None and np.isfinite(cell.value):
        value = f' data-value="{float(cell.value)!r}"'
    kind = " class=text" if cell.words else ""
    return f"<td{kind}{value}>{escape(cell.text)}</td>"


def legend(*entries: tuple[str, str, bool]) -> str:
    """Make a legend.

    Parameters
    ----------
    *entries : (str, str, bool)
        Name, CSS variable of the colour, and whether these are dots.

    Returns
    -------
    str
        HTML.
    """
    items = "".join(
        f'<li{" class=dots" if dots else ""} style="--swatch: var(--{color})">{escape(name)}</li>'
        for name, color, dots in entries
    )
    return f'<ul class="legend">{items}</ul>'


def notes(sentences: Sequence[str]) -> str:
    """Make a list of sentences.

    Parameters
    ----------
    sentences : sequence of str
        Plain texts; what stands in backticks is code.

    Returns
    -------
    str
        HTML.
    """
    items = "".join(f"<li>{_prose(sentence)}</li>" for sentence in sentences)
    return f'<ul class="notes">{items}</ul>'


def paragraph(text: str) -> str:
    """Make a paragraph.

    Parameters
    ----------
    text : str
        Plain text; what stands in backticks is code.

    Returns
    -------
    str
        HTML.
    """
    return f"<p>{_prose(text)}</p>"


def _prose(text: str) -> str:
    """A text as HTML; what stands in backticks is code."""
    return re.sub(r"`([^`]+)`", r"<code>\1</code>", escape(text))


def plain(value: float, digits: int = 4) -> str:
    """Print a number.

    Parameters
    ----------
    value : float
        The number.
    digits : int
        Significant digits.

    Returns
    -------
    str
        A dash where the number is not finite.
    """
    return f"{value:.{digits}g}" if np.isfinite(value) else "–"


def percent(fraction: float) -> str:
    """Print a fraction in per cent, with three digits.

    Parameters
    ----------
    fraction : float
        The fraction.

    Returns
    -------
    str
        A dash where the fraction is not finite.
    """
    if not np.isfinite(fraction):
        return "–"
    return "less than 0.001 %" if 0 < fraction < 1e-5 else f"{100 * fraction:.3g} %"
