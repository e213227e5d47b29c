"""Figures of a diagnosis: what was tried, what was found, how sure it is, and what is left."""

from typing import Any

import numpy as np

from dropo.core.records.figure_data import Bar, FigureData
from dropo.core.records.trajectories import Ints
from dropo.core.services.validation import Array, require
from dropo.plots.distribution import squares
from dropo.plots.style import (
    AFTER,
    BEFORE,
    FONT,
    GREY,
    INK,
    LIGHT,
    Axes,
    axes_of,
    empty,
    legend,
    with_unit,
)

BRIDGE = 1.36
"""The largest departure of a Brownian bridge, exceeded once in twenty (Kolmogorov)."""
BINS = 8
"""Parts of the data whose mean errors are drawn."""


def figure_data_of(result: Any) -> FigureData:
    """Take the figure data of a diagnosis.

    Parameters
    ----------
    result : Diagnosis or FigureData
        The diagnosis, or its figure data themselves.

    Returns
    -------
    FigureData

    Raises
    ------
    BadArgument
        If it has none.
    """
    found = getattr(result, "figures", result)
    rule = "FigureData, or a Diagnosis that has such"
    valid = isinstance(found, FigureData)
    require(valid, "result", rule, type(result).__name__, "dropo.plots")
    return found


def words(label: str) -> str:
    """Write an effect's label in words.

    Parameters
    ----------
    label : str
        Such as "joint_stiffness:knee.rest" or "parameter_drift:mass.ramp".

    Returns
    -------
    str
        Such as "joint stiffness at knee (rest)" or "drift of mass (ramp)".
    """
    effect, _, place = label.partition(":")
    start = ""
    form = ""
    if not effect.startswith("sensor_"):  # there, the dot is in the signal's name
        start, _, form = label.rpartition(".")
    if start:
        return f"{words(start)} ({form})"
    if effect == "parameter_drift":
        return f"drift of {words(place)}"
    return effect.replace("_", " ") + (f" at {place}" if place else "")


def candidates(result: Any, ax: Axes | None = None, *, found: int = 0) -> Axes:
    """Draw what the effects of one round of the search gain on held-out data, with errors.

    The accepted one is blue; a bracket joins it with those that the data cannot distinguish from
    it.

    Parameters
    ----------
    result : Diagnosis or FigureData
        What to draw.
    ax : Axes, optional
        Where to draw; a figure of its own by default.
    found : int
        The round, 0 for the first cause.

    Returns
    -------
    Axes

    Raises
    ------
    BadArgument
        If the result has no such data.
    """
    data = figure_data_of(result)
    ax = axes_of(ax)
    bars = in_order(data.rounds[found]) if found < len(data.rounds) else []
    if not bars:
        return empty(ax, "No effect looked likely enough to be fitted.")
    place = -np.arange(len(bars), dtype=float)
    colors = [LIGHT if bar.told and not bar.accepted else AFTER for bar in bars]
    for y, bar, color in zip(place, bars, colors, strict=True):
        ax.barh(
            y - 0.2,
            bar.gain or 0.0,
            height=0.3,
            color=color,
            alpha=1.0 if bar.accepted or bar.told else 0.45,
        )
        if bar.gain is not None and bar.error:
            ax.hlines(y - 0.2, bar.gain - bar.error, bar.gain + bar.error, color=INK, lw=1)
    # Lines beside the bars alone, so that no word is crossed out.
    ax.vlines(np.zeros(len(bars)), place - 0.4, place, color=INK, lw=0.8)
    ax.vlines(
        np.full(len(bars), data.needed), place - 0.4, place, color=GREY, lw=0.9, ls=(0, (2, 2))
    )
    left, right = ax.get_xlim()
    indent = left + 0.012 * (right - left)
    for y, bar in zip(place, bars, strict=True):
        gain = "same response"
        if bar.gain is not None:
            gain = f"{bar.gain:+,.0f}" if abs(bar.gain) >= 100 else f"{bar.gain:+.3g}"
        weight = "bold" if bar.accepted else "normal"
        ax.text(
            indent,
            y + 0.2,
            words(bar.label),
            fontsize=FONT - 1,
            color=INK,
            va="center",
            weight=weight,
            clip_on=False,
        )
        ax.text(
            right,
            y + 0.2,
            gain,
            ha="right",
            fontsize=FONT - 1,
            color=INK,
            va="center",
            clip_on=False,
        )
    _bracket(ax, bars, left - 0.03 * (right - left))
    ax.set(
        yticks=[],
        xlim=(left, right),
        ylim=(place[-1] - 0.6, 0.6),
        xlabel="nats gained on data held out",
    )
    ax.spines["left"].set_visible(False)
    return ax


