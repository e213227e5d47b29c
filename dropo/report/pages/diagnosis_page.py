"""The page of a diagnosis."""

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from dropo import plots
from dropo.core.records.figure_data import FigureData
from dropo.core.records.fits.fit_choices import ExcludedSpan
from dropo.diagnosis.findings.accuracy.replay import OddReplay
from dropo.diagnosis.findings.limits.detectable import Detectable
from dropo.diagnosis.parts import (
    Alternative,
    Cause,
    Leader,
    Suspect,
    are_stated,
    effect_in_words,
)
from dropo.diagnosis.regression.result import WiringFault
from dropo.diagnosis.result import MISWIRED
from dropo.plots.causes import BRIDGE, in_order, words
from dropo.report import parts
from dropo.report.folder import Result
from dropo.report.model_changes import changes_part
from dropo.report.page import (
    Cell,
    Section,
    figure,
    grid,
    notes,
    page,
    paragraph,
    percent,
    plain,
    table,
)
from dropo.report.robot.picture import where_section
from dropo.report.svg import picture
from dropo.report.svg import rows as svg_rows

# [in] of a picture with a row for each effect
ROW = 0.42
HEAD = 0.6
SHOWN = 3
"""Causes in a card; the table has all."""
RESPONSE = "response to the effect"
GOOD = {"consistent": "good", "explained": "good", "partly": "bad", "unexplained": "bad"}


def diagnosis_page(result: Result) -> str:
    """Write the page of a diagnosis.

    Parameters
    ----------
    result : Result
        The diagnosis, its figures and its predictions.

    Returns
    -------
    str
        The HTML file's text.
    """
    content = result.content
    found = result.figures
    predictions = result.predictions
    units = {}
    if predictions is not None:
        units = dict(zip(predictions.names, predictions.units, strict=True))
    sections: list[Section | None] = [where_section(result, changes_part(result))]
    if found is not None:
        sections.append(_searched(found))
    sections.append(causes_section(content))
    if found is not None:
        sections.append(_evidence(found, units))
    sections += [
        _fitted(content, result.record),
        parts.motion(predictions, result.media),
        parts.errors(predictions, _errors(content) + _replay(content)),
        _remaining(content, found),
        _learned(content),
        _detectable(content),
        parts.made(result),
    ]
    kicker = f"dropo diagnose · {result.problem}"
    headline = content["headline"].replace("+-", "±")
    shown = [section for section in sections if section is not None]
    return page(kicker, headline, _cards(content), shown)


def _cards(content: dict[str, Any]) -> list[tuple[str, str, str]]:
    """The cards beneath the headline: name, value, and whether it is good or bad."""
    before = content["baseline"]["held_out_log_likelihood"]
    gain = content["extended"]["held_out_log_likelihood"] - before
    return [
        *finding_cards(content),
        ("gain on data held out", f"{gain:.3g} nats a step", ""),
        ("simulator steps", f"{content['simulator_steps']:,}", ""),
        ("time", f"{content['wall_time_s']:.1f} s", ""),
    ]


def finding_cards(content: dict[str, Any]) -> list[tuple[str, str, str]]:
    """Make the cards that every diagnosis has.

    Parameters
    ----------
    content : dict
        Of diagnosis.json.

    Returns
    -------
    list of (str, str, str)
        The verdict and the causes, or what is missing acts like, each as name, value, and whether
        it is good or bad.
    """
    named = [words(_label(cause)) for cause in _causes_of(content)]
    more = f" and {len(named) - SHOWN} more" if len(named) > SHOWN else ""
    causes = (", ".join(named[:SHOWN]) or "none") + more
    return [
        ("verdict", content["verdict"], GOOD.get(content["verdict"], "")),
        ("acts like" if named and not are_stated(content["verdict"]) else "cause", causes, ""),
    ]


def _causes_of(content: dict[str, Any]) -> list[Cause]:
    """The causes that diagnosis.json holds."""
    return [Cause.from_json(saved) for saved in content["causes"]]


def _label(cause: Cause) -> str:
    """An effect's label, such as "joint_damping:elbow" or "contact_stiffness.margin"."""
    target = f":{cause.target}" if cause.target else ""
    variant = f".{cause.variant}" if cause.variant else ""
    return f"{cause.effect}{target}{variant}"


