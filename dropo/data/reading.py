"""Reads measured transitions: NPZ archives, folders of NPY files, Minari data sets, or several."""

import importlib
from collections.abc import Iterable, Sequence, Set
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from dropo.core.records.trajectories import Trajectories
from dropo.core.services.errors import BadFile
from dropo.core.services.files.saved_files import NPZ, names_in_npz, read_npy, read_npz
from dropo.core.services.validation import Array

NEEDED = ("observations", "actions", "terminals")
"""Arrays that every source holds."""
NUMBERS = ("observations", "actions", "next_observations", "time")
"""Arrays of floating-point numbers."""
KEYS = (*NUMBERS, "terminals", "group")
"""Arrays that are read."""
RUN_NAMES = "run_names"
"""The array that names the runs by their numbers in `group`."""
INPUT = "actions."
"""What the names of several logged commands begin with."""
MINARI = "minari:"
"""What the name of an installed Minari data set begins with."""
MINARI_FILES = (
    "data/metadata.json",
    "data/main_data.hdf5",
    "metadata.json",
    "main_data.hdf5",
)
"""Files by which a folder is known as a Minari data set."""
NO_MINARI = "the extra 'minari' to read it (pip install 'dropo[minari]')"
END = "True on each trajectory's last row"
MOST_NAMES = 12  # names of arrays in a message

Arrays = dict[str, NDArray[Any]]
Source = str | Path


def read(
    source: Source | Sequence[Source],
    *,
    input: str | None = None,
    zero_actions: int | None = None,
) -> Trajectories:
    """Read the trajectories of one or several sources.

    Parameters
    ----------
    source : str, Path, or sequence of them
        An .npz file, a folder of .npy files of the same names, a folder in Minari's layout, or
        "minari:" and the name of a Minari data set; or a list of such.
    input : str, optional
        Where several commands were logged as `actions.NAME` (N, q): whose are the actions.
    zero_actions : int, optional
        This many columns of zeros are the actions, whether or not the source holds any. By default
        it must hold them.

    Returns
    -------
    Trajectories

    Raises
    ------
    BadFile
        If a source is missing or cannot be read, an array is missing, has another shape or type or
        holds numbers that are not finite, or the files of a list have different columns.

    Notes
    -----
    The arrays are `observations` (N, p), `actions` (N, q), `terminals` (N,) with True on each
    trajectory's last row, and optionally `next_observations` (N, p), `group` (N,) and `time` (N,)
    in seconds; others are ignored. Without `next_observations` the rows of a trajectory follow each
    other, and its last row, which has no next one, is dropped. Group numbers count within one file:
    files never share a group.
    """
    sources = [source] if isinstance(source, str | Path) else list(source)
    if not sources:
        raise BadFile("data", "", "at least one file", "an empty list")
    return _concatenate([(one, _read_source(one, input, zero_actions)) for one in sources])


def inputs_of(source: Source) -> tuple[str, ...]:
    """List the commands that a source holds beside each other, as `actions.NAME`.

    Parameters
    ----------
    source : str or Path
        As `read` takes it.

    Returns
    -------
    tuple of str
        Every NAME.

    Raises
    ------
    BadFile
        If the source is missing or cannot be read.
    """
    _, others = _load(source, KEYS)
    return tuple(name.removeprefix(INPUT) for name in others if name.startswith(INPUT))


def run_names(source: Source) -> list[str]:
    """Name the run of every trajectory of a source.

    Parameters
    ----------
    source : str or Path
        As `read` takes it.

    Returns
    -------
    list of str
        By the array `run_names` (G,) of text, which names the numbers in `group`; empty names where
        the source has no such array.

    Raises
    ------
    BadFile
        If the source is missing or cannot be read, or has fewer names than groups.
    """
    raw, _ = _load(source, (*KEYS, RUN_NAMES))
    terminals = np.asarray(raw.get("terminals", []), dtype=bool)
    last = np.flatnonzero(terminals)
    if "next_observations" not in raw:  # trajectories of one row are dropped
        last = last[np.diff(last, prepend=-1) > 1]
    if RUN_NAMES not in raw or "group" not in raw:
        return [""] * len(last)
    names = [str(name) for name in raw[RUN_NAMES]]
    groups = raw["group"][last].astype(int)
    if len(groups) and groups.max() >= len(names):
        expected = f"a name for each of {int(groups.max()) + 1} groups"
        raise BadFile(source, RUN_NAMES, expected, str(len(names)))
    return [names[i] for i in groups]


def _concatenate(parts: list[tuple[Source, Arrays]]) -> Trajectories:
    """Trajectories of files that have the same columns."""
    first = parts[0]
    for part in parts[1:]:
        _require_same_columns(first, part)
    _separate_groups([arrays for _, arrays in parts])
    joined = {key: np.concatenate([arrays[key] for _, arrays in parts]) for key in first[1]}
    return Trajectories(**joined)


