"""What to type into a model's MJCF, so that it becomes another one with the same elements."""

import xml.etree.ElementTree as ET
from collections.abc import Iterator

KEYS = ("name", "class", "joint", "site", "tendon", "body", "type", "geom1", "geom2")
"""Attributes by which an element is known, the first that it has."""
WHOLE = ("inertial",)
"""Elements that are typed as a whole: a file may leave them out, and what they hold goes together.
"""


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
    after = dict(_elements(ET.fromstring(new)))
    for path, element in before.items():
        # What is as by default is not written.
        if path not in after and element.attrib:
            gone_with_it = ", ".join(f'{key}="{value}"' for key, value in element.attrib.items())
            yield f"<!-- {' > '.join(_readable(path))}: was {gone_with_it}, now without -->"
            yield f"<{element.tag}/>"
    for path, element in after.items():
        kept = before.get(path)
        had = {} if kept is None else kept.attrib
        new_ones = {key: value for key, value in element.attrib.items() if had.get(key) != value}
        gone = [key for key in had if key not in element.attrib]
        if not new_ones and not gone and kept is not None:
            continue
        known = next(((key, had[key]) for key in KEYS if key in had and key not in new_ones), None)
        shown = ({known[0]: known[1]} if known else {}) | new_ones
        if element.tag in WHOLE:
            shown = element.attrib
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