def _searched(found: FigureData) -> Section:
    """The candidates of every round with their gains, and which the data cannot distinguish."""
    shown = []
    ended = ""
    for i, bars in enumerate(found.rounds):
        if not bars:
            ended = paragraph(f"In round {i + 1} no effect looked likely enough to be fitted.")
            continue
        rows = in_order(bars)
        accepted = [bar for bar in bars if bar.accepted]
        gains = []
        for bar in rows:
            gain = plain(bar.gain, 4) if bar.gain is not None else "same response"
            gains.append(f"{words(bar.label)} {gain}")
        listed = "; ".join(gains)
        named = words(accepted[0].label) if accepted else "nothing is confirmed"
        title = f"Round {i + 1}: {named}"
        caption = ""
        if any(not bar.told for bar in bars):
            caption = "A bracket joins what these data cannot distinguish. "
        caption += (
            f"An effect is confirmed beyond {found.needed:.1f} nats (dashed) and well beyond "
            "its error (dark line)."
        )
        text = f"Bars: nats that each effect gains on data held out. {listed}."
        svg = picture(
            partial(plots.candidates, found, found=i),
            text,
            size=svg_rows(max(len(rows), 2), ROW, HEAD),
        )
        shown.append(figure(svg, title, caption))
    names = found.similarity.labels
    if len(names) > 1:
        cosines = np.array(found.similarity.cosines) - 2 * np.eye(len(names))
        one, two = np.unravel_index(int(cosines.argmax()), cosines.shape)
        most_alike = (
            f"Most alike are {words(names[int(one)])} and {words(names[int(two)])}, with "
            f"{cosines[one, two]:.2f}."
        )
        text = f"Matrix of similarities between effects. {most_alike}"
        svg = picture(partial(plots.similarity, found), text)
        caption = f"{most_alike} At 1 no data of this kind tell them apart."
        shown.append(figure(svg, "How alike the effects are in these data", caption))
    lead = (
        "The effects that looked most likely, each fitted with everything else, evaluated on data "
        "that nothing was fitted to."
    )
    return Section("What was tried", lead, grid(*shown) + ended)


def causes_section(content: dict[str, Any]) -> Section:
    """Show the table of causes, and what they may be confused with.

    Parameters
    ----------
    content : dict
        Of diagnosis.json.

    Returns
    -------
    Section
    """
    causes = _causes_of(content)
    rows = [_estimate(cause, name) for cause in causes for name in cause.estimate or ("",)]
    header = [
        "effect",
        "quantity",
        "added",
        "standard error",
        "unit",
        "the model has",
        "nats a step",
        "standard error",
        "p-value",
    ]
    remarks = [_confused(cause, other) for cause in causes for other in cause.confused_with]
    if rows:
        remarks += map(fault_remark, content.get("faults", []))
    for cause in causes:
        if cause.formula:
            remarks.append(f"{cause.place}: {cause.called or 'a law without a name'}.")
        if not are_stated(content["verdict"]):
            differs = f"its size differs with {cause.acts_like}"
            why = differs if cause.acts_like else "something remains unexplained beside it"
            remarks.append(f"{words(_label(cause))} only acts like the cause: {why}.")
    lead = ""
    body = paragraph("No effect was confirmed on the data held out.")
    if rows:
        lead = "What was added to the model, and what it gains on data held out."
        if content.get("faults"):
            lead = (
                "Columns of the data that are not what the model takes them for, and what forces "
                "gain on data held out where they are read right."
            )
        body = table(header, rows)
    return Section("Causes", lead, body + (notes(remarks) if remarks else ""))


def _estimate(cause: Cause, name: str) -> list[Cell]:
    """The row of one quantity of a cause, or of one that has none."""
    found = cause.estimate.get(name)
    size = [Cell("–")] * 4
    if found is not None:
        size = [
            Cell(f"{found.value:+.4g}", found.value),
            Cell(plain(found.se, 2), found.se) if np.isfinite(found.se) else Cell("–"),
            Cell(found.unit),
            Cell("–" if found.model is None else plain(found.model)),
        ]
    return [
        Cell(words(_label(cause))),
        Cell(name or "–"),
        *size,
        Cell(plain(cause.held_out_gain, 3), cause.held_out_gain),
        Cell(plain(cause.held_out_gain_se, 2)),
        Cell(_p_value(cause.p_value), cause.p_value),
    ]


def _learned(content: dict[str, Any]) -> Section | None:
    """The forces that were learned from what nothing explains."""
    saved = content.get("learned")
    if not saved:
        return None
    rows = [
        [
            Cell(one["joint"]),
            Cell(", ".join(one["variables"])),
            Cell(plain(one["largest"], 2), one["largest"]),
            Cell(one["unit"]),
        ]
        for one in saved["forces"]
    ]
    kept = "They are in the extended model." if saved["used"] else "They are not in the model."
    lead = (
        f"Learned, not named: forces that take away {saved['share']:.0%} of what is unexplained on "
        f"data held out, over all horizons. {kept}"
    )
    header = ["joint", "a function of", "up to", "unit"]
    return Section("Learned forces", lead, table(header, rows))