def _require_same_columns(first: tuple[Source, Arrays], other: tuple[Source, Arrays]) -> None:
    """Refuse a file whose columns, or optional arrays, are not those of the first."""
    first_source, first_arrays = first
    source, arrays = other
    for key in ("observations", "actions"):
        wanted = first_arrays[key].shape[1]
        columns = arrays[key].shape[1]
        if columns != wanted:
            raise BadFile(source, key, f"{wanted} columns, as in {first_source}", f"{columns}")
    for key in ("group", "time"):
        if (key in arrays) == (key in first_arrays):
            continue
        given, missing = (source, first_source) if key in arrays else (first_source, source)
        expected = "the array in every file or in none"
        raise BadFile(missing, key, expected, f"none here and one in {given}")


def _separate_groups(parts: list[Arrays]) -> None:
    """Number each file's groups behind those of the one before."""
    used = 0
    for arrays in parts:
        if "group" in arrays:
            _, numbers = np.unique(arrays["group"], return_inverse=True)
            arrays["group"] = numbers + used
            used = int(arrays["group"].max()) + 1


def _read_source(source: Source, input: str | None, zero_actions: int | None) -> Arrays:
    """One file's arrays under the names of Trajectories, checked, with next_observations."""
    raw = _needed_arrays(source, input, zero_actions)
    arrays: Arrays = {key: _numbers(source, key, raw[key]) for key in NUMBERS if key in raw}
    rows = _require_shapes(source, arrays)
    arrays["terminals"] = _terminals(source, raw["terminals"], rows)
    if "group" in raw:
        arrays["group"] = _group(source, raw["group"], rows)
    return arrays if "next_observations" in arrays else _paired(source, arrays)


def _needed_arrays(source: Source, input: str | None, zero_actions: int | None) -> Arrays:
    """The arrays as they are stored, with the actions that were asked for."""
    chosen = "actions" if input is None else INPUT + input
    raw, others = _load(source, (*KEYS, chosen))
    if input is not None and chosen not in raw:
        inputs = {name for name in others if name.startswith(INPUT)}
        raise BadFile(source, chosen, "an array of that name", _present(inputs))
    if chosen in raw:
        raw["actions"] = raw[chosen]
    for key in NEEDED:
        can_be_missing = key == "actions" and zero_actions is not None
        if key not in raw and not can_be_missing:
            raise BadFile(source, key, "an array of that name", _present({*raw, *others}))
    if zero_actions is not None:
        rows = len(np.atleast_1d(raw["observations"]))
        raw["actions"] = np.zeros((rows, zero_actions))
    return raw


def _require_shapes(source: Source, arrays: Arrays) -> int:
    """The number of rows, where all arrays of numbers have as many."""
    observations = arrays["observations"]
    if observations.ndim != 2 or observations.shape[1] == 0:
        expected = "the shape (N, p), a row for each transition"
        raise BadFile(source, "observations", expected, _shape(observations.shape))
    n, p = observations.shape
    if n == 0:
        raise BadFile(source, "observations", "at least one row", "none")
    q = arrays["actions"].shape[1] if arrays["actions"].ndim == 2 else "q"
    for key, shape in {"actions": (n, q), "next_observations": (n, p), "time": (n,)}.items():
        if key in arrays and arrays[key].shape != shape:
            expected = f"the shape {_shape(shape)}, since observations is {_shape((n, p))}"
            raise BadFile(source, key, expected, _shape(arrays[key].shape))
    return n


def _paired(source: Source, arrays: Arrays) -> Arrays:
    """Transitions between rows that follow each other, without each trajectory's last row."""
    last = arrays["terminals"]
    keep = ~last
    if not keep.any():
        expected = "the array, or trajectories of at least two rows"
        raise BadFile(source, "next_observations", expected, "neither")
    out = {key: array[keep] for key, array in arrays.items()}
    following = np.flatnonzero(keep) + 1
    out["next_observations"] = arrays["observations"][following]
    out["terminals"] = last[following]
    return out


def _numbers(source: Source, key: str, array: NDArray[Any]) -> Array:
    """An array as float64, where it holds finite numbers."""
    if array.dtype.kind not in "biuf":
        raise BadFile(source, key, "an array of numbers", f"an array of {array.dtype}")
    bad = np.argwhere(~np.isfinite(array))
    if len(bad):
        first = bad[0]
        named = zip(("row", "column"), first, strict=False)
        place = ", ".join(f"{axis} {i}" for axis, i in named)
        raise BadFile(source, key, "finite numbers", f"{array[tuple(first)]} at {place}")
    return array.astype(np.float64)


