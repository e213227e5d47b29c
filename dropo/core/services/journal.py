"""A file to which a run adds a line for each thing that it has finished, to go on from there.

Every line has a number and a checksum, and no line is ever changed. A line that was cut off or
damaged counts as missing: what follows it is done again, and its line is added at the end. So a
journal is what its lines say up to the first number that is missing, whatever their order, and a
number that stands there twice counts once.
"""

import json
import os
import zlib
from pathlib import Path
from typing import Any

from dropo.core.services.atomic_write import naming
from dropo.core.services.errors import BadFile
from dropo.core.services.saved_files import require_version

ENTRY = '"entry": '
"""What stands between a line's checksum and its content."""


class Journal:
    """What a run has finished, on disk. The file begins with the first entry that is added.

    Parameters
    ----------
    path : Path
        The file, read if it is there.
    header : dict
        What the run is; it stands in the first line.
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
        self._header = header
        self._next = 0
        self.entries: list[Any] = []
        if not path.exists():
            return
        found = read_lines(path, what)
        if found:
            require_same(self.path, json.loads(json.dumps(self._header)), found[0])
            self._next = len(found)
            self.entries = found[1:]

    def append(self, entry: Any) -> None:
        """Add an entry, behind the header where it is the first.

        Parameters
        ----------
        entry : Any
            What `json.dumps` takes.
        """
        self.path.parent.mkdir(parents=True, exist_ok=True)
        with naming(self.path), self.path.open("ab+") as file:
            lines = [] if self._next else [self._header]
            lines.append(entry)
            text = "".join(map(self._line, lines))
            file.write(_end_of_cut_line(file) + text.encode())
            file.flush()
            os.fsync(file.fileno())

    def _line(self, content: Any) -> str:
        """The next line."""
        line = format_line(self._next, content)
        self._next += 1
        return line


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
        got = "those of another run (use another --out, or the settings of that run)"
        raise BadFile(path, ", ".join(differ), "the settings of this run", got)


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
