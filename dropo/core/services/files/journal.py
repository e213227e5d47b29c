"""A file to which a run adds a line for each thing that it has finished, to go on from there.

Every line has a number and a checksum, and no line is ever changed. A line that was cut off or
damaged counts as missing: what follows it is done again, and its line is added at the end. So a
journal is what its lines say up to the first number that is missing, whatever their order, and a
number that stands there twice counts once.
"""

import json
import os
import warnings
import zlib
from collections.abc import Sequence
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

from dropo.core.services.blas_threads import blas_kernels
from dropo.core.services.errors import BadFile
from dropo.core.services.files.atomic_write import naming
from dropo.core.services.files.saved_files import require_version
from dropo.core.services.run_warning import DropoWarning

ENTRY = '"entry": '
"""What stands between a line's checksum and its content."""
MADE_WITH = "made_with"
"""The header's entry of what a run began with, which decides its last digits alone."""
LONGEST = 40
"""Characters of a setting that a message shows ..."""
MOST_SHOWN = 4
"""... and of how many settings it does."""


class Journal:
    """What a run has finished, on disk. The file begins with the first entry that is added.

    Parameters
    ----------
    path : Path
        The file, read if it is there.
    header : dict
        What the run is: all settings that decide its entries. It stands in the first line, with the
        versions behind the run.
    what : str
        What the file should be, for messages.

    Attributes
    ----------
    entries : list
        What the file held, in order, without the header.

    Raises
    ------
    BadFile
        If the file is no journal, or that of another run; the message names what differs.
    """

    def __init__(self, path: Path, header: dict[str, Any], what: str):
        self.path = path
        self._header = header | {MADE_WITH: dict(versions())}
        self._next = 0
        self.entries: list[Any] = []
        if not path.exists():
            return
        found = read_lines(path, what)
        if found:
            theirs = dict(found[0]) if isinstance(found[0], dict) else {}
            before = theirs.pop(MADE_WITH, None)
            require_same(self.path, json.loads(json.dumps(header)), theirs)
            _warn_of_others(self.path, before)
            self._next = len(found)
            self.entries = found[1:]

    def append(self, entry: Any) -> None:
        """Add an entry, behind the header where it is the first.

        Its number is taken once it is on disk: after an interruption in between, the same entry may
        be added again.

        Parameters
        ----------
        entry : Any
            What `json.dumps` takes.
        """
        self.path.parent.mkdir(parents=True, exist_ok=True)
        with naming(self.path), self.path.open("ab+") as file:
            contents = [entry] if self._next else [self._header, entry]
            lines = [format_line(self._next + i, content) for i, content in enumerate(contents)]
            file.write(_end_of_cut_line(file) + "".join(lines).encode())
            file.flush()
            os.fsync(file.fileno())
        self._next += len(contents)


@cache
def versions() -> dict[str, str]:
    """The versions behind a run's numbers, and the kernels with which BLAS multiplies here.

    Returns
    -------
    dict of str to str
    """
    found = {name: version(name) for name in ("numpy", "scipy", "mujoco")}
    return {**found, "BLAS kernel": ", ".join(blas_kernels())}


def _warn_of_others(path: Path, before: Any) -> None:
    """Warn where a run goes on with other versions than it began with."""
    if not isinstance(before, dict):
        return
    now = versions()
    differ = [name for name in now if before.get(name) != now[name]]
    if differ:
        pairs = ", ".join(f"{name} {before.get(name)} then and {now[name]} now" for name in differ)
        sentence = (
            f"{path}: it goes on with other numerics than it began with, which round otherwise"
        )
        warnings.warn(f"{sentence}: {pairs}.", DropoWarning, stacklevel=3)


