"""Files that appear whole or not at all, however a run ends."""

import json
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike


@contextmanager
def atomic_write(path: str | Path) -> Iterator[Path]:
    """Give a temporary file in the folder of `path`, which takes its place at the end of the block.

    If the block raises, the temporary file is removed and what was at `path` stays as it was.
    A folder that is missing is made. Several files that belong together are written in nested
    blocks: none of them appears unless all could be written.

    Parameters
    ----------
    path : str or Path
        The file to write or to replace.

    Yields
    ------
    Path
        The temporary file to write to. It has the suffix of `path`.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f".{path.stem}.part{path.suffix}")
    try:
        with naming(path):
            yield part
            with part.open("rb+") as file:
                os.fsync(file.fileno())
            part.replace(path)
    finally:
        part.unlink(missing_ok=True)


@contextmanager
def naming(what: str | Path) -> Iterator[None]:
    """Give errors of the system inside the block the name of what was written.

    Parameters
    ----------
    what : str or Path
        The file, which a full disk does not name, or what else it is.

    Raises
    ------
    OSError
        The same, with its `filename`.
    """
    try:
        yield
    except OSError as error:
        if error.filename is None:
            error.filename = str(what)
        raise


def write_text(path: str | Path, text: str) -> None:
    """Write a text as UTF-8.

    Parameters
    ----------
    path : str or Path
        The file to write or to replace.
    text : str
        Its whole content.
    """
    with atomic_write(path) as part:
        part.write_text(text, encoding="utf-8")


def write_bytes(path: str | Path, content: bytes) -> None:
    """Write bytes.

    Parameters
    ----------
    path : str or Path
        The file to write or to replace.
    content : bytes
        Its whole content.
    """
    with atomic_write(path) as part:
        part.write_bytes(content)


def write_json(path: str | Path, content: Any) -> None:
    """Write JSON as every result of the package has it: indented by one space, without NaN.

    Parameters
    ----------
    path : str or Path
        The file to write or to replace.
    content : Any
        What `json.dumps` takes.

    Raises
    ------
    ValueError
        If the content holds a number that is not finite.
    """
    write_text(path, json.dumps(content, indent=1, allow_nan=False) + "\n")


def write_npz(
    path: str | Path,
    arrays: Mapping[str, ArrayLike],
    *,
    compressed: bool = False,
) -> None:
    """Write arrays under their names.

    Parameters
    ----------
    path : str or Path
        The file to write or to replace.
    arrays : mapping of str to array_like
        The arrays by name, of any shape.
    compressed : bool
        Whether to compress them.
    """
    save: Any = np.savez_compressed if compressed else np.savez
    with atomic_write(path) as part, part.open("wb") as file:
        save(file, **arrays)