def _detectable(content: dict[str, Any]) -> Section | None:
    """The sizes of usual effects that the data would have shown, where none was found."""
    found = [Detectable.from_json(saved) for saved in content.get("detectable", [])]
    if not found:
        return None
    rows = []
    for one in found:
        size = Cell("at no size") if one.size is None else Cell(plain(one.size, 2), one.size)
        effect = Cell(words(effect_in_words(one.effect, None, one.variant)))
        place = Cell(one.target or "all")
        rows.append([effect, place, Cell(one.quantity), size, Cell(one.unit.removesuffix("1"))])
    lead = (
        "The smallest size of each usual effect at which these data are expected to confirm it: "
        "what is smaller may be there."
    )
    header = ["effect", "where", "quantity", "shown from", "unit"]
    return Section("What these data would have shown", lead, table(header, rows))


def fault_remark(fault: dict[str, Any]) -> str:
    """Say what is wrong with columns of the data, and what to change.

    Parameters
    ----------
    fault : dict
        Of diagnosis.json.

    Returns
    -------
    str
    """
    return WiringFault.from_json(fault).sentences


def _fitted(content: dict[str, Any], record: dict[str, Any]) -> Section | None:
    """The declared parameters as fitted, beside their search intervals."""
    declared = {entry["name"]: entry for entry in record.get("parameters", ())}
    rows = []
    for name, value in content.get("parameters", {}).items():
        if name not in declared:
            continue
        entry = declared[name]
        bounds = [Cell(plain(entry[end]), entry[end]) for end in ("low", "high")]
        rows.append([Cell(name), Cell(entry["unit"]), Cell(plain(value), value), *bounds])
    if not rows:
        return None
    lead = (
        "Declared by the problem, and fitted together with the causes; a fit of the extended "
        "problem says how well they are known."
    )
    header = ["parameter", "unit", "value", "searched from", "to"]
    return Section("Parameters", lead, table(header, rows))


def _errors(content: dict[str, Any]) -> str:
    """The table of errors on held-out data by horizon, as fractions of the motion and by unit."""
    nominal = content.get("nominal", {}).get("horizons")
    baseline = content["baseline"]["horizons"]
    models = [("as it is", baseline)]
    if nominal:
        models = [("as it came", nominal), ("fitted", baseline)]
    if content["causes"]:
        models.append(("with what was found", content["extended"]["horizons"]))
    rows = []
    for at in zip(*(horizons for _, horizons in models), strict=True):
        steps = at[0]["steps"]
        seconds = at[0]["seconds"]
        last = at[-1]
        in_seconds = f", {plain(seconds, 3)} s" if seconds else ""
        after = Cell(f"{steps} step{'s' * (steps > 1)}{in_seconds}", steps)
        fractions = [*(entry["rmse"] for entry in at), last["noise"]]
        cells = [_cell(value, percent) for value in fractions]
        rows.append([after, Cell("of the motion"), *cells])
        for unit in last["units"]:
            by_unit = [
                *(entry["units"][unit]["rmse"] for entry in at),
                last["units"][unit]["noise"],
            ]
            rows.append([after, Cell(unit), *(_cell(value, _short) for value in by_unit)])
    if not rows:
        return ""
    return table(["after", "unit", *(name for name, _ in models), "by sensor noise"], rows)


def _replay(content: dict[str, Any]) -> str:
    """The table of whole runs held out, by commands alone, where there are such."""
    replayed = content.get("replay")
    if not replayed:
        return ""
    title = f"whole runs held out ({len(replayed['runs'])}), by commands alone"
    rows = []
    for unit, errors in replayed["units"].items():
        values = (errors["nominal"], errors["extended"])
        rows.append([Cell(title), Cell(unit), *(_cell(value, _short) for value in values)])
    return table(["of", "unit", "as it came", "with what was found"], rows)


def _cell(value: float | None, shown: Callable[[float], str]) -> Cell:
    """An error; None where the simulation diverges in every window."""
    return Cell("diverges") if value is None else Cell(shown(value), value)


def _short(value: float) -> str:
    """A number of three digits."""
    return plain(value, 3)


def _excluded_span(span: ExcludedSpan) -> str:
    """A span that was left out."""
    where = f"{'held-out ' * span.held_out}run {span.run}, {span.start:.2f} to {span.end:.2f} s"
    error = f"{plain(span.error, 3)} {span.unit}"
    return f"Left out: {where}, where {span.signal} is {error} off after {plain(span.after, 3)} s."


def _outlier_run(run: dict[str, Any]) -> str:
    """A run that disagrees with the others."""
    which = f"{'Held-out run' if run['held_out'] else 'Run'} {run['run']}"
    own = f"{plain(run['value'])} ± {plain(run['se'], 2)} {run['unit']}".rstrip()
    return (
        f"{which} disagrees with the others: its {run['parameter']} is {own}, theirs "
        f"{plain(run['others'])}."
    )


