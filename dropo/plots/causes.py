"""The pictures of a diagnosis: what was tried, what was found, what it cannot be told from, and
what is left.
"""

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

BRIDGE = 1.36  # the largest departure of a Brownian bridge, exceeded once in twenty (Kolmogorov)
BINS = 8


def figure_data_of(result: Any) -> FigureData:
    """Figure data themselves, or those of a diagnosis."""
    found = getattr(result, "figures", result)
    require(
        isinstance(found, FigureData),
        "result",
        "FigureData, or a Diagnosis that has such",
        type(result).__name__,
        "dropo.plots",
    )
    return found


def words(label: str) -> str:
    """ "joint_stiffness:knee.rest" as "joint stiffness at knee (rest)", "parameter_drift:mass.ramp"
    as "drift of mass (ramp)".
    """
    effect, _, place = label.partition(":")
    start, _, form = (
        ("", "", "") if effect.startswith("sensor_") else label.rpartition(".")
    )  # of sensors, the dot is in the signal's name
    if start:
        return f"{words(start)} ({form})"
    if effect == "parameter_drift":
        return f"drift of {words(place)}"
    return effect.replace("_", " ") + (f" at {place}" if place else "")


def candidates(result: Any, ax: Axes | None = None, *, found: int = 0) -> Axes:
    """The effects that were fitted in one round of the search, by the nats they gain on data held
    out, with standard errors.

    The accepted one is blue; a bracket joins it with those that the data cannot tell from it.
    found: the round, 0 for the first cause.
    """
    data = figure_data_of(result)
    ax = axes_of(ax)
    bars = in_order(data.rounds[found]) if found < len(data.rounds) else []
    if not bars:
        return empty(ax, "No effect looked likely enough to be fitted.")
    place = -np.arange(len(bars), dtype=float)
    colors = [AFTER if bar.accepted else LIGHT if bar.told else AFTER for bar in bars]
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
    ax.vlines(
        np.zeros(len(bars)), place - 0.4, place, color=INK, lw=0.8
    )  # beside the bars alone, so that no word is crossed out
    ax.vlines(
        np.full(len(bars), data.needed), place - 0.4, place, color=GREY, lw=0.9, ls=(0, (2, 2))
    )
    left, right = ax.get_xlim()
    indent = left + 0.012 * (right - left)
    for y, bar in zip(place, bars, strict=True):
        size = (
            "same response"
            if bar.gain is None
            else f"{bar.gain:+,.0f}"
            if abs(bar.gain) >= 100
            else f"{bar.gain:+.3g}"
        )
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
            size,
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
    """The accepted one, those that cannot be told from it, the rest; each by what it gains."""
    return sorted(
        bars,
        key=lambda bar: (not bar.accepted, bar.told, np.inf if bar.gain is None else -bar.gain),
    )


def _bracket(ax: Axes, bars: list[Bar], x: float) -> None:
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
    """The errors at the end of each window held out over what the effect acts on, without the
    effect and with it; means of eighths of the data with 95 % intervals.
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
    rows = [
        (np.median(x[mask]), y[mask].mean(), 1.96 * y[mask].std(ddof=1) / np.sqrt(mask.sum()))
        for mask in (inside == b for b in np.unique(inside))
        if mask.sum() > 1
    ]
    return tuple(np.array(rows).reshape(-1, 3).T)  # type: ignore[return-value]


def sizes(result: Any, ax: Axes | None = None, *, found: int = 0, unit: str = "") -> Axes:
    """A cause's size, estimated anew in quarters of the data, with 95 % intervals: level for a true
    cause, sloped for what only acts like it. found: which of the pictures' `sizes`; unit: of the
    variable by which these are quarters, for the axis.
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
    """The random forces that would explain what is left at each degree of freedom, before and
    after; open where they may be nothing.
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
    """|cosine| between the responses of the effects that looked most likely at first: near 1 the
    data cannot tell them apart.
    """
    shown = figure_data_of(result).similarity
    names = tuple(words(label) for label in shown.labels)
    return squares(
        np.array(shown.cosines), names, axes_of(ax), "Fewer than two effects move the predictions."
    )


def changes(result: Any, ax: Axes | None = None, *, found: int = 0) -> Axes:
    """A cause's scores summed over the data held out, in order: a peak beyond the dashed lines is a
    size that changes there.
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
    reach = 1.1 * max(BRIDGE, float(np.abs(shown.score).max(initial=0.0)))
    ax.set_ylim(-reach, reach)
    return ax
