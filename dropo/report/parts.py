"""Sections that a fit's and a diagnosis' page share."""

from functools import partial
from html import escape

import numpy as np

from dropo import plots
from dropo.core.records.predictions import LEVEL, Predictions, Side
from dropo.plots.motion import changed, sides, telling
from dropo.report.folder import Result
from dropo.report.page import Cell, Section, figure, grid, legend, paragraph, percent, table
from dropo.report.svg import picture, rows

SMALL = (4.2, 2.3)  # [in] a picture of one signal
# by how much a share must be off beside its error for predictions to be too sure, or too cautious
FAR = 0.04
CLOSE = 0.09
WITHOUT = (
    "predictions.npz is not in the folder: `dropo fit --out` and `dropo diagnose --out` "
    "keep it, and in Python"
    " dropo.predict(problem, fit).save(folder) writes it."
)


def motion(found: Predictions | None, more: str = "") -> Section:
    """Measured against simulated trajectories, before and after. more: a sentence on the bands."""
    title = "Measured and simulated motion"
    if found is None:
        return Section(title, "", paragraph(f"No motion is shown: {WITHOUT}"))
    horizon = found.measured.shape[1]
    seen = "No fit has seen these data." if found.held_out else "These data were fitted to."
    lead = (
        f"Each line starts again from a measurement after {horizon} control "
        f"step{'s' * (horizon > 1)}; bands should hold {percent(LEVEL)}"
        f" of the dots. {more}{' ' * bool(more)}{seen}"
    )
    before = [(found.before.name, "before", False)] if changed(found) else []
    key = legend(("measured", "ink", True), *before, (found.after.name, "after", False))
    pictures = [
        figure(
            picture(
                partial(plots.trajectory, found, signal), _motion_text(found, signal), size=SMALL
            ),
            "",
        )
        for signal in telling(found)
    ]
    rest = len(found.names) - len(pictures)
    body = (
        key
        + grid(*pictures)
        + (
            paragraph(
                f"Shown are the signals that {'change' if changed(found) else 'err'} most; "
                f"{rest} more were measured."
            )
            if rest
            else ""
        )
    )
    return Section(title, lead, body)


def _motion_text(found: Predictions, signal: str) -> str:
    i = found.names.index(signal)
    held = [
        f"The band of {side.name} holds {percent(inside(found, side, i))} of the measurements."
        for side, *_ in sides(found)
    ]
    return f"Lines over time: {signal}, measured and simulated. {' '.join(held)}"


def inside(found: Predictions, side: Side, i: int) -> float:
    """The share of the measurements of signal i inside the band."""
    low, high = side.band[..., i]
    return float(np.mean((found.measured[..., i] >= low) & (found.measured[..., i] <= high)))


def errors(found: Predictions | None, more: str = "") -> Section | None:
    """Error by horizon and by signal, and calibration. more: HTML beneath."""
    if found is None:
        return None
    last = int(found.horizons[-1])
    before, after = (percent(side.by_horizon[-1]) for side in (found.before, found.after))
    ahead = (
        f"{f'from {before} to {after}' if changed(found) else after} of the motion's spread "
        f"after {last} steps"
    )
    shown = (
        [
            figure(
                picture(
                    lambda ax: plots.horizon(found, ax),
                    f"Lines: prediction errors by horizon, {ahead}.",
                ),
                "Error by how far ahead",
                f"Root mean square over all signals: {ahead}.",
            )
        ]
        if last > 1
        else []
    )
    told = _worst(found)
    svg = picture(
        lambda ax: plots.errors(found, ax),
        f"Dots: error of each signal. {told}",
        size=rows(len(found.names)),
    )
    shown.append(figure(svg, "Error by signal", told))
    shown.append(
        figure(
            picture(
                lambda ax: plots.calibration(found, ax),
                f"Histogram of predicted probabilities. {calibrated(found)}",
            ),
            "Calibration",
            calibrated(found),
        )
    )
    lead = (
        "Orange before, blue after. " if changed(found) else ""
    ) + "Percentages are of each signal's own spread in the data."
    return Section("How good predictions are", lead, grid(*shown) + more)


def _worst(found: Predictions) -> str:
    """The signal that changes most, or errs most where there is one model alone."""
    worst = telling(found, 1)
    i = found.names.index(worst[0]) if worst else 0
    before, after = (
        f"{side.by_signal[i]:.3g} {found.units[i]}".strip() for side in (found.before, found.after)
    )
    return (
        f"{found.names[i]} changes most, from {before} to {after}."
        if changed(found)
        else f"{found.names[i]} is off most, by {after}."
    )


def calibrated(found: Predictions) -> str:
    """What the probabilities say, in a sentence."""
    pit = found.after.pit
    if not len(pit):
        return "No simulation came to its end."
    outside, middle = shares(found)
    said = (
        f"{percent(outside)} of the measurements lie in the outer tenth of the prediction, "
        f"{percent(middle)} in its inner half"
    )
    cautious = middle - 0.5 > CLOSE + 3 * np.sqrt(0.25 / len(pit))
    verdict = (
        "too sure"
        if too_sure(found)
        else "more cautious than needed"
        if cautious
        else "about as sure as they should be"
    )
    return f"{said}: {'after, ' * changed(found)}predictions are {verdict}."


def too_sure(found: Predictions) -> bool:
    """Whether clearly more than a tenth of the measurements lie in the outer tenth of the
    prediction after.
    """
    return bool(shares(found)[0] - 0.1 > FAR + 3 * np.sqrt(0.09 / max(len(found.after.pit), 1)))


def shares(found: Predictions) -> tuple[float, float]:
    """Of the measurements in the outer tenth, and in the inner half of the prediction after; 0 of
    none.
    """
    pit = found.after.pit
    counted = (pit < 0.05) | (pit > 0.95), (pit > 0.25) & (pit < 0.75)
    return float(counted[0].sum() / max(len(pit), 1)), float(counted[1].sum() / max(len(pit), 1))


def made(result: Result) -> Section:
    """The command that repeats the run, and everything that it depends on."""
    record = result.record
    content = result.content
    how = result.made
    command = how.get("command")
    told = {
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
    } | {
        f"setting: {name}": value
        for name, value in record.get("settings", {}).items()
        if value is not None
    }
    kept = [
        [Cell(name), Cell(_listed(value), words=True)]
        for name, value in told.items()
        if value not in (None, [])
    ]
    without = (
        "A command is kept when its run ends."
        if result.kind == "unfinished"
        else "No command was kept: this was run from Python."
    )
    repeat = f"<pre><code>{escape(command)}</code></pre>" if command else paragraph(without)
    lead = (
        "The same command on the same data and model gives the same numbers, whatever the "
        "number of threads."
    )
    return Section(
        "How this was made",
        lead if command else "",
        repeat + table(["what", "value"], kept, told=True),
    )


def _listed(value: object) -> str:
    return ", ".join(map(str, value)) if isinstance(value, list) else str(value)


def _count(value: int | None) -> str | None:
    return None if value is None else f"{value:,}"


def _seconds(value: float | None) -> str | None:
    return None if value is None else f"{value:.1f} s"
