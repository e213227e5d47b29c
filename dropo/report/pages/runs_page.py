"""The page of runs beside reference runs."""

from typing import Any

from dropo.core.services.tables import number
from dropo.diagnosis.parts import Estimate
from dropo.plots.causes import words
from dropo.report import parts
from dropo.report.folder import Result
from dropo.report.page import Cell, Section, notes, page, plain, table


def runs_page(result: Result) -> str:
    """Write the page of what differs in each run.

    Parameters
    ----------
    result : Result
        The comparison.

    Returns
    -------
    str
        The HTML file's text.
    """
    content = result.content
    runs = content["runs"]
    others = [run for run in runs if not run["reference"]]
    differing = sum(run["differs"] for run in others)
    cards = [
        ("differ", f"{differing} of {len(others)}", "bad" if differing else "good"),
        ("reference runs", str(len(runs) - len(others)), ""),
        ("simulator steps", f"{content['simulator_steps']:,}", ""),
    ]
    sections = [_runs(content), _numbers(content), parts.made(result)]
    return page(f"dropo diagnose · {result.problem}", content["headline"], cards, sections)


def _runs(content: dict[str, Any]) -> Section:
    """A row for each cause of each run, and one for a run without."""
    rows = []
    for run in content["runs"]:
        first = [
            Cell(run["run"]),
            Cell("reference" if run["reference"] else ""),
            Cell(number(run["p_value"], 1), run["p_value"]),
        ]
        if not run["causes"]:
            nothing = "nothing that was looked for" if run["differs"] else "nothing"
            rows.append([*first, Cell(nothing), Cell(""), Cell("")])
        for cause in run["causes"]:
            variant = f".{cause['variant']}" if cause["variant"] else ""
            target = f":{cause['target']}" if cause["target"] else ""
            label = words(f"{cause['effect']}{target}{variant}")
            sizes = [
                f"{name} {Estimate.from_json(one)}".replace("+-", "±")
                for name, one in cause["estimate"].items()
            ]
            alike = ", ".join(words(other) for other in cause["confused_with"])
            rows.append([*first, Cell(label), Cell(", ".join(sizes)), Cell(alike)])
    lead = (
        "Each run beside the reference runs, and each of these beside the others. p is the chance "
        f"of a normal run to be as far off; below {content['level']:g} a run differs."
    )
    header = ["run", "", "p", "differs in", "by", "cannot be told from"]
    remarks = [f"Taken as normal, when a cause is named: {one}." for one in content["tolerances"]]
    return Section("Runs", lead, table(header, rows) + (notes(remarks) if remarks else ""))


def _numbers(content: dict[str, Any]) -> Section:
    """The numbers that describe a run, over the reference runs."""
    rows = [
        [
            Cell(words(one["name"])),
            Cell(plain(one["mean"], 4), one["mean"]),
            Cell(plain(one["sd"], 2), one["sd"]),
        ]
        for one in content["numbers"]
    ]
    lead = "What describes a run, and how much that differs between normal runs."
    return Section("Reference runs", lead, table(["number", "mean", "sd between runs"], rows))
