"""Colours, sizes, and the axes that a figure is drawn into."""

import re
from typing import Any

from dropo.core.services.optional_dependencies import need

Axes = Any
"""A matplotlib Axes, which has no types of its own."""

INK = "#222222"
GREY = "#8A8A8A"
LIGHT = "#DDDDDD"
# of Okabe and Ito's palette
BEFORE = "#D55E00"
AFTER = "#0072B2"
OTHER = "#009E73"
PURPLE = "#CC79A7"
SIZE = (4.2, 2.9)  # [in] of one figure
FONT = 8.5  # [pt]


def axes_of(ax: Axes | None, *, size: tuple[float, float] = SIZE) -> Axes:
    """`ax`, or the axes of a new figure; without the frame's upper and right side."""
    if ax is None:
        need("matplotlib", extra="plots", caller="A figure")
        import matplotlib.pyplot as plt

        ax = plt.subplots(figsize=size, layout="constrained")[1]
    ax.spines[["top", "right"]].set_visible(False)
    return ax


def empty(ax: Axes, sentence: str) -> Axes:
    """The axes with a sentence in place of a figure that nothing can be drawn in."""
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
    """A name on several lines, broken behind "_" or "." where they would be longer than `width`."""
    lines = [""]
    for piece in re.findall(r"[^_.]*[_.]?", name):
        if lines[-1] and len(lines[-1] + piece) > width:
            lines.append("")
        lines[-1] += piece
    return "\n".join(lines)


def with_unit(name: str, unit: str) -> str:
    """ "qvel.leg_joint [rad/s]"."""
    return f"{name} [{unit}]" if unit else name


def plain_log(ax: Axes) -> None:
    """Few ticks, in plain numbers, on a logarithmic x axis of less than two decades."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    low, high = ax.get_xlim()
    ax.xaxis.set_minor_formatter(NullFormatter())
    if high < 100 * low:
        ax.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        ax.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))


def legend(ax: Axes, *, room: float = 0.0, **where: Any) -> None:
    """A legend without a frame. room: the share of the axes' height that is added above the data
    for it.
    """
    low, high = ax.get_ylim()
    if room and ax.get_yscale() == "log":
        ax.set_ylim(low, high * (high / low) ** room)
    elif room:
        ax.set_ylim(low, high + room * (high - low))
    ax.legend(frameon=False, fontsize=FONT - 1, **where)
