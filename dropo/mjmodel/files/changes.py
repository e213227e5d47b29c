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
            yield _comment(path, f"was {_typed(element.attrib, ', ')}, now without")
            yield f"<{element.tag}/>"
    for path, element in after.items():
        kept = before.get(path)
        if kept is None:
            yield _comment(path, "new element")
            yield f"<{element.tag} {_typed(_shown({}, element))}/>"
        elif kept.attrib != element.attrib:
            yield _comment(path, _remark(kept.attrib, element.attrib))
            yield f"<{element.tag} {_typed(_shown(kept.attrib, element))}/>"


def _comment(path: tuple[str, ...], remark: str) -> str:
    """Where an element is, and what it was."""
    return f"<!-- {' > '.join(_readable(path))}: {remark} -->"


def _typed(attributes: dict[str, str], between: str = " ") -> str:
    """Attributes as MJCF has them."""
    return between.join(f'{key}="{value}"' for key, value in attributes.items())


def _shown(had: dict[str, str], element: ET.Element) -> dict[str, str]:
    """The attributes of an element that are typed: those that change, and one to know it by."""
    if element.tag in WHOLE:
        return element.attrib
    changed = {key: value for key, value in element.attrib.items() if had.get(key) != value}
    known = [key for key in KEYS if key in had and key not in changed]
    return {key: had[key] for key in known[:1]} | changed


def _remark(had: dict[str, str], has: dict[str, str]) -> str:
    """What became of an element's attributes."""
    changed = [key for key in has if key in had and had[key] != has[key]]
    was = [f'{key}="{had[key]}"' for key in changed]
    was += [f'{key}="{value}", now without' for key, value in had.items() if key not in has]
    added = [key for key in has if key not in had]
    said = []
    if was:
        said.append("was " + ", ".join(was))
    if added:
        said.append("new: " + ", ".join(added))
    return "; ".join(said)


def _elements(
    element: ET.Element, above: tuple[str, ...] = ()
) -> Iterator[tuple[tuple[str, ...], ET.Element]]:
    """Every element with its path, whose steps hold a name, or a number among their kind."""
    seen: dict[str, int] = {}
    for child in element:
        seen[child.tag] = seen.get(child.tag, 0) + 1
        path = (*above, f"{child.tag} {child.get('name') or seen[child.tag]}")
        yield path, child
        yield from _elements(child, path)


def _readable(path: tuple[str, ...]) -> list[str]:
    """The steps of a path that say something: those with names, and the last."""
    steps = [step for step in path[:-1] if not step.rpartition(" ")[2].isdigit()]
    last = path[-1].rpartition(" ")
    return [*steps, last[0] if last[2] == "1" else path[-1]][-3:]