def in_order(bars: tuple[Bar, ...]) -> list[Bar]:
    """Sort effects: the accepted one, those confused with it, the rest; each part by gain.

    Parameters
    ----------
    bars : tuple of Bar
        The effects of one round.

    Returns
    -------
    list of Bar
    """

    def rank(bar: Bar) -> tuple[bool, bool, float]:
        return not bar.accepted, bar.told, np.inf if bar.gain is None else -bar.gain

    return sorted(bars, key=rank)


def _bracket(ax: Axes, bars: list[Bar], x: float) -> None:
    """Join the accepted effect with those that the data cannot distinguish from it."""
    together = [i for i, bar in enumerate(bars) if bar.accepted or not bar.told]
    if len(together) > 1:
        width = 0.015 * np.diff(ax.get_xlim())[0]
        top = 0.35 - together[0]
        bottom = -0.4 - together[-1]
        ax.plot(
            [x + width, x, x, x + width],
            [top, top, bottom, bottom],
            color=AFTER,
            lw=1.6,
            clip_on=False,
        )


def residuals(result: Any, ax: Axes | None = None, *, found: int = 0) -> Axes:
    """Draw errors at the end of held-out windows over the quantity that an effect depends on.

    Without the effect and with it; means of eighths of the data have 95 % intervals.

    Parameters
    ----------
    result : Diagnosis or FigureData
        What to draw.
    ax : Axes, optional
        Where to draw; a figure of its own by default.
    found : int
        The cause, 0 for the first.

    Returns
    -------
    Axes

    Raises
    ------
    BadArgument
        If the result has no such data.
    """
    data = figure_data_of(result)
    ax = axes_of(ax)
    if found >= len(data.axes):
        return empty(ax, "No cause was found.")
    shown = data.axes[found]
    x = np.array(shown.x)
    edges = np.unique(np.quantile(x, np.linspace(0, 1, BINS + 1)))
    inside = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, max(len(edges) - 2, 0))
    for values, color, name, mark in (
        (shown.before, BEFORE, "without it", "o"),
        (shown.after, AFTER, "with it", "s"),
    ):
        y = np.array(values)
        ax.plot(x, y, ".", color=color, ms=3, alpha=0.35)
        centre, mean, half = _means(x, y, inside)
        ax.errorbar(
            centre, mean, half, color=color, marker=mark, ms=4.5, lw=1.3, capsize=2, label=name
        )
    ax.axhline(0, color=GREY, lw=0.8)
    ax.xaxis.get_major_locator().set_params(nbins=6)
    ax.set(
        xlabel=with_unit(shown.axis, shown.axis_unit),
        ylabel=with_unit(f"error of {shown.signal}", shown.unit),
    )
    legend(ax)
    return ax


def _means(x: Array, y: Array, inside: Ints) -> tuple[Array, Array, Array]:
    """By bin: median of x, mean of y, half of its 95 % interval."""
    rows = []
    for b in np.unique(inside):
        own = y[inside == b]
        if len(own) > 1:
            half = 1.96 * own.std(ddof=1) / np.sqrt(len(own))
            rows.append((np.median(x[inside == b]), own.mean(), half))
    centre, mean, half = np.array(rows).reshape(-1, 3).T
    return centre, mean, half


def law(result: Any, ax: Axes | None = None, *, found: int = 0) -> Axes:
    """Draw the force that a law stands for, with 95 % intervals, and the law.

    Parameters
    ----------
    result : Diagnosis or FigureData
        What to draw.
    ax : Axes, optional
        Where to draw; a figure of its own by default.
    found : int
        Which of the figure data's `laws`.

    Returns
    -------
    Axes

    Raises
    ------
    BadArgument
        If the result has no such data.
    """
    data = figure_data_of(result)
    ax = axes_of(ax)
    if found >= len(data.laws):
        return empty(ax, "No law was found.")
    shown = data.laws[found]
    half = 1.96 * np.array(shown.error)
    ax.axhline(0, color=GREY, lw=0.8)
    ax.plot(shown.x, shown.law, color=AFTER, lw=1.6, label="law")
    ax.errorbar(shown.x, shown.force, half, color=INK, fmt="o", ms=4, capsize=2, label="data")
    ax.xaxis.get_major_locator().set_params(nbins=6)
    place = shown.label.partition(":")[2]
    ax.set(
        xlabel=with_unit(shown.axis, shown.axis_unit),
        ylabel=with_unit(f"force at {place}", shown.unit),
    )
    legend(ax)
    return ax


