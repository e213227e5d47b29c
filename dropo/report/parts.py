"""Sections that a fit's and a diagnosis' page share."""

from functools import partial
from html import escape

import numpy as np

from dropo import plots
from dropo.core.records.predictions import LEVEL, Predictions, Side
from dropo.plots.motion import changed, sides, telling
from dropo.report.folder import Media, Result
from dropo.report.page import Cell, Section, figure, grid, legend, paragraph, percent, table
from dropo.report.robot.video_part import video_part
from dropo.report.run_viewer import viewer
from dropo.report.svg import picture, rows

SMALL = (4.2, 2.3)
"""Size of the figure of one signal [in]."""
FAR = 0.04
"""By how much more measurements than a tenth must lie in the outer tenth of predictions, beside
chance, for these to be too sure."""
CLOSE = 0.09
"""By how much more measurements than a half must lie in the inner half of predictions, beside
chance, for these to be too cautious."""
WITHOUT = (
    "predictions.npz is not in the folder: `dropo fit --out` and `dropo diagnose --out` keep it, "
    "and in Python dropo.predict(problem, fit).save(folder) writes it."
)


def motion(found: Predictions | None, media: Media | None, more: str = "") -> Section:
    """Show measured and simulated trajectories.

    Parameters
    ----------
    found : Predictions or None
        None where the folder has none.
    media : Media or None
        What was rendered for the page.
    more : str
        A sentence on the bands.

    Returns
    -------
    Section
    """
    title = "Measured and simulated motion"
    if found is None:
        return Section(title, "", paragraph(f"No motion is shown: {WITHOUT}"))
    steps = found.measured.shape[1]
    data = "No fit has seen these data." if found.held_out else "These data were fitted to."
    lead = (
        f"Each line starts again from a measurement after {steps} control step{'s' * (steps > 1)}; "
        f"bands should hold {percent(LEVEL)} of the dots. {more}{' ' * bool(more)}{data}"
    )
    before = [(found.before.name, "before", False)] if changed(found) else []
    key = legend(("measured", "ink", True), *before, (found.after.name, "after", False))
    pictures = []
    for signal in telling(found):
        draw = partial(plots.trajectory, found, signal)
        svg = picture(draw, _motion_text(found, signal), size=SMALL)
        pictures.append(figure(svg, ""))
    body = video_part(media) + viewer(found) + key + grid(*pictures)
    rest = len(found.names) - len(pictures)
    if rest:
        most = "change" if changed(found) else "err"
        body += paragraph(f"Shown are the signals that {most} most; {rest} more were measured.")
    return Section(title, lead, body)


def _motion_text(found: Predictions, signal: str) -> str:
    """What the figure of a signal shows, in words."""
    i = found.names.index(signal)
    held = [
        f"The band of {side.name} holds {percent(inside(found, side, i))} of the measurements."
        for side, *_ in sides(found)
    ]
    return f"Lines over time: {signal}, measured and simulated. {' '.join(held)}"


def inside(found: Predictions, side: Side, i: int) -> float:
    """Compute how much of a signal is inside a band.

    Parameters
    ----------
    found : Predictions
        What was measured.
    side : Side
        Predictions of one model, with their band.
    i : int
        The signal.

    Returns
    -------
    float
        Fraction of the measurements.
    """
    low, high = side.band[..., i]
    return float(np.mean((found.measured[..., i] >= low) & (found.measured[..., i] <= high)))


def errors(found: Predictions | None, more: str = "") -> Section | None:
    """Show errors by horizon and by signal, and the calibration.

    Parameters
    ----------
    found : Predictions or None
        None where the folder has none.
    more : str
        HTML beneath.

    Returns
    -------
    Section or None
        None without predictions.
    """
    if found is None:
        return None
    last = int(found.horizons[-1])
    before = percent(found.before.by_horizon[-1])
    after = percent(found.after.by_horizon[-1])
    change = f"from {before} to {after}" if changed(found) else after
    ahead = f"{change} of the motion's spread after {last} steps"
    shown = []
    if last > 1:
        text = f"Lines: prediction errors by horizon, {ahead}."
        svg = picture(partial(plots.horizon, found), text)
        caption = f"Root mean square over all signals: {ahead}."
        shown.append(figure(svg, "Error by how far ahead", caption))
    worst = _worst(found)
    text = f"Dots: error of each signal. {worst}"
    svg = picture(partial(plots.errors, found), text, size=rows(len(found.names)))
    shown.append(figure(svg, "Error by signal", worst))
    text = f"Histogram of predicted probabilities. {calibrated(found)}"
    svg = picture(partial(plots.calibration, found), text)
    shown.append(figure(svg, "Calibration", calibrated(found)))
    lead = "Percentages are of each signal's own spread in the data."
    if changed(found):
        lead = f"Orange before, blue after. {lead}"
    return Section("How good predictions are", lead, grid(*shown) + more)


