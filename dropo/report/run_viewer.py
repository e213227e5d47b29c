"""The motion of a whole run as a picture that zooms, drawn by the page itself."""

import base64
import json
from html import escape
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dropo.core.numerics.spans import spans_of
from dropo.core.records.predictions import Predictions, WholeRun
from dropo.core.services.validation import Array
from dropo.plots.motion import changed, telling
from dropo.report.page import legend, plain

MOST = 12
"""Signals in the picture at most."""
NUMBERS = 150_000
"""Numbers in the picture at most, of two bytes each: fewer signals where the run is long."""
LEVELS = 32_000
"""Levels to either side of 0 that a number is written with."""
LOST = -32_768
"""The level of what is not known, such as a simulation that failed."""


def viewer(found: Predictions) -> str:
    """Draw a run that zooms, with a strip of what predictions miss beneath.

    Parameters
    ----------
    found : Predictions
        With its run.

    Returns
    -------
    str
        HTML; empty where there is no run, or no signal moves.
    """
    run = found.run
    signals = telling(found, MOST) if run is not None else []
    if run is None or not signals or not len(run.measured):
        return ""
    both = changed(found)
    most = max(1, NUMBERS // (len(run.measured) * (3 if both else 2)))
    columns = [found.names.index(name) for name in signals[:most]]
    numbers, signs = _written(run, columns, both)
    about = {
        "step": None if np.isnan(found.seconds) else found.seconds,
        "length": run.length,
        "steps": len(run.measured),
        "heldOut": _spans(run.held_out),
        "signals": [
            {"name": found.names[i], "unit": found.units[i], "series": own}
            for i, own in zip(columns, signs, strict=True)
        ],
    }
    options = "".join(
        f'<option value="{k}">{escape(found.names[i])}</option>' for k, i in enumerate(columns)
    )
    before = [(found.before.name, "before", False)] if both else []
    key = legend(("measured", "ink", True), *before, (found.after.name, "after", False))
    text = f"{said(found, run)} {_missed(found, run, columns[0], both)}"
    buttons = "".join(
        f'<button type="button" data-do="{do}" aria-label="{label}">{sign}</button>'
        for do, label, sign in (
            ("in", "closer", "+"),
            ("out", "farther", "−"),
            ("back", "earlier", "◀"),
            ("on", "later", "▶"),
            ("all", "the whole run", "all"),
        )
    )
    return (
        f'<figure class="run" data-about="{escape(json.dumps(about))}" data-numbers="{numbers}">'
        f'<div class="bar"><label>signal <select>{options}</select></label>'
        f'<span class="zoom">{buttons}</span></div>{key}'
        f'<canvas class="motion" role="img" tabindex="0" aria-label="{escape(text)}"></canvas>'
        '<canvas class="missed" role="img" aria-label="Strip: measured less predicted, over the '
        'same time."></canvas><div class="where"><i></i></div><p class="reading"></p>'
        f"<figcaption>{escape(text)} Drag across a part to see it closer; the strip beneath is "
        "measured less predicted.</figcaption></figure>"
    )


def said(found: Predictions, run: WholeRun) -> str:
    """Say which run it is, and how predictions start again.

    Parameters
    ----------
    found : Predictions
        What it is a part of.
    run : WholeRun
        The run.

    Returns
    -------
    str
    """
    length = plain(len(run.measured) * found.seconds, 3)
    time = f", {length} s" if np.isfinite(found.seconds) else ""
    steps = len(run.measured)
    again = "Predictions go from its first row to its end by commands alone."
    if run.length < steps:
        each = plain(run.length * found.seconds, 3)
        every = f" ({each} s)" if np.isfinite(found.seconds) else ""
        again = f"Predictions start again from a measurement every {run.length} steps{every}."
    seen = ""
    if run.held_out.any() and not run.held_out.all():
        seen = " Shaded is what no fit has seen."
    return f"Run {run.trajectory + 1}, {steps:,} steps{time}. {again}{seen}"


def _missed(found: Predictions, run: WholeRun, i: int, both: bool) -> str:
    """The errors of the signal that is shown first, in a sentence."""
    errors = []
    for line in (run.before, run.after):
        missed = run.measured[:, i] - line[:, i]
        known = np.isfinite(line[:, i]).any()
        errors.append(float(np.sqrt(np.nanmean(np.square(missed)))) if known else np.nan)
    after = f"{plain(errors[1], 3)} {found.units[i]}".rstrip()
    if not both:
        return f"{found.names[i]} is off by {after} (root mean square)."
    return f"{found.names[i]} is off by {plain(errors[0], 3)} before, {after} after."


def _spans(held_out: NDArray[np.bool_]) -> list[list[int]]:
    """First and last + 1 step of every span held out; none where all or nothing is."""
    if held_out.all() or not held_out.any():
        return []
    return spans_of(held_out).tolist()


def _written(run: WholeRun, columns: list[int], both: bool) -> tuple[str, list[Any]]:
    """The numbers as base64 of 16-bit integers, and how each series is read back.

    Errors have levels of their own, since they may be much smaller than the motion.
    """
    written: list[Array] = []
    signs = []
    for i in columns:
        measured = run.measured[:, i]
        lines = (run.before, run.after) if both else (run.after,)
        series = [_levels(one) for one in (measured, *(measured - line[:, i] for line in lines))]
        written += [levels for levels, *_ in series]
        signs.append([[base, scale] for _, base, scale in series])
    data = np.concatenate(written).astype("<i2").tobytes()
    return base64.b64encode(data).decode(), signs


def _levels(series: Array) -> tuple[Array, float, float]:
    """Levels, base and scale: what is shown is base + scale * level."""
    finite = series[np.isfinite(series)]
    if not len(finite):
        return np.full(len(series), LOST), 0.0, 1.0
    low, high = float(finite.min()), float(finite.max())
    base = (low + high) / 2
    scale = max(high - low, 1e-300) / (2 * LEVELS)
    levels = np.where(np.isfinite(series), np.round((series - base) / scale), LOST)
    return levels, base, scale
