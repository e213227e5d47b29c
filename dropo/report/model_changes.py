"""What to type into a model's MJCF: the first model against the extended one."""

import difflib
from html import escape
from pathlib import Path
from typing import Any

from dropo.core.services.files.strict_yaml import read_yaml
from dropo.diagnosis.parts import effect_in_words
from dropo.mjmodel.files.changes import changed_elements
from dropo.report.folder import Result
from dropo.report.page import notes, plain

FIRST = "before.xml"
"""The model without what was found, beside the extended one."""
LAST = "model.xml"
PROBLEM = "problem.yaml"


def changes_part(result: Result) -> str:
    """Show which attributes of the model's MJCF change, and the text to copy.

    Parameters
    ----------
    result : Result
        The diagnosis, with its extended model beside it.

    Returns
    -------
    str
        HTML; empty where no cause was found or the models are not in the folder.
    """
    folder = (result.folder / str(result.content.get("extended_problem") or "")).parent
    first, last = folder / FIRST, folder / LAST
    if not result.content["causes"] or not first.is_file() or not last.is_file():
        return ""
    old, new = (path.read_text(encoding="utf-8") for path in (first, last))
    changed = list(changed_elements(old, new))
    remarks = [*_declared(result), *_beside(folder / PROBLEM)]
    if not changed:
        remarks.insert(0, "Nothing in the MJCF changes.")
    typed = "\n".join(changed)
    diff = "\n".join(_shortened(old, new))
    body = "<h3>What to type into the model</h3>" + (_copyable(typed) if typed else "")
    if diff:
        body += f"<details><summary>As a patch of the whole file</summary>{_copyable(diff)}"
        body += "</details>"
    remarks.append("Both files are in `extended/`: before.xml and model.xml.")
    return body + notes(remarks)


def _shortened(old: str, new: str) -> list[str]:
    """The lines of a unified diff."""
    lines = difflib.unified_diff(
        old.splitlines(), new.splitlines(), "before.xml", "model.xml", lineterm="", n=1
    )
    return list(lines)


def _copyable(shown: str) -> str:
    """A block of code with a button that copies it; what a diff adds and takes has its colour."""
    marked = "\n".join(_marked(line) for line in shown.split("\n"))
    return (
        f'<div class="code"><button type="button" class="copy">copy</button>'
        f"<pre><code>{marked}</code></pre></div>"
    )


def _marked(line: str) -> str:
    """A line of a diff with the class of its kind."""
    kind = {"+": "added", "-": "taken"}.get(line[:1], "")
    if line.startswith("<!--"):
        kind = "remark"
    return f'<span class="{kind}">{escape(line)}</span>' if kind else escape(line)


def _declared(result: Result) -> list[str]:
    """A sentence on the parameters that the problem declares."""
    declared = {one["name"]: one.get("unit", "") for one in result.record.get("parameters", ())}
    values = [
        f"{name} {plain(value)} {declared[name]}".rstrip()
        for name, value in result.content.get("parameters", {}).items()
        if name in declared
    ]
    return [f"Both files hold declared parameters as fitted: {', '.join(values)}."] * bool(values)


def _beside(problem: Path) -> list[str]:
    """Sentences on the effects that MJCF has no element for."""
    if not problem.is_file():
        return []
    effects: Any = read_yaml(problem, "an extended problem").get("effects") or []
    return [
        f"MJCF has no element for {effect_in_words(one['effect'], one.get('target'), '')}: "
        "`extended/model.py` applies it around plain MuJoCo, and `dropo export` writes it for "
        "other tools."
        for one in effects
    ]
