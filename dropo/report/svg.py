"""Figures as SVG inside a page, with the page's colours and a text of what they show."""

import io
import re
from collections.abc import Callable
from hashlib import sha256
from html import escape
from typing import Any

from dropo.core.services.optional_dependencies import need
from dropo.plots.style import AFTER, BEFORE, FONT, GREY, INK, LIGHT, OTHER, PURPLE, SIZE

COLORS = {
    INK: "ink",
    GREY: "grey",
    LIGHT: "light",
    BEFORE: "before",
    AFTER: "after",
    OTHER: "other",
    PURPLE: "purple",
}
"""The page's CSS variables by the colours of the figures."""
STYLE: dict[Any, Any] = {
    "svg.fonttype": "none",
    "svg.hashsalt": "dropo",
    "font.size": FONT,
    "axes.titlesize": FONT + 0.5,
    "text.color": INK,
    "axes.edgecolor": GREY,
    "axes.labelcolor": INK,
    "axes.titlecolor": INK,
    "xtick.color": GREY,
    "ytick.color": GREY,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "axes.linewidth": 0.7,
    "axes.axisbelow": True,
    "path.simplify_threshold": 0.3,
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans"],
}
# [in] of a picture with a row for each signal
ROW = 0.2
HEAD = 0.75
IDENTITY = re.compile(r'(\bid="|url\(#|href="#)')
PLACES = re.compile(r'\b(?:d|x|y|points|transform)="[^"]*"')
LONG = re.compile(r"-?\d+\.\d{3,}")


def picture(
    draw: Callable[[Any], Any], text: str, *, size: tuple[float, float] = SIZE, grid: int = 0
) -> str:
    """Draw a figure as an <svg> element.

    Parameters
    ----------
    draw : callable
        draw(axes) draws it.
    text : str
        What it shows, for those who cannot see it.
    size : (float, float)
        Width and height [in].
    grid : int
        So many axes a side in place of one.

    Returns
    -------
    str

    Raises
    ------
    MissingPackage
        If matplotlib is not installed (extra `plots`).
    """
    need("matplotlib", extra="plots", caller="A report")
    import matplotlib as mpl
    from matplotlib.figure import Figure

    with mpl.rc_context(STYLE):
        figure = Figure(figsize=size, layout="constrained")
        draw(figure.subplots(grid, grid, squeeze=False) if grid else figure.subplots())
        file = io.StringIO()
        figure.savefig(
            file,
            format="svg",
            transparent=True,
            metadata={"Date": None, "Creator": None, "Format": None, "Type": None},
        )
    return themed(file.getvalue(), text)


def rows(count: int, each: float = ROW, more: float = HEAD) -> tuple[float, float]:
    """Give the size of a figure that grows with its rows.

    Parameters
    ----------
    count : int
        Number of rows.
    each : float
        Height of a row [in].
    more : float
        Height of what is beside the rows [in].

    Returns
    -------
    width, height : float
        Size of the figure [in].
    """
    return SIZE[0], more + each * count


def themed(svg: str, text: str) -> str:
    """Take the <svg> element of a file, with the page's colours and font.

    Its identities are its own in the page, and its numbers have two decimals.

    Parameters
    ----------
    svg : str
        The file that matplotlib wrote.
    text : str
        What it shows, in words.

    Returns
    -------
    str
        The element, as wide as the page allows.
    """
    start = svg.index("<svg")
    box = re.search(r'viewBox="([^"]+)"', svg)
    assert box is not None
    inside = re.sub(
        r"<metadata>.*?</metadata>|<style.*?</style>",
        "",
        svg[svg.index(">", start) + 1 :],
        flags=re.DOTALL,
    )
    for color, name in COLORS.items():
        inside = re.sub(color, f"var(--{name})", inside, flags=re.IGNORECASE)
    inside = inside.replace("font-family: 'DejaVu Sans', sans-serif", "font-family: var(--font)")
    inside = PLACES.sub(
        lambda found: LONG.sub(lambda one: f"{float(one[0]):.2f}", found[0]), inside
    )
    inside = IDENTITY.sub(rf"\g<1>p{sha256(inside.encode()).hexdigest()[:6]}-", inside)
    return (
        f'<svg role="img" aria-label="{escape(text)}" viewBox="{box[1]}" '
        f'xmlns:xlink="http://www.w3.org/1999/xlink">{inside}'
    )