def sizes(result: Any, ax: Axes | None = None, *, found: int = 0, unit: str = "") -> Axes:
    """Draw a cause's magnitude, estimated anew in quarters of the data, with 95 % intervals.

    It is level for a true cause, and sloped for what only acts like it.

    Parameters
    ----------
    result : Diagnosis or FigureData
        What to draw.
    ax : Axes, optional
        Where to draw; a figure of its own by default.
    found : int
        Which of the figure data's `sizes`.
    unit : str
        Of the variable by which the data are divided, for the axis.

    Returns
    -------
    Axes

    Raises
    ------
    BadArgument
        If the result has no such data.
    """
    data = figure_data_of(result)
    ax = axes_of(ax)
    if found >= len(data.sizes):
        return empty(ax, "No cause was found.")
    shown = data.sizes[found]
    size = 100 * np.array(shown.size)
    half = 196 * np.array(shown.error)
    ax.axhline(100, color=GREY, lw=1, ls=(0, (2, 2)))
    ax.errorbar(
        np.arange(len(size)),
        size,
        half,
        color=AFTER,
        marker="s",
        ms=5,
        lw=0,
        elinewidth=1.6,
        capsize=3,
    )
    ax.set_xticks(np.arange(len(size)), [f"{at:.4g}".replace("-", "−") for at in shown.at])
    low = (size - half).min()
    high = (size + half).max()
    ax.set(xlim=(-0.5, len(size) - 0.5), ylim=(min(80.0, low - 3), max(120.0, high + 3)))
    variable = "row of the data" if shown.variable == "time" else shown.variable
    ax.set(
        xlabel=f"{with_unit(variable, unit)}, median of each part",
        ylabel="size [% of the estimate]",
    )
    return ax


def forces(result: Any, ax: Axes | None = None) -> Axes:
    """Draw the random forces at each degree of freedom that would explain what is left.

    Before and after; open bars where they are not significant.

    Parameters
    ----------
    result : Diagnosis or FigureData
        What to draw.
    ax : Axes, optional
        Where to draw; a figure of its own by default.

    Returns
    -------
    Axes

    Raises
    ------
    BadArgument
        If the result has no such data.
    """
    shown = figure_data_of(result).forces
    ax = axes_of(ax)
    place = -np.arange(len(shown.names), dtype=float)
    for values, there, color, name, up in (
        (shown.before, shown.there_before, BEFORE, "before", 0.2),
        (shown.after, shown.there_after, AFTER, "after", -0.2),
    ):
        label = name if there else f"{name} (not significant)"
        ax.barh(
            place + up,
            values,
            height=0.36,
            facecolor=color if there else "none",
            edgecolor=color,
            lw=1.1,
            label=label,
        )
    labels = [with_unit(name, unit) for name, unit in zip(shown.names, shown.units, strict=True)]
    ax.set(yticks=place, yticklabels=labels, xlabel="unexplained force, sd in each control step")
    ax.tick_params(axis="y", labelsize=FONT - 1)
    legend(ax)
    return ax


def similarity(result: Any, ax: Axes | None = None) -> Axes:
    """Draw |cosine| between the responses of the effects that were most likely at first.

    Near 1 the data cannot distinguish them.

    Parameters
    ----------
    result : Diagnosis or FigureData
        What to draw.
    ax : Axes, optional
        Where to draw; a figure of its own by default.

    Returns
    -------
    Axes

    Raises
    ------
    BadArgument
        If the result has no such data.
    """
    shown = figure_data_of(result).similarity
    names = tuple(words(label) for label in shown.labels)
    otherwise = "Fewer than two effects move the predictions."
    return squares(np.array(shown.cosines), names, axes_of(ax), otherwise)


def changes(result: Any, ax: Axes | None = None, *, found: int = 0) -> Axes:
    """Draw a cause's cumulative scores over the held-out data, in order.

    A peak beyond the dashed lines is a magnitude that changes there.

    Parameters
    ----------
    result : Diagnosis or FigureData
        What to draw.
    ax : Axes, optional
        Where to draw; a figure of its own by default.
    found : int
        Which of the figure data's `sums`.

    Returns
    -------
    Axes

    Raises
    ------
    BadArgument
        If the result has no such data.
    """
    data = figure_data_of(result)
    ax = axes_of(ax)
    if found >= len(data.sums):
        return empty(ax, "No cause was found.")
    shown = data.sums[found]
    ax.step(
        [0.0, *(100 * np.array(shown.time))], [0.0, *shown.score], where="post", color=AFTER, lw=1.5
    )
    for sign in (-1, 1):
        ax.axhline(sign * BRIDGE, color=GREY, lw=1, ls=(0, (2, 2)))
    ax.set(xlim=(0, 100), xlabel="data held out, in order [%]", ylabel="summed score")
    limit = 1.1 * max(BRIDGE, float(np.abs(shown.score).max(initial=0.0)))
    ax.set_ylim(-limit, limit)
    return ax
