"""Where outside data are: the folder that DROPO_DATA names, then ../shared/data, then the user's
cache.
"""

import hashlib
import os
from pathlib import Path

import numpy as np

from dropo.core.services.errors import BadFile
from dropo.core.services.validation import Array

ROOT = Path(__file__).resolve().parents[2]


def data_folders() -> list[Path]:
    """The folders that are searched, in order."""
    named = os.environ.get("DROPO_DATA")
    return [
        *([Path(named)] if named else []),
        Path("../shared/data").resolve(),
        ROOT.parent / "shared" / "data",
    ]


def find_data(name: str) -> Path | None:
    """The path of a data file such as "cube-toss/runs.npz", or None."""
    return next((folder / name for folder in data_folders() if (folder / name).is_file()), None)


def missing(name: str, source: str) -> BadFile:
    """What is raised where outside data are not at hand."""
    searched = ", ".join(str(folder) for folder in dict.fromkeys(data_folders()))
    return BadFile(
        name,
        "",
        f"the data of {source} in the folder that DROPO_DATA names",
        f"no such file in {searched}",
    )


def fetch_arrays(base_url: str, files: dict[str, tuple[str, str]]) -> dict[str, Array]:
    """Arrays from public .npy files, kept in the user's cache: key -> (file, sha256 of the float64
    content).
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
    """The path of a public file in the user's cache, fetched where it is not there yet."""
    import pooch

    try:
        return str(
            pooch.retrieve(
                url, known_hash=None, path=pooch.os_cache("dropo"), fname=name, progressbar=False
            )
        )
    except (OSError, ValueError) as error:  # no network, or no such address
        reason = (
            f"{type(error).__name__} while fetching it; there is no copy in "
            f"{', '.join(map(str, dict.fromkeys(data_folders())))}"
        )
        raise BadFile(
            url,
            "",
            "a public file that can be fetched, or the data in the folder that DROPO_DATA names",
            reason,
        ) from None
