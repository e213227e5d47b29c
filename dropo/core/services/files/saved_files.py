"""Files that a run wrote, read again: whole, of a version that is known, with what they must hold.

Such files may have been cut off, edited, exchanged or written by another version. Each function
refuses them by name; nothing in them is run.
"""

import json
import zipfile
import zlib
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import MappingProxyType
from typing import IO, Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from dropo._version import __version__
from dropo.core.services.errors import BadFile, DropoError

NPZ = "an .npz file, as numpy.savez writes it"
LARGE = 2**28
"""Bytes from which an array in an archive must not be packed too tightly."""
TIGHT = 100
"""Times smaller than its content is an array in a large archive that somebody made as a trap."""
FAULTS = (
    ArithmeticError,
    AssertionError,
    AttributeError,
    LookupError,
    MemoryError,
    RecursionError,
    TypeError,
    ValueError,
)
"""What code raises that reads a content of the wrong kind."""
ARRAY_FAULTS = (ValueError, MemoryError, OverflowError, EOFError)
"""What reading an array raises that is none, or too large."""

Arrays = dict[str, NDArray[Any]]


@contextmanager
def refusing_faults(path: Path, what: str) -> Iterator[None]:
    """Refuse a file whose content makes the code inside the block fail.

    Parameters
    ----------
    path : Path
        The file.
    what : str
        What it should be, for the message.

    Raises
    ------
    BadFile
        In place of any of `FAULTS`; refusals go through as they are.
    """
    try:
        yield
    except DropoError:
        raise
    except FAULTS as error:
        raise BadFile(path, "", what, _describe(error)) from error


def read_json(path: Path, what: str) -> dict[str, Any]:
    """Read a JSON file that is an object with keys.

    Parameters
    ----------
    path : Path
        The file.
    what : str
        What it should be, for messages.

    Returns
    -------
    dict
        Its content, in which all numbers are finite.

    Raises
    ------
    BadFile
        If there is no such file, or it is no JSON, no object, or of a newer version.
    """
    if not path.is_file():
        raise BadFile(path, "", what, "no such file")
    with refusing_faults(path, what):
        content = json.loads(path.read_bytes(), parse_constant=_refuse_constant)
    if not isinstance(content, dict):
        raise BadFile(path, "", f"{what}, an object with keys", f"a {type(content).__name__}")
    require_version(path, content)
    return content


def require_version(path: Path, content: Mapping[str, Any]) -> None:
    """Refuse what a newer version wrote.

    Parameters
    ----------
    path : Path
        The file.
    content : mapping
        What it holds, its version under the key `version`, where it has one.

    Raises
    ------
    BadFile
        If that version is newer than this one.
    """
    version = str(content.get("version", ""))
    if _numbers(version) > _numbers(__version__):
        expected = f"{__version__} or older (a newer dropo reads it: pip install -U dropo)"
        raise BadFile(path, "version", expected, version[:40])


def read_npz(path: Path, what: str, names: Collection[str] | None = None) -> Arrays:
    """Read the arrays of an .npz file.

    Parameters
    ----------
    path : Path
        The file.
    what : str
        What it should be, for messages.
    names : collection of str, optional
        The arrays to read, as far as they are there; all by default.

    Returns
    -------
    dict of str to array
        The arrays by name.

    Raises
    ------
    BadFile
        If there is no such file, or it is no archive of arrays, encrypted, or unpacks to far more
        than it should.
    """
    if not path.is_file():
        raise BadFile(path, "", what, "no such file")
    found = {}
    with _archive(path, what) as archive:
        for member in archive.infolist():
            name = member.filename.removesuffix(".npy")
            if names is None or name in names:
                found[name] = _array(path, archive, member)
    return found


def read_npy(path: Path) -> NDArray[Any]:
    """Read the array of an .npy file.

    Parameters
    ----------
    path : Path
        The file.

    Returns
    -------
    array

    Raises
    ------
    BadFile
        If it cannot be read as an array of numbers.
    """
    try:
        with path.open("rb") as file:
            return _read_array(file, path.stat().st_size)
    except OSError as error:
        got = f"a file that cannot be read as one ({error})"
        raise BadFile(path, "", "an .npy file, as numpy.save writes it", got) from None
    except ARRAY_FAULTS as error:
        raise BadFile(path, "", "an array of numbers", _describe_array(error)) from None


def names_in_npz(path: Path, what: str) -> list[str]:
    """List the arrays of an .npz file, as `read_npz` reads it.

    Parameters
    ----------
    path : Path
        The file.
    what : str
        What it should be, for messages.

    Returns
    -------
    list of str
        Their names, in the order of the file.

    Raises
    ------
    BadFile
        If it is empty or no archive of arrays.
    """
    with _archive(path, what) as archive:
        return [name.removesuffix(".npy") for name in archive.namelist()]


