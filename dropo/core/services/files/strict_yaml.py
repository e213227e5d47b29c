"""YAML 1.2 read strictly: one mapping, no key twice, every fault as `BadFile`."""

import io
import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from dropo.core.services.errors import BadFile
from dropo.core.services.files.file_content import describe_value

LARGEST_FILE = 2**22
"""Bytes of a file that somebody wrote by hand."""
DEEPEST = 50
"""Lists and mappings inside each other."""
MOST_ENTRIES = 100_000
"""Entries of a file, what an alias stands for counted each time."""
WIDTH = 120
"""Characters in a line that `format_yaml` writes."""


def read_yaml(path: Path, what: str) -> dict[Any, Any]:
    """Read a YAML file that is a mapping.

    Words such as `on`, `yes` and `no` are texts, and `1e-3` is a number, as YAML 1.2 has it.

    Parameters
    ----------
    path
        The file.
    what
        Its kind, for messages, such as "a problem file".

    Returns
    -------
    dict
        The content, of dictionaries, lists, texts, numbers, booleans and None.

    Raises
    ------
    BadFile
        If there is no such file, or if it is no text, no YAML, or no mapping.
    """
    content = _parse(path, _read_text(path, what))
    if isinstance(content, dict):
        return content
    got = "an empty file" if content is None else f"a {type(content).__name__}"
    raise BadFile(path, "", f"{what}, a mapping of keys", got)


def format_yaml(content: dict[str, Any]) -> str:
    """Write a mapping as YAML 1.2, its keys in their order.

    Numbers have a dot, as in `1.0e-08`, so that readers of YAML 1.1 take them as such too.

    Parameters
    ----------
    content
        Dictionaries, lists, texts, numbers, booleans and None.

    Returns
    -------
    str
        The text, which `read_yaml` reads as the same content.
    """
    from ruamel.yaml import YAML
    from ruamel.yaml.representer import SafeRepresenter

    class Representer(SafeRepresenter):
        """With numbers that have a dot."""

    Representer.add_representer(float, _represent_float)
    yaml = YAML(typ="safe", pure=True)
    yaml.Representer = Representer
    yaml.default_flow_style = False
    yaml.sort_base_mapping_type_on_output = False  # type: ignore[assignment]
    yaml.width = WIDTH
    stream = io.StringIO()
    yaml.dump(content, stream)
    return stream.getvalue()


def _represent_float(representer: Any, number: float) -> Any:
    """The node of a number, with a dot in it."""
    node = representer.represent_float(number)
    if "." not in node.value:
        node.value = node.value.replace("e", ".0e")
    return node


def _read_text(path: Path, what: str) -> str:
    """The text of a file in UTF-8."""
    try:
        if not path.is_file():
            raise BadFile(path, "", what, "no such file")
        size = path.stat().st_size
        if size > LARGEST_FILE:
            raise BadFile(path, "", f"{what} of at most {LARGEST_FILE} bytes", f"{size}")
        return path.read_text(encoding="utf-8")
    except (UnicodeDecodeError, OSError) as error:
        got = f"a file that cannot be read as text ({error})"
        raise BadFile(path, "", what, got) from None


def _parse(path: Path, text: str) -> Any:
    """The content of a YAML text."""
    from ruamel.yaml import YAML

    try:
        _require_plain(path, YAML(typ="safe", pure=True).parse(text))
        return YAML(typ="safe", pure=True).load(text)
    except BadFile:
        raise
    except Exception as error:  # the parser lets through what a tag or a long number raises
        mark = getattr(error, "problem_mark", None)
        key = f"line {mark.line + 1}" if mark else ""
        raise BadFile(path, key, "YAML", _describe_fault(error)) from None


def _require_plain(path: Path, events: Iterable[Any]) -> None:
    """Refuse tags, deep nesting, and aliases that stand for very many entries."""
    sizes: dict[str, int] = {}  # of what each anchor names
    entries = 0
    open_ones: list[tuple[str | None, int]] = []  # anchors, and the entries before them
    for event in events:
        key = f"line {event.start_mark.line + 1}"
        tag = getattr(event, "tag", None)
        if tag is not None and str(tag) != "!":
            shown = str(tag).replace("tag:yaml.org,2002:", "!!")
            raise BadFile(path, key, "no tag", describe_value(shown))
        kind = type(event).__name__
        anchor = getattr(event, "anchor", None)
        if kind.endswith("StartEvent") and not kind.startswith(("Stream", "Document")):
            open_ones.append((anchor, entries))
            if len(open_ones) > DEEPEST:
                expected = f"lists and mappings at most {DEEPEST} deep"
                raise BadFile(path, key, expected, "deeper ones")
        elif kind in ("SequenceEndEvent", "MappingEndEvent"):
            name, before = open_ones.pop()
            if name is not None:
                sizes[name] = entries - before
        elif kind == "ScalarEvent":
            entries += 1
            if anchor is not None:
                sizes[anchor] = 1
        elif kind == "AliasEvent":
            entries += sizes.get(anchor, 1)  # type: ignore[arg-type]
        if entries > MOST_ENTRIES:
            expected = f"at most {MOST_ENTRIES} entries, aliases counted in full"
            raise BadFile(path, key, expected, "more")


def _describe_fault(error: Exception) -> str:
    """What the parser found, in a line."""
    if isinstance(error, RecursionError):
        return "lists or mappings nested too deeply"
    problem = str(getattr(error, "problem", None) or error).strip()
    twice = re.match(r'found duplicate key "(.*?)" with value', problem)
    if twice:
        return f"the key {twice[1]!r} twice"
    # What Python says of a number that is too long is no use to who wrote it.
    line = problem.splitlines()[0].partition("; use sys.")[0] if problem else type(error).__name__
    return f"what a parser refuses: {line}"