def _terminals(source: Source, array: NDArray[Any], n: int) -> NDArray[np.bool_]:
    """The flags (n,) of each trajectory's last row."""
    _require_rows(source, "terminals", array, n)
    if not np.isin(array, (0, 1)).all():
        got = f"an array of {array.dtype} with other values"
        raise BadFile(source, "terminals", "True and False alone", got)
    flags = array.astype(bool)
    if not flags.any():
        raise BadFile(source, "terminals", END, "no True at all")
    if not flags[-1]:
        raise BadFile(source, "terminals", END, "False on the last row")
    return flags


def _group(source: Source, array: NDArray[Any], n: int) -> NDArray[Any]:
    """The group numbers (n,)."""
    if array.dtype.kind not in "iu":
        raise BadFile(source, "group", "whole numbers", f"an array of {array.dtype}")
    _require_rows(source, "group", array, n)
    return array


def _require_rows(source: Source, key: str, array: NDArray[Any], n: int) -> None:
    """Refuse an array that has not one number a row."""
    if array.shape != (n,):
        expected = f"the shape ({n},), since observations has {n} rows"
        raise BadFile(source, key, expected, _shape(array.shape))


def _shape(shape: Sequence[object]) -> str:
    """A shape as Python writes it, in which an entry may be a letter."""
    comma = "," if len(shape) == 1 else ""
    return f"({', '.join(map(str, shape))}{comma})"


def _present(names: Set[str]) -> str:
    """The arrays that are there, for a message."""
    if not names:
        return "no arrays at all"
    shown = sorted(names)[:MOST_NAMES]
    more = ", ..." if len(names) > len(shown) else ""
    return f"only {', '.join(shown)}{more}"


def _load(source: Source, keys: Sequence[str]) -> tuple[Arrays, list[str]]:
    """The arrays of one source of these names, and the names of others that it holds."""
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
        expected = "an .npz file, a folder of .npy files or a Minari data set"
        raise BadFile(source, "", expected, "no such file")
    if path.suffix != ".npz":
        expected = "an .npz file (`dropo data import` makes one from tables and logs)"
        raise BadFile(source, "", expected, f"a file {path.suffix!r}")
    return _archive(path, keys)


def _archive(path: Path, keys: Sequence[str]) -> tuple[Arrays, list[str]]:
    """The arrays of an .npz file, and the names of others."""
    return read_npz(path, NPZ, keys), _others(names_in_npz(path, NPZ))


def _others(names: Iterable[str]) -> list[str]:
    """The names of arrays that are not read unasked."""
    return [name for name in names if name not in KEYS]


def _folder(folder: Path, keys: Sequence[str]) -> tuple[Arrays, list[str]]:
    """The arrays of a folder of .npy files or of a Minari data set, and the names of others."""
    if any((folder / name).exists() for name in MINARI_FILES):
        return _minari(folder, folder), []
    files = {path.stem: path for path in sorted(folder.glob("*.npy"))}
    if not files:
        wanted = ", ".join(f"{key}.npy" for key in NEEDED)
        raise BadFile(folder, "", f"a folder with {wanted}, or a Minari data set", "neither")
    arrays = {}
    for key, path in files.items():
        if key in keys:
            arrays[key] = read_npy(path)
    return arrays, _others(files)


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
        got = str(error).strip().removesuffix(".")
        if isinstance(error, FileNotFoundError):
            got = "none of that name"
        expected = "a Minari data set of this machine (`minari download` fetches one)"
        raise BadFile(source, "", expected, got) from None
    return _transitions(source, episodes)


def _transitions(source: Source, episodes: list[Any]) -> Arrays:
    """Transitions of episodes with T + 1 observations and T actions each."""
    episodes = [episode for episode in episodes if len(episode.rewards)]
    if not episodes:
        raise BadFile(source, "", "at least one episode with a step", "none")
    for key in ("observations", "actions"):
        content = getattr(episodes[0], key)
        if not isinstance(content, np.ndarray):
            got = f"a {type(content).__name__} of arrays"
            raise BadFile(source, key, "one array for each episode", got)
    observations = [_flat_rows(episode.observations) for episode in episodes]
    actions = [_flat_rows(episode.actions) for episode in episodes]
    terminals = [np.arange(len(rows)) == len(rows) - 1 for rows in actions]
    return {
        "observations": np.concatenate([rows[:-1] for rows in observations]),
        "actions": np.concatenate(actions),
        "next_observations": np.concatenate([rows[1:] for rows in observations]),
        "terminals": np.concatenate(terminals),
    }


def _flat_rows(array: NDArray[Any]) -> NDArray[Any]:
    """An array (n, ...) with one flat row for each of the first axis."""
    return array.reshape(len(array), -1)
