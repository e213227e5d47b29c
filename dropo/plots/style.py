"""Colours, sizes, and the axes that a figure is drawn into."""

import re
from typing import Any

from dropo.core.services.optional_dependencies import need

Axes = Any
"""A matplotlib Axes, which has no types of its own."""

INK = "#222222"
GREY = "#8A8A8A"
LIGHT = "#DDDDDD"
# Of Okabe and Ito's palette.
BEFORE = "#D55E00"
AFTER = "#0072B2"
OTHER = "#009E73"
PURPLE = "#CC79A7"
SIZE = (4.2, 2.9)
"""Size of one figure [in]."""
FONT = 8.5
"""Size of its letters [pt]."""


def axes_of(ax: Axes | None, *, size: tuple[float, float] = SIZE) -> Axes:
    """Take axes to draw into, without the frame's upper and right side.

    Parameters
    ----------
    ax : Axes or None
        The axes; None: those of a new figure.
    size : (float, float)
        Of a new figure [in].

    Returns
    -------
    Axes

    Raises
    ------
    MissingPackage
        If matplotlib is not installed (extra `plots`).
    """
    if ax is None:
        need("matplotlib", extra="plots", caller="A figure")
        import matplotlib.pyplot as plt

        ax = plt.subplots(figsize=size, layout="constrained")[1]
    ax.spines[["top", "right"]].set_visible(False)
    return ax


def empty(ax: Axes, sentence: str) -> Axes:
    """Write a sentence into axes, where there is nothing to draw.

    Parameters
    ----------
    ax : Axes
        The axes, whose frame is taken away.
    sentence : str
        Why there is nothing.

    Returns
    -------
    Axes
        The same.
    """
    ax.set_axis_off()
    ax.text(
        0.5,
        0.5,
        sentence,
        ha="center",
        va="center",
        wrap=True,
        color=GREY,
        transform=ax.transAxes,
        fontsize=FONT,
    )
    return ax


def folded(name: str, width: int = 14) -> str:
    """Break a name behind "_" or "." into lines, where it can be.

    Parameters
    ----------
    name : str
        The name.
    width : int
        Letters of a line, at most where a break is possible.

    Returns
    -------
    str
        The name with line breaks.
    """
    lines = [""]
    for piece in re.findall(r"[^_.]*[_.]?", name):
        if lines[-1] and len(lines[-1] + piece) > width:
            lines.append("")
        lines[-1] += piece
    return "\n".join(lines)


def with_unit(name: str, unit: str) -> str:
    """Put a unit behind a name, as in "qvel.leg_joint [rad/s]".

    Parameters
    ----------
    name : str
        The name.
    unit : str
        The unit; empty for none.

    Returns
    -------
    str
    """
    return f"{name} [{unit}]" if unit else name


def plain_log(ax: Axes) -> None:
    """Give a logarithmic x axis plain numbers where it spans less than two decades.

    Parameters
    ----------
    ax : Axes
        The axes, which are changed.
    """
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    low, high = ax.get_xlim()
    ax.xaxis.set_minor_formatter(NullFormatter())
    if high < 100 * low:
        ax.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        ax.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))


def legend(ax: Axes, *, room: float = 0.0, **where: Any) -> None:
    """Add a legend without a frame.

    Parameters
    ----------
    ax : Axes
        Where.
    room : float
        Height to add above the data for it, as a fraction of the axes' height.
    **where
        As of matplotlib's `legend`.
    """
    low, high = ax.get_ylim()
    if room and ax.get_yscale() == "log":
        ax.set_ylim(low, high * (high / low) ** room)
    elif room:
        ax.set_ylim(low, high + room * (high - low))
    ax.legend(frameon=False, fontsize=FONT - 1, **where)
