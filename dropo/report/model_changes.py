"""What to type into a model's MJCF: the first model against the extended one."""

import difflib
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from html import escape
from pathlib import Path
from typing import Any

from dropo.core.services.files.strict_yaml import read_yaml
from dropo.diagnosis.parts import effect_in_words
from dropo.report.folder import Result
from dropo.report.page import notes, plain

FIRST = "before.xml"
"""The model without what was found, beside the extended one."""
LAST = "model.xml"
PROBLEM = "problem.yaml"
KEYS = ("name", "class", "joint", "site", "tendon", "body", "type", "geom1", "geom2")
"""Attributes by which an element is known, the first that it has."""


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


def changed_elements(old: str, new: str) -> Iterator[str]:
    """List the elements that differ, as lines to type.

    Parameters
    ----------
    old, new : str
        Two MJCF files with the same elements in the same order, but for new ones.

    Yields
    ------
    str
        A place as a comment, then the element with its new attributes, such as
        `<joint name="elbow" frictionloss="0.05"/>`.
    """
    before = dict(_elements(ET.fromstring(old)))
    for path, element in _elements(ET.fromstring(new)):
        kept = before.get(path)
        had = {} if kept is None else kept.attrib
        new_ones = {key: value for key, value in element.attrib.items() if had.get(key) != value}
        gone = [key for key in had if key not in element.attrib]
        if not new_ones and not gone and kept is not None:
            continue
        known = next(((key, had[key]) for key in KEYS if key in had and key not in new_ones), None)
        shown = ({known[0]: known[1]} if known else {}) | new_ones
        text = " ".join(f'{key}="{value}"' for key, value in shown.items())
        was = [f'{key}="{had[key]}"' for key in new_ones if key in had]
        was += [f'{key}="{had[key]}", now without' for key in gone]
        added = [key for key in new_ones if key not in had]
        remark = "was " + ", ".join(was) if was else ""
        if added:
            remark += f"{'; ' * bool(remark)}new: {', '.join(added)}"
        if kept is None:
            remark = "new element"
        yield f"<!-- {' > '.join(_readable(path))}: {remark} -->"
        yield f"<{element.tag} {text}/>"


def _elements(
    element: ET.Element, above: tuple[str, ...] = ()
) -> Iterator[tuple[tuple[str, ...], ET.Element]]:
    """Every element with its path, whose steps hold a name, or a number among their kind."""
    seen: dict[str, int] = {}
    for child in element:
        name = next((child.attrib[key] for key in KEYS[:1] if key in child.attrib), "")
        seen[child.tag] = seen.get(child.tag, 0) + 1
        path = (*above, f"{child.tag} {name or seen[child.tag]}")
        yield path, child
        yield from _elements(child, path)


def _readable(path: tuple[str, ...]) -> list[str]:
    """The steps of a path that say something: those with names, and the last."""
    steps = [step for step in path[:-1] if not step.rpartition(" ")[2].isdigit()]
    last = path[-1].rpartition(" ")
    return [*steps, last[0] if last[2] == "1" else path[-1]][-3:]


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