def _p_value(value: float) -> str:
    """A p-value of one digit."""
    return "< 1e-300" if value < 1e-300 else f"{value:.1g}"


def _confused(cause: Cause, other: Alternative) -> str:
    """What the data cannot tell from a cause."""
    place = effect_in_words(other.effect, other.target, "", other.formula)
    more = f" To tell: {other.to_tell}." if other.to_tell else ""
    return f"{words(_label(cause))} may as well be {place}: {other.why}.{more}"


def _evidence(found: FigureData, units: dict[str, str]) -> Section | None:
    """For every cause: its residuals, its size by regime, its size over time."""
    shown = []
    for i, one in enumerate(found.axes):
        before = float(np.sqrt(np.mean(np.square(one.before))))
        after = float(np.sqrt(np.mean(np.square(one.after))))
        text = (
            f"Root mean square {before:.3g} {one.unit} without it, {after:.3g} {one.unit} with it."
        )
        if one.axis == RESPONSE:
            text += (
                " Over what the effect changes in the prediction: a slope says that it is there."
            )
        svg = picture(
            partial(plots.residuals, found, found=i),
            f"Dots: error of {one.signal} over {one.axis}. {text}",
        )
        shown.append(figure(svg, f"{words(one.label)}: errors over {one.axis}", text))
    for i, curve in enumerate(found.laws):
        off = np.subtract(curve.force, curve.law) / np.maximum(curve.error, 1e-300)
        text = (
            "The force that is missing without the law, fitted in parts of the data, and the law. "
            f"They differ by {float(np.sqrt(np.mean(off**2))):.2g} standard errors."
        )
        svg = picture(
            partial(plots.law, found, found=i),
            f"Force over {curve.axis}. {text}",
        )
        shown.append(figure(svg, f"{words(curve.label)}: force over {curve.axis}", text))
    for i, part in enumerate(found.sizes):
        listed = ", ".join(
            f"{size:.0%} ± {196 * error:.0f} %"
            for size, error in zip(part.size, part.error, strict=True)
        )
        text = (
            f"One size in all parts has p = {part.p_value:.2g}: level for a true cause, sloped "
            "for what only acts like it."
        )
        draw = partial(plots.sizes, found, found=i, unit=units.get(part.variable.strip("|"), ""))
        svg = picture(draw, f"Size in parts of the data by {part.variable}: {listed}.")
        shown.append(figure(svg, f"{words(part.label)}: size by {part.variable}", text))
    for i, sums in enumerate(found.sums):
        peak = float(np.abs(sums.score).max(initial=0.0))
        text = f"The largest departure is {peak:.2f}; beyond {BRIDGE} the size changes with time."
        svg = picture(
            partial(plots.changes, found, found=i),
            f"Summed scores over the data. {text}",
        )
        shown.append(figure(svg, f"{words(sums.label)}: does its size change?", text))
    if not shown:
        return None
    lead = "A true cause has one size everywhere, and leaves no pattern behind."
    return Section("Is it the cause?", lead, grid(*shown))


def _remaining(content: dict[str, Any], found: FigureData | None) -> Section:
    """What is not explained, what was left out, and what was not confirmed."""
    suspects = [Suspect.from_json(saved) for saved in content["suspects"]]
    remarks = [f"It shows in {where}." for where in content["remaining"]["where"]]
    remarks += [f"{words(one.label)} looked likely and was not confirmed." for one in suspects]
    leaders = [Leader.from_json(saved) for saved in content["leaders"]]
    remarks += [f"{leader.sentence}." for leader in leaders]
    remarks += [_outlier_run(run) for run in content.get("odd_runs", [])]
    excluded = (content.get("disturbances") or {}).get("spans", [])
    remarks += [_excluded_span(ExcludedSpan.from_json(span)) for span in excluded]
    replayed = content.get("replay") or {}
    remarks += [str(OddReplay(**one)) for one in replayed.get("odd", [])]
    remarks += content.get("numerics", [])
    remarks += [*content.get("undetermined", []), *content.get("warnings", [])]
    nothing = MISWIRED if content.get("faults") else "Nothing that these data could show."
    body = notes(remarks) if remarks else paragraph(nothing)
    if found is not None:
        forces = found.forces
        worst = int(np.argmax(forces.before))
        text = (
            f"At {forces.names[worst]} {forces.before[worst]:.3g} {forces.units[worst]} "
            f"before, {forces.after[worst]:.3g} after."
        )
        svg = picture(
            partial(plots.forces, found),
            f"Bars: unexplained force at each joint. {text}",
            size=svg_rows(len(forces.names), ROW, HEAD),
        )
        body += grid(figure(svg, "Forces that nothing explains", text))
    return Section("What remains unexplained", "", body)
