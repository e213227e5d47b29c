"""The page of a diagnosis by regression alone."""

from typing import Any

from dropo.report import parts
from dropo.report.folder import Result
from dropo.report.model_changes import changes_part
from dropo.report.page import Cell, Section, notes, page, percent, plain, table
from dropo.report.pages.diagnosis_page import causes_section, fault_remark, finding_cards
from dropo.report.robot.picture import where_section


def quick_page(result: Result) -> str:
    """Write the page of what `dropo diagnose --quick` found.

    Parameters
    ----------
    result : Result
        The diagnosis.

    Returns
    -------
    str
        The HTML file's text.
    """
    content = result.content
    cards = [
        *finding_cards(content),
        ("by", "regression alone", ""),
        ("time", f"{content['wall_time_s']:.1f} s", ""),
    ]
    sections = [
        where_section(result, changes_part(result)),
        causes_section(content),
        _forces(content),
        parts.made(result),
    ]
    shown = [section for section in sections if section is not None]
    return page(f"dropo diagnose --quick · {result.problem}", content["headline"], cards, shown)


def _forces(content: dict[str, Any]) -> Section:
    """What is not explained at each joint, what is wrong in the log, and what is unusual."""
    rows = []
    for joint in content["forces"]:
        forces = [Cell(plain(joint[key], 3), joint[key]) for key in ("drive", "before", "after")]
        used = Cell(percent(joint["used"]), joint["used"])
        rows.append([Cell(joint["joint"]), Cell(joint["unit"]), *forces, used])
    header = ["joint", "unit", "drive", "unexplained as it is", "with what was found", "used"]
    remarks = [*map(fault_remark, content["faults"]), *content["warnings"]]
    lead = (
        "Root mean squares on data held out, by regression over inverse dynamics: diagnose "
        "without --quick to confirm by simulation."
    )
    body = table(header, rows) + (notes(remarks) if remarks else "")
    return Section("Forces", lead, body)
