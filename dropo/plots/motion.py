"""Measured motion against what is predicted, before and after."""

from typing import Any

import numpy as np

from dropo.core.records.predictions import Predictions, Side
from dropo.core.services.validation import Array, known, require
from dropo.plots.style import (
    AFTER,
    BEFORE,
    FONT,
    GREY,
    INK,
    Axes,
    axes_of,
    empty,
    legend,
    plain_log,
    with_unit,
)

BINS = 10
"""Bins of probabilities."""
Z_99 = 2.576
"""Standard errors that a bin's count exceeds once in a hundred."""


def predictions_of(result: Any) -> Predictions:
    """Take the predictions of a diagnosis.

    Parameters
    ----------
    result : Predictions or Diagnosis
        The predictions themselves, or a diagnosis.

    Returns
    -------
    Predictions

    Raises
    ------
    BadArgument
        If it has none.
    """
    found = getattr(result, "motion", result)
    rule = "Predictions, or a Diagnosis that has such"
    valid = isinstance(found, Predictions)
    require(valid, "result", rule, type(result).__name__, "dropo.plots")
    return found


def sides(found: Predictions) -> list[tuple[Side, str, Any, str]]:
    """List the models to draw, each with its colour, line and mark.

    Parameters
    ----------
    found : Predictions
        What to draw.

    Returns
    -------
    list of (Side, str, line style, str)
        Before and after; after alone where there is one model.
    """
    both: list[tuple[Side, str, Any, str]] = [
        (found.before, BEFORE, (0, (4, 2)), "o"),
        (found.after, AFTER, "-", "s"),
    ]
    return both if changed(found) else both[1:]


def changed(found: Predictions) -> bool:
    """Tell whether predictions before and after are of two models.

    Parameters
    ----------
    found : Predictions
        Both.

    Returns
    -------
    bool
    """
    return found.before.name != found.after.name


def telling(result: Any, maximum: int = 6) -> list[str]:
    """Choose the signals whose squared errors change most, relative to their variance.

    Parameters
    ----------
    result : Predictions or Diagnosis
        Before and after; where there is one model, the squared errors themselves count.
    maximum : int
        How many signals at most.

    Returns
    -------
    list of str
        Their names, the first changes most; without those that do not change.
    """
    found = predictions_of(result)
    change = found.after.by_signal**2
    if changed(found):
        change = np.abs(found.before.by_signal**2 - found.after.by_signal**2)
    variance = np.where(found.spread > 0, found.spread**2, np.inf)
    relative = np.nan_to_num(change, nan=np.inf) / variance
    # Rotations are compared in the tangent space at the measurement, where they are 0.
    relative[np.ptp(found.measured, axis=(0, 1)) <= 0] = 0.0
    order = np.argsort(-relative, kind="stable")
    return [found.names[i] for i in order[:maximum] if relative[i] > 0]


def trajectory(result: Any, signal: str, ax: Axes | None = None) -> Axes:
    """Draw one signal as measured and as predicted from the start of each window, with 90 % bands.

    Parameters
    ----------
    result : Predictions or Diagnosis
        What to draw.
    signal : str
        The signal's name.
    ax : Axes, optional
        Where to draw; a figure of its own by default.

    Returns
    -------
    Axes

    Raises
    ------
    BadArgument
        If the result has no predictions.
    UnknownName
        If there is no such signal.
    """
    found = predictions_of(result)
    ax = axes_of(ax)
    i = found.names.index(known("signal", signal, found.names))
    step, unit = (1.0, "control steps") if np.isnan(found.seconds) else (found.seconds, "s")
    for w, begin in enumerate(_side_by_side(found)):
        time = step * (begin + 1 + np.arange(found.measured.shape[1]))
        for side, color, style, _ in sides(found):
            ax.fill_between(time, *side.band[:, w, :, i], color=color, alpha=0.18, lw=0)
            ax.plot(
                time,
                side.line[w, :, i],
                color=color,
                lw=1.5,
                ls=style,
                label=side.name if w == 0 else None,
            )
        label = "measured" if w == 0 else None
        ax.plot(time, found.measured[w, :, i], ".", color=INK, ms=3.2, label=label, zorder=3)
    ax.set(xlabel=f"time [{unit}]", title=with_unit(signal, found.units[i]))
    ax.xaxis.get_major_locator().set_params(nbins=6)
    return ax