def require_shapes(
    path: Path,
    arrays: Mapping[str, NDArray[Any]],
    rules: Mapping[str, str],
    lengths: Mapping[str, int] = MappingProxyType({}),
) -> None:
    """Refuse arrays that are missing, of another kind, or of shapes that do not fit together.

    Parameters
    ----------
    path : Path
        The file that they are from.
    arrays : mapping of str to array
        The arrays by name.
    rules : mapping of str to str
        By name the kind and the axes, such as "number W L p" or "text p": equal letters are equal
        lengths, numbers are lengths. Kinds are those of `KINDS`.

    lengths : mapping of str to int
        The lengths of letters that are known beforehand.

    Raises
    ------
    BadFile
        For the first array that breaks its rule.
    """
    known = dict(lengths)
    for name, rule in rules.items():
        kind, *axes = rule.split()
        shape = ", ".join(axes) + ("," if len(axes) == 1 else "")
        expected = f"{KINDS[kind][1]} of shape ({shape})"
        if name not in arrays:
            raise BadFile(path, name, expected, "nothing")
        array = arrays[name]
        got = f"one of {array.dtype} of shape {array.shape}"
        if array.dtype.kind not in KINDS[kind][0] or array.ndim != len(axes):
            raise BadFile(path, name, expected, got)
        if kind == "finite" and not np.isfinite(array).all():
            raise BadFile(path, name, expected, "one with other numbers")
        for axis, length in zip(axes, array.shape, strict=True):
            wanted = int(axis) if axis.isdigit() else known.setdefault(axis, length)
            if length != wanted:
                with_length = "" if axis.isdigit() else f" with {axis} = {wanted}"
                raise BadFile(path, name, expected + with_length, got)


KINDS = {
    "number": ("biuf", "an array of numbers"),
    "finite": ("biuf", "an array of finite numbers"),
    "whole": ("iu", "an array of whole numbers"),
    "flag": ("b", "an array of True and False"),
    "text": ("U", "an array of texts"),
}
"""Kinds of arrays: NumPy's letters, and what messages call them."""


@contextmanager
def _archive(path: Path, what: str) -> Iterator[zipfile.ZipFile]:
    """The archive in a file, read from the file inside the block."""
    if path.stat().st_size == 0:
        raise BadFile(path, "", what, "an empty file")
    try:
        with zipfile.ZipFile(path) as archive:
            yield archive
    except (zipfile.BadZipFile, OSError, NotImplementedError) as error:
        raise BadFile(path, "", what, f"a file that cannot be read as one ({error})") from None


def _array(path: Path, archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> NDArray[Any]:
    """One array of an archive, whose size is looked at before it is unpacked."""
    name = member.filename.removesuffix(".npy")
    if member.flag_bits & 1:
        raise BadFile(path, name, "an array that is not encrypted", "an encrypted one")
    size = member.file_size
    if size > LARGE and size > TIGHT * member.compress_size:
        got = f"{size} bytes packed into {member.compress_size}"
        raise BadFile(path, name, f"an array packed at most {TIGHT} times", got)
    try:
        with archive.open(member) as file:
            return _read_array(file, size)
    except ARRAY_FAULTS as error:
        raise BadFile(path, name, "an array of numbers", _describe_array(error)) from None
    except (zipfile.BadZipFile, zlib.error, NotImplementedError) as error:
        raise BadFile(path, name, "an array of numbers", f"a corrupt part ({error})") from None


def _read_array(file: IO[bytes], size: int) -> NDArray[Any]:
    """The array of an open .npy file of so many bytes; room is made for no more than it holds."""
    version = np.lib.format.read_magic(file)
    read_header = {
        (1, 0): np.lib.format.read_array_header_1_0,
        (2, 0): np.lib.format.read_array_header_2_0,
    }.get(version)
    if read_header is None:
        raise ValueError(f"an array in version {version} of its format")
    shape, fortran, dtype = read_header(file)
    if dtype.hasobject:
        raise ValueError("an array of Python objects")
    count = 1
    for length in shape:
        count *= length
    left = size - file.tell()
    if min(shape, default=0) < 0 or count * dtype.itemsize > left:
        raise ValueError(f"the shape {shape} and {left} bytes")
    raw = file.read(count * dtype.itemsize)
    flat = np.frombuffer(bytearray(raw), dtype=dtype, count=count)
    return flat.reshape(shape, order="F" if fortran else "C")


def _describe(error: Exception) -> str:
    """What went wrong, in a short line."""
    if isinstance(error, RecursionError):
        return "lists or objects nested too deeply"
    if isinstance(error, UnicodeDecodeError | json.JSONDecodeError):
        return f"no JSON ({_short(error)})"
    return f"{type(error).__name__}: {_short(error)}"


def _describe_array(error: Exception) -> str:
    """Why an array cannot be read."""
    if isinstance(error, MemoryError):
        return "one larger than the memory"
    return _short(error)


def _short(error: Exception) -> str:
    """The first line of a message, without its full stop."""
    lines = str(error).strip().splitlines() or [type(error).__name__]
    return lines[0][:120].removesuffix(".")


def _refuse_constant(name: str) -> NoReturn:
    """JSON has neither NaN nor Infinity."""
    raise ValueError(f"{name}, which is no JSON")


def _numbers(version: str) -> tuple[int, ...]:
    """The numbers of a version, to compare it; a part of many digits is none."""
    parts = version[:40].split("+")[0].split(".")
    return tuple(int(part) for part in parts if part.isascii() and part.isdigit())
