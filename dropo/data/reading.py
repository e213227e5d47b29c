"""Reads measured transitions: NPZ archives, folders of NPY files, lists of them, Minari data sets."""

import importlib
import zipfile
from collections.abc import Callable, Iterable, Sequence, Set
from functools import partial
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from dropo.core.records.trajectories import Trajectories
from dropo.core.services.errors import BadFile
from dropo.core.services.validation import Array

NEEDED = ("observations", "actions", "terminals")
NUMBERS = ("observations", "actions", "next_observations", "time")
KEYS = (*NUMBERS, "terminals", "group")
INPUT = "actions."
"""What the names of several logged commands begin with."""
MINARI = "minari:"
NO_MINARI = "the extra 'minari' to read it (pip install 'dropo[minari]')"
END = "True on each trajectory's last row"

Arrays = dict[str, NDArray[Any]]
Source = str | Path


def read(
    source: Source | Sequence[Source],
    *,
    input: str | None = None,
    zero_actions: int | None = None,
) -> Trajectories:
    """The trajectories of a source: an .npz file, a folder of .npy files of the same names, a
    Minari data set, or a list of such.

    Arrays: `observations` (N, p), `actions` (N, q), `terminals` (N,) with True on each trajectory's
    last row; optional `next_observations` (N, p), `group` (N,), `time` (N,) [s]; others are
    ignored, but `input` says whose `actions.NAME` (N, q) are the actions, where several commands
    were logged. Without `next_observations` the rows of a trajectory follow each other, and its
    last row, which has no next one, is dropped. A Minari data set is a folder in Minari's layout,
    or "minari:" and its name. Group numbers count within one file: files never share a group.
    `zero_actions`: so many columns of zeros are the actions, whether or not the source holds any;
    None: it must hold them.
    """
    if isinstance(source, str | Path):
        return _trajectories([_checked(source, input, zero_actions)])
    if not source:
        raise BadFile("data", "", "at least one file", "an empty list")
    return _trajectories([_checked(one, input, zero_actions) for one in source])


def inputs_of(source: Source) -> tuple[str, ...]:
    """The names of the commands that stand beside each other in a source, as `actions.NAME`."""
    return tuple(
        name.removeprefix(INPUT) for name in _load(source, KEYS)[1] if name.startswith(INPUT)
    )


def _trajectories(parts: list[tuple[Source, Arrays]]) -> Trajectories:
    """Trajectories of checked files that have the same columns."""
    first_source, first = parts[0]
    for source, arrays in parts[1:]:
        for key in ("observations", "actions"):
            if arrays[key].shape[1] != first[key].shape[1]:
                raise BadFile(
                    source,
                    key,
                    f"{first[key].shape[1]} columns, as in {first_source}",
                    f"{arrays[key].shape[1]}",
                )
        for key in ("group", "time"):
            if (key in arrays) != (key in first):
                given, missing = (source, first_source) if key in arrays else (first_source, source)
                raise BadFile(
                    missing,
                    key,
                    "the array in every file or in none",
                    f"none here and one in {given}",
                )
    _separate_groups([arrays for _, arrays in parts])
    return Trajectories(
        **{key: np.concatenate([arrays[key] for _, arrays in parts]) for key in first}
    )


def _separate_groups(parts: list[Arrays]) -> None:
    """Numbers each file's groups behind those of the one before."""
    used = 0
    for arrays in parts:
        if "group" in arrays:
            arrays["group"] = np.unique(arrays["group"], return_inverse=True)[1] + used
            used = int(arrays["group"].max()) + 1