def _side_by_side(found: Predictions) -> Array:
    """Where windows begin on the axis: as in the data if they are near there, else in a row."""
    length = found.measured.shape[1]
    begins = found.begins
    in_order = len(begins) < 2 or int(np.diff(begins).min()) >= length
    if in_order and np.ptp(begins) < 3 * length * len(begins):
        return np.asarray(begins)
    return np.arange(len(begins)) * (length + 2)


def horizon(result: Any, ax: Axes | None = None) -> Axes:
    """Draw root mean square errors by horizon, over all signals, in units of their spread.

    Parameters
    ----------
    result : Predictions or Diagnosis
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
    found = predictions_of(result)
    ax = axes_of(ax)
    steps = found.horizons
    for side, color, _, mark in sides(found):
        ax.plot(
            steps, 100 * side.by_horizon, color=color, marker=mark, ms=3.5, lw=1.3, label=side.name
        )
    if np.isfinite(found.noise).any():
        ax.plot(steps, 100 * found.noise, color=GREY, lw=1.2, ls=(0, (2, 2)), label="noise alone")
    ax.set(xlabel="control steps ahead", ylabel="error [% of the motion's spread]")
    smallest = np.nanmin([s.by_horizon for s in (found.before, found.after)])
    largest = np.nanmax(found.before.by_horizon)
    if smallest < 0.05 * largest:
        ax.set_yscale("log")
    else:
        ax.set_ylim(bottom=0)
    ax.xaxis.get_major_locator().set_params(integer=True)
    legend(ax, room=0.25, loc="upper left")
    return ax


def errors(result: Any, ax: Axes | None = None) -> Axes:
    """Draw each signal's root mean square error before and after, in units of its spread.

    The errors are those of the rows that a fit compares.

    Parameters
    ----------
    result : Predictions or Diagnosis
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
    found = predictions_of(result)
    ax = axes_of(ax)
    place = np.arange(len(found.names))[::-1]
    unit = np.where(found.spread > 0, found.spread, np.nan)
    before = 100 * found.before.by_signal / unit
    after = 100 * found.after.by_signal / unit
    ax.hlines(place, np.fmin(before, after), np.fmax(before, after), color=GREY, lw=1.1)
    if changed(found):
        ax.plot(before, place, "o", color=BEFORE, ms=4.5, label=found.before.name)
    ax.plot(after, place, "s", color=AFTER, ms=4.2, label=found.after.name)
    ax.set(yticks=place, yticklabels=found.names, ylim=(-0.7, len(found.names) + 1.6))
    after_steps = f"after {found.rows_after} step{'s' * (found.rows_after > 1)}"
    ax.set(xscale="log", xlabel=f"error {after_steps} [% of the signal's spread]")
    plain_log(ax)
    ax.tick_params(axis="y", labelsize=FONT - 1)
    legend(ax, loc="upper left", ncols=2, columnspacing=1.0, handletextpad=0.2)
    return ax


def calibration(result: Any, ax: Axes | None = None) -> Axes:
    """Draw a histogram of the predicted probabilities of values below the measurements.

    It is level at 100 % if predictions are calibrated, raised at both ends if they are too sure,
    and in the middle if they are too cautious. The grey band holds 99 % of the bins of independent
    calibrated predictions.

    Parameters
    ----------
    result : Predictions or Diagnosis
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
    found = predictions_of(result)
    ax = axes_of(ax)
    edges = np.linspace(0, 1, BINS + 1)
    counted = [(side, color, style) for side, color, style, _ in sides(found) if len(side.pit)]
    if not counted:
        return empty(ax, "No simulation came to its end.")
    half = 100 * Z_99 * np.sqrt((BINS - 1) / len(found.after.pit)) if len(found.after.pit) else 0.0
    ax.axhspan(max(0.0, 100 - half), 100 + half, color=GREY, alpha=0.25, lw=0)
    for side, color, style in counted:
        percentage = 100 * BINS * np.histogram(side.pit, edges)[0] / len(side.pit)
        ax.stairs(percentage, edges, color=color, lw=1.8, ls=style, label=side.name)
    ax.set(
        xlim=(0, 1),
        xlabel="predicted probability of less",
        ylabel="measurements [% of the expected]",
    )
    ax.set_ylim(bottom=0)
    legend(ax, room=0.22, loc="upper left")
    return ax