def require_same(path: Path, ours: dict[str, Any], theirs: Any) -> None:
    """Refuse what another run saved.

    Parameters
    ----------
    path : Path
        The file, for the message.
    ours : dict
        What this run decided, as JSON has it.
    theirs : Any
        What the file says.

    Raises
    ------
    BadFile
        If they differ; it names the keys.
    """
    before = theirs if isinstance(theirs, dict) else {}
    differ = sorted(key for key in {*ours, *before} if ours.get(key) != before.get(key))
    if differ:
        pairs = describe_differences(ours, before)
        got = f"those of another run{pairs} (use another --out, or the settings of that run)"
        raise BadFile(path, _first(differ), "the settings of this run", got)


def describe_differences(ours: dict[str, Any], theirs: dict[str, Any]) -> str:
    """Write the settings that differ, as far as they are short.

    Parameters
    ----------
    ours, theirs : dict
        Settings of two runs, as JSON has them.

    Returns
    -------
    str
        Such as ": seeds 3 there and 5 here"; empty where none can be shown.
    """
    shown = []
    for key in sorted({*ours, *theirs}):
        there, here = (json.dumps(settings.get(key)) for settings in (theirs, ours))
        if there != here and max(len(there), len(here)) <= LONGEST:
            shown.append(f"{key} {there} there and {here} here")
    return f": {_first(shown)}" if shown else ""


def _first(texts: Sequence[str]) -> str:
    """The first few of some texts, and how many others there are."""
    more = len(texts) - MOST_SHOWN
    named = ", ".join(texts[:MOST_SHOWN])
    return f"{named} and {more} more" if more > 0 else named


def read_lines(path: Path, what: str) -> list[Any]:
    """Read the contents of a journal's lines up to the first that is missing.

    Parameters
    ----------
    path : Path
        The file.
    what : str
        What it should be, for messages.

    Returns
    -------
    list
        The header and the entries; empty where the first line was cut off.

    Raises
    ------
    BadFile
        If the file has whole lines and no header, or a newer version wrote it.
    """
    *whole, _ = path.read_bytes().split(b"\n")
    found: dict[int, Any] = {}
    for line in whole:
        read = parse_line(line)
        if read is not None:
            found.setdefault(*read)
    if whole and 0 not in found:
        raise BadFile(path, "", what, "a file without a whole first line")
    contents: list[Any] = []
    while len(contents) in found:
        contents.append(found[len(contents)])
    if contents and isinstance(contents[0], dict):
        require_version(path, contents[0])
    return contents


def format_line(number: int, content: Any) -> str:
    """Write a line: its number, its checksum, and its content as JSON.

    Parameters
    ----------
    number : int
        The line's place in the file, 0 for the header.
    content : Any
        What JSON can hold.

    Returns
    -------
    str
        The line with its end.
    """
    text = json.dumps(content)
    return f'{{"n": {number}, "crc32": "{_checksum(number, text)}", {ENTRY}{text}}}\n'


def parse_line(line: bytes) -> tuple[int, Any] | None:
    """Read a line that `format_line` wrote.

    Parameters
    ----------
    line : bytes
        A line, without its end.

    Returns
    -------
    tuple of (int, Any) or None
        Its number and its content; None where it was cut off or damaged.
    """
    head, separator, text = line.decode(errors="replace").partition(ENTRY)
    try:
        known = json.loads(f"{head}{separator}0}}")
        content = text.removesuffix("}")
        if known["crc32"] != _checksum(known["n"], content):
            return None
        return int(known["n"]), json.loads(content)
    except (ValueError, TypeError, LookupError, RecursionError):
        return None


def _checksum(number: int, text: str) -> str:
    """The CRC-32 of a line's number and content."""
    return f"{zlib.crc32(f'{number} {text}'.encode()):08x}"


def _end_of_cut_line(file: Any) -> bytes:
    """A line's end where the file's last line has none, so that what is added stands alone."""
    if file.seek(0, os.SEEK_END) == 0:
        return b""
    file.seek(-1, os.SEEK_END)
    return b"" if file.read(1) == b"\n" else b"\n"