def _checked(source: Source, input: str | None, zero_actions: int | None) -> tuple[Source, Arrays]:
    """One file's arrays under the names of Trajectories, with next_observations."""
    chosen = "actions" if input is None else INPUT + input
    raw, others = _load(source, (*KEYS, chosen))
    if chosen not in raw and input is not None:
        raise BadFile(
            source,
            chosen,
            "an array of that name",
            _present({name for name in others if name.startswith(INPUT)}),
        )
    raw = {**raw, **({"actions": raw[chosen]} if chosen in raw else {})}
    for key in NEEDED:
        if key not in raw and (key != "actions" or zero_actions is None):
            raise BadFile(source, key, "an array of that name", _present({*raw, *others}))
    if zero_actions is not None:
        raw["actions"] = np.zeros((len(np.atleast_1d(raw["observations"])), zero_actions))
    arrays: Arrays = {key: _numbers(source, key, raw[key]) for key in NUMBERS if key in raw}
    n, p = _matrix(source, "observations", arrays["observations"])
    if n == 0:
        raise BadFile(source, "observations", "at least one row", "none")
    q = arrays["actions"].shape[1] if arrays["actions"].ndim == 2 else "q"
    for key, shape in {"actions": (n, q), "next_observations": (n, p), "time": (n,)}.items():
        if key in arrays and arrays[key].shape != shape:
            raise BadFile(
                source,
                key,
                f"the shape {_shape(shape)}, since observations is {_shape((n, p))}",
                _shape(arrays[key].shape),
            )
    arrays["terminals"] = _terminals(source, raw["terminals"], n)
    if "group" in raw:
        arrays["group"] = _group(source, raw["group"], n)
    return source, arrays if "next_observations" in arrays else _paired(source, arrays)


def _paired(source: Source, arrays: Arrays) -> Arrays:
    """Transitions between rows that follow each other; each trajectory's last row has no next one
    and is dropped.
    """
    last = arrays["terminals"]
    keep = ~last
    if not keep.any():
        raise BadFile(
            source,
            "next_observations",
            "the array, or trajectories of at least two rows",
            "neither",
        )
    out = {key: array[keep] for key, array in arrays.items() if key != "terminals"}
    following = np.flatnonzero(keep) + 1
    return {
        **out,
        "next_observations": arrays["observations"][following],
        "terminals": last[following],
    }


def _numbers(source: Source, key: str, array: NDArray[Any]) -> Array:
    if array.dtype.kind not in "biuf":
        raise BadFile(source, key, "an array of numbers", f"an array of {array.dtype}")
    bad = np.argwhere(~np.isfinite(array))
    if len(bad):
        place = ", ".join(f"{axis} {i}" for axis, i in zip(("row", "column"), bad[0], strict=False))
        raise BadFile(source, key, "finite numbers", f"{array[tuple(bad[0])]} at {place}")
    return array.astype(np.float64)


def _matrix(source: Source, key: str, array: Array) -> tuple[int, int]:
    if array.ndim != 2 or array.shape[1] == 0:
        raise BadFile(
            source, key, "the shape (N, p), a row for each transition", _shape(array.shape)
        )
    return array.shape[0], array.shape[1]


def _terminals(source: Source, array: NDArray[Any], n: int) -> NDArray[np.bool_]:
    if array.shape != (n,):
        raise BadFile(
            source,
            "terminals",
            f"the shape ({n},), since observations has {n} rows",
            _shape(array.shape),
        )
    if not np.isin(array, (0, 1)).all():
        raise BadFile(
            source,
            "terminals",
            "True and False alone",
            f"an array of {array.dtype} with other values",
        )
    flags = array.astype(bool)
    if not flags.any():
        raise BadFile(source, "terminals", END, "no True at all")
    if not flags[-1]:
        raise BadFile(source, "terminals", END, "False on the last row")
    return flags


def _group(source: Source, array: NDArray[Any], n: int) -> NDArray[Any]:
    if array.dtype.kind not in "iu":
        raise BadFile(source, "group", "whole numbers", f"an array of {array.dtype}")
    if array.shape != (n,):
        raise BadFile(
            source,
            "group",
            f"the shape ({n},), since observations has {n} rows",
            _shape(array.shape),
        )
    return array


def _shape(shape: Sequence[object]) -> str:
    return "(" + ", ".join(map(str, shape)) + ("," if len(shape) == 1 else "") + ")"


def _present(names: Set[str]) -> str:
    shown = sorted(names)[:12]
    return (
        f"only {', '.join(shown)}{', ...' if len(names) > len(shown) else ''}"
        if names
        else "no arrays at all"
    )


def _load(source: Source, keys: Sequence[str]) -> tuple[Arrays, list[str]]:
    """The arrays of one source of these names, and the names of others in it, which are not read."""
    if isinstance(source, str) and source.startswith(MINARI):
        return _minari(source, source.removeprefix(MINARI)), []
    path = Path(source)
    try:
        is_folder = path.is_dir()
        exists = path.exists()
    except OSError:  # a name that is too long for a file
        is_folder = False
        exists = False
    if is_folder:
        return _folder(path, keys)
    if not exists:
        raise BadFile(
            source, "", "an .npz file, a folder of .npy files or a Minari data set", "no such file"
        )
    if path.suffix != ".npz":
        raise BadFile(
            source,
            "",
            "an .npz file (`dropo data import` makes one from tables and logs)",
            f"a file {path.suffix!r}",
        )
    return _archive(path, keys)


