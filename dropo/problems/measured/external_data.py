"""Where external data are searched for, and how public files are fetched.

The folders in order: the one that DROPO_DATA names, ../shared/data, the user's cache.
"""

import hashlib
import os
from pathlib import Path

import numpy as np

from dropo.core.services.errors import BadFile
from dropo.core.services.validation import Array

ROOT = Path(__file__).resolve().parents[3]


def data_folders() -> list[Path]:
    """List the folders in which external data are searched for.

    Returns
    -------
    list of Path
        In the order in which they are searched.
    """
    named = os.environ.get("DROPO_DATA")
    folders = [Path(named)] if named else []
    folders.append(Path("../shared/data").resolve())
    folders.append(ROOT.parent / "shared" / "data")
    return folders


def find_data(name: str) -> Path | None:
    """Searches for a file among the external data.

    Parameters
    ----------
    name : str
        Path inside a data folder, such as "cube-toss/runs.npz".

    Returns
    -------
    Path or None
        The first file found; None if no folder has it.
    """
    for folder in data_folders():
        if (folder / name).is_file():
            return folder / name
    return None


def missing(name: str, source: str) -> BadFile:
    """The error to raise if external data are not found.

    Parameters
    ----------
    name : str
        Path inside a data folder.
    source : str
        Whose data they are, in words.

    Returns
    -------
    BadFile
        Its message names the folders that were searched.
    """
    return BadFile(
        name,
        "",
        f"the data of {source} in the folder that DROPO_DATA names",
        f"no such file in {_searched()}",
    )


def fetch_arrays(base_url: str, files: dict[str, tuple[str, str]]) -> dict[str, Array]:
    """Read arrays from public .npy files, which are kept in the user's cache.

    Parameters
    ----------
    base_url : str
        Address of the folder.
    files : dict
        Key -> (path below `base_url`, sha256 of the content as float64).

    Returns
    -------
    dict of float64 arrays
        The arrays by key.

    Raises
    ------
    BadFile
        If a file can not be fetched, or has another content; such a file is removed from the cache.
    """
    out = {}
    for key, (file, digest) in files.items():
        path = _fetched(f"{base_url}/{file}", file.replace("/", "-"))
        out[key] = np.ascontiguousarray(np.load(path, allow_pickle=False), dtype=np.float64)
        got = hashlib.sha256(out[key].tobytes()).hexdigest()
        if got != digest:
            Path(path).unlink()
            raise BadFile(f"{base_url}/{file}", "", f"content with sha256 {digest}", got)
    return out


def _fetched(url: str, name: str) -> str:
    """The path of a public file in the user's cache, where it is fetched if it is not there yet."""
    import pooch

    folder = pooch.os_cache("dropo")
    try:
        path = pooch.retrieve(url, known_hash=None, path=folder, fname=name, progressbar=False)
    except (OSError, ValueError) as error:  # no network, or no such address
        expected = (
            "a public file that can be fetched, or the data in the folder that DROPO_DATA names"
        )
        reason = f"{type(error).__name__} while fetching it; there is no copy in {_searched()}"
        raise BadFile(url, "", expected, reason) from None
    return str(path)


def _searched() -> str:
    """The folders of `data_folders`, each once, for a message."""
    return ", ".join(str(folder) for folder in dict.fromkeys(data_folders()))
