"""Paths in files that move to other folders and computers."""

import os
from pathlib import Path


def way_to(path: str | Path, folder: str | Path) -> str:
    """Give the way to a file from a folder, which may move with it.

    Parameters
    ----------
    path : str or Path
        The file, which need not be there.
    folder : str or Path
        From where.

    Returns
    -------
    str
        A relative path with forward slashes; the path itself where there is no way, as between
        two drives of Windows.
    """
    place = Path(path).parent.resolve() / Path(path).name
    try:
        return Path(os.path.relpath(place, Path(folder).resolve())).as_posix()
    except ValueError:
        return Path(path).as_posix()


def without_root(word: str) -> str:
    """Write an absolute path as the way from the working folder.

    Parameters
    ----------
    word : str
        A word of a command: a path, or an option with one behind "=".

    Returns
    -------
    str
        Any other word as it is.
    """
    option, equals, value = word.partition("=") if word.startswith("-") else ("", "", word)
    return f"{option}{equals}{way_to(value, '.')}" if Path(value).is_absolute() else word