def _archive(path: Path, keys: Sequence[str]) -> tuple[Arrays, list[str]]:
    expected = "an .npz file, as numpy.savez writes it"
    if path.stat().st_size == 0:
        raise BadFile(path, "", expected, "an empty file")
    try:
        with zipfile.ZipFile(path) as archive:
            names = [name.removesuffix(".npy") for name in archive.namelist()]
        with np.load(path, allow_pickle=False) as content:
            return {
                name: _member(path, name, partial(content.__getitem__, name))
                for name in names
                if name in keys
            }, _others(names)
    except (zipfile.BadZipFile, OSError, EOFError) as error:
        raise BadFile(path, "", expected, f"a file that cannot be read as one ({error})") from None


def _others(names: Iterable[str]) -> list[str]:
    return [name for name in names if name not in KEYS]


def _member(source: Source, key: str, load: Callable[[], object]) -> NDArray[Any]:
    try:
        return np.asarray(load())
    except ValueError as error:
        got = (
            "an array of Python objects"
            if "pickle" in str(error)
            else str(error).strip().removesuffix(".")
        )
        raise BadFile(source, key, "an array of numbers", got) from None


def _folder(folder: Path, keys: Sequence[str]) -> tuple[Arrays, list[str]]:
    if any(
        (folder / name).exists()
        for name in ("data/metadata.json", "data/main_data.hdf5", "metadata.json", "main_data.hdf5")
    ):
        return _minari(folder, folder), []
    files = {path.stem: path for path in sorted(folder.glob("*.npy"))}
    if not files:
        raise BadFile(
            folder,
            "",
            f"a folder with {', '.join(f'{key}.npy' for key in NEEDED)}, or a Minari data set",
            "neither",
        )
    return {
        key: _member(path, "", partial(_array_file, path))
        for key, path in files.items()
        if key in keys
    }, _others(files)


def _array_file(path: Path) -> NDArray[Any]:
    try:
        return np.asarray(np.load(path, allow_pickle=False))
    except (OSError, EOFError) as error:
        raise BadFile(
            path,
            "",
            "an .npy file, as numpy.save writes it",
            f"a file that cannot be read as one ({error})",
        ) from None


def _minari(source: Source, where: str | Path) -> Arrays:
    """The episodes of a Minari data set, each one trajectory."""
    try:
        minari = cast(Any, importlib.import_module("minari"))
    except ImportError:
        raise BadFile(source, "", NO_MINARI, "a Minari data set and no such package") from None
    try:
        if isinstance(where, Path):
            content = minari.MinariDataset(where / "data" if (where / "data").is_dir() else where)
        else:
            content = minari.load_dataset(where)
        episodes = list(content.iterate_episodes())
    except (OSError, ValueError, ImportError) as error:
        got = (
            "none of that name"
            if isinstance(error, FileNotFoundError)
            else str(error).strip().removesuffix(".")
        )
        raise BadFile(
            source, "", "a Minari data set of this machine (`minari download` fetches one)", got
        ) from None
    return _episodes(source, episodes)


def _rows(array: NDArray[Any]) -> NDArray[Any]:
    return array.reshape(len(array), -1)


def _episodes(source: Source, episodes: list[Any]) -> Arrays:
    """T + 1 observations and T actions an episode, as transitions."""
    episodes = [episode for episode in episodes if len(episode.rewards)]
    if not episodes:
        raise BadFile(source, "", "at least one episode with a step", "none")
    for key in ("observations", "actions"):
        if not isinstance(getattr(episodes[0], key), np.ndarray):
            raise BadFile(
                source,
                key,
                "one array for each episode",
                f"a {type(getattr(episodes[0], key)).__name__} of arrays",
            )
    observations = [_rows(episode.observations) for episode in episodes]
    return {
        "observations": np.concatenate([rows[:-1] for rows in observations]),
        "actions": np.concatenate([_rows(episode.actions) for episode in episodes]),
        "next_observations": np.concatenate([rows[1:] for rows in observations]),
        "terminals": np.concatenate(
            [np.arange(len(episode.actions)) == len(episode.actions) - 1 for episode in episodes]
        ),
    }