def _worst(found: Predictions) -> str:
    """The signal that changes most, or errs most where there is one model alone."""
    worst = telling(found, 1)
    i = found.names.index(worst[0]) if worst else 0
    before = f"{found.before.by_signal[i]:.3g} {found.units[i]}".strip()
    after = f"{found.after.by_signal[i]:.3g} {found.units[i]}".strip()
    if changed(found):
        return f"{found.names[i]} changes most, from {before} to {after}."
    return f"{found.names[i]} is off most, by {after}."


def calibrated(found: Predictions) -> str:
    """Say in a sentence whether predictions are too sure or too cautious.

    Parameters
    ----------
    found : Predictions
        Of which those of the second model are meant.

    Returns
    -------
    str
    """
    pit = found.after.pit
    if not len(pit):
        return "No simulation came to its end."
    outside, middle = shares(found)
    said = (
        f"{percent(outside)} of the measurements lie in the outer tenth of the prediction, "
        f"{percent(middle)} in its inner half"
    )
    cautious = middle - 0.5 > CLOSE + 3 * np.sqrt(0.25 / len(pit))
    verdict = "about as sure as they should be"
    if too_sure(found):
        verdict = "too sure"
    elif cautious:
        verdict = "more cautious than needed"
    return f"{said}: {'after, ' * changed(found)}predictions are {verdict}."


def too_sure(found: Predictions) -> bool:
    """Test whether clearly more than a tenth of the measurements lie in the outer tenth.

    Parameters
    ----------
    found : Predictions
        Of which those of the second model are meant.

    Returns
    -------
    bool
    """
    error = np.sqrt(0.09 / max(len(found.after.pit), 1))
    return bool(shares(found)[0] - 0.1 > FAR + 3 * error)


def shares(found: Predictions) -> tuple[float, float]:
    """Count the measurements in the outer tenth and in the inner half of their predictions.

    Parameters
    ----------
    found : Predictions
        Of which those of the second model are meant.

    Returns
    -------
    outer, inner : float
        Fractions of the measurements; 0 if there are none.
    """
    pit = found.after.pit
    outer = (pit < 0.05) | (pit > 0.95)
    inner = (pit > 0.25) & (pit < 0.75)
    count = max(len(pit), 1)
    return float(outer.sum() / count), float(inner.sum() / count)


def made(result: Result) -> Section:
    """Show the command that repeats the run, and everything that it depends on.

    Parameters
    ----------
    result : Result
        The run.

    Returns
    -------
    Section
    """
    record = result.record
    content = result.content
    how = result.made
    command = how.get("command")
    facts = {
        "method": record.get("method"),
        "seed": content.get("seed", record.get("seed")),
        "dropo": content.get("version", record.get("version")),
        **how.get("versions", {}),
        "data, SHA-256": record.get("data_sha256"),
        "model, SHA-256": record.get("model_sha256"),
        "transitions": _count(content.get("transitions", record.get("transitions"))),
        "simulator steps": _count(content.get("simulator_steps")),
        "evaluations": _count(content.get("objective_evaluations")),
        "wall time": _seconds(content.get("wall_time_s")),
    }
    for name, value in record.get("settings", {}).items():
        if value is not None:
            facts[f"setting: {name}"] = value
    cells = [
        [Cell(name), Cell(_listed(value), words=True)]
        for name, value in facts.items()
        if value not in (None, [])
    ]
    lead = ""
    if command:
        repeat = f"<pre><code>{escape(command)}</code></pre>"
        lead = (
            "The same command on the same data and model gives the same numbers, whatever the "
            "number of threads."
        )
    elif result.kind == "unfinished":
        repeat = paragraph("A command is kept when its run ends.")
    else:
        repeat = paragraph("No command was kept: this was run from Python.")
    return Section("How this was made", lead, repeat + table(["what", "value"], cells, told=True))


def _listed(value: object) -> str:
    """A value, or the values of a list with commas."""
    return ", ".join(map(str, value)) if isinstance(value, list) else str(value)


def _count(value: int | None) -> str | None:
    """A count with commas, or None."""
    return None if value is None else f"{value:,}"


def _seconds(value: float | None) -> str | None:
    """A time with its unit, or None."""
    return None if value is None else f"{value:.1f} s"
