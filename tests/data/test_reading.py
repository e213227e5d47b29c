"""Data files: four ways to lay them out give the same trajectories, and every refusal names file,
key, expected and got.
"""

import sys
import types
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dropo.core.records.trajectories import Trajectories
from dropo.core.services.errors import BadFile
from dropo.data.reading import read, run_names

Arrays = dict[str, Any]


@pytest.fixture
def arrays() -> Arrays:
    """Two trajectories of 3 and 2 transitions whose rows follow each other, p = 2, q = 1."""
    rng = np.random.default_rng(0)
    chains = [rng.normal(size=(4, 2)), rng.normal(size=(3, 2))]
    return {
        "observations": np.concatenate([c[:-1] for c in chains]),
        "next_observations": np.concatenate([c[1:] for c in chains]),
        "actions": rng.normal(size=(5, 1)),
        "terminals": np.array([0, 0, 1, 0, 1], dtype=bool),
    }


def same(one: Trajectories, other: Trajectories) -> bool:
    keys = ("observations", "actions", "next_observations", "terminals")
    return all(np.array_equal(getattr(one, key), getattr(other, key)) for key in keys)


def saved(folder: Path, arrays: Arrays, name: str = "data.npz") -> Path:
    np.savez(folder / name, **arrays)
    return folder / name


def refusal(source: Any, folder: Path) -> str:
    with pytest.raises(BadFile) as caught:
        read(source)
    return str(caught.value).replace(f"{folder}/", "")


def test_an_archive_and_a_folder_are_the_same(tmp_path: Path, arrays: Arrays) -> None:
    extra = {
        **arrays,
        "group": np.array([7, 7, 7, 3, 3]),
        "time": np.arange(5.0),
        "rewards": np.zeros(9),
    }
    one = read(saved(tmp_path, extra))
    (tmp_path / "folder").mkdir()
    for key, value in extra.items():
        np.save(tmp_path / "folder" / f"{key}.npy", value)
    assert same(one, read(tmp_path / "folder"))
    assert same(one, read(str(tmp_path / "folder")))
    assert one.group is not None
    assert one.group.tolist() == [1, 1, 1, 0, 0]
    assert one.time is not None
    assert one.spans == [(0, 3), (3, 5)]


def test_next_observations_are_the_following_rows(tmp_path: Path, arrays: Arrays) -> None:
    """Without next_observations each trajectory loses its last row, and the row before it ends the
    trajectory.
    """
    del arrays["next_observations"]
    arrays["time"] = np.arange(5.0)
    found = read(saved(tmp_path, arrays))
    assert found.terminals.tolist() == [False, True, True]
    assert found.time is not None
    assert found.time.tolist() == [0, 1, 3]
    np.testing.assert_array_equal(found.next_observations, arrays["observations"][[1, 2, 4]])
    np.testing.assert_array_equal(found.actions, arrays["actions"][[0, 1, 3]])


def test_a_row_alone_is_dropped(tmp_path: Path, arrays: Arrays) -> None:
    del arrays["next_observations"]
    arrays["terminals"][:] = [1, 0, 1, 1, 1]
    assert len(read(saved(tmp_path, arrays))) == 1
    arrays["terminals"][:] = True
    message = (
        "data.npz: next_observations: expected the array, or trajectories of at least two "
        "rows, got neither."
    )
    assert refusal(saved(tmp_path, arrays), tmp_path) == message


def test_a_list_is_concatenated(tmp_path: Path, arrays: Arrays) -> None:
    """Files never share a group."""
    arrays["group"] = np.array([1, 1, 1, 2, 2])
    one = saved(tmp_path, arrays)
    two = saved(tmp_path, arrays, "more.npz")
    found = read([one, two])
    assert len(found) == 10
    assert found.group is not None
    assert found.group.tolist() == [0, 0, 0, 1, 1, 2, 2, 2, 3, 3]
    assert same(found.select([2, 3]), read(two))


def test_numbers_of_other_kinds(tmp_path: Path, arrays: Arrays) -> None:
    """float32 rows, whole numbers and 0 / 1 terminals are numbers too."""
    kinds = {"observations": np.float32, "actions": np.int16, "terminals": np.uint8}
    found = read(
        saved(
            tmp_path,
            {key: value.astype(kinds.get(key, value.dtype)) for key, value in arrays.items()},
        )
    )
    assert found.observations.dtype == found.actions.dtype == np.float64
    assert found.terminals.dtype == bool


def test_no_actions_at_all(tmp_path: Path, arrays: Arrays) -> None:
    assert read(saved(tmp_path, {**arrays, "actions": np.empty((5, 0))})).actions.shape == (5, 0)


REPLACED = {
    "NaN": (
        "observations",
        np.array([[0, 0], [0, np.nan]] + [[0, 0]] * 3),
        "observations: expected finite numbers, got nan at row 1, column 1.",
    ),
    "infinity": (
        "actions",
        np.array([[0], [0], [np.inf], [0], [0]]),
        "actions: expected finite numbers, got inf at row 2, column 0.",
    ),
    "short actions": (
        "actions",
        np.zeros((4, 1)),
        "actions: expected the shape (5, 1), since observations is (5, 2), got (4, 1).",
    ),
    "flat actions": (
        "actions",
        np.zeros(5),
        "actions: expected the shape (5, q), since observations is (5, 2), got (5,).",
    ),
    "flat observations": (
        "observations",
        np.zeros(5),
        "observations: expected the shape (N, p), a row for each transition, got (5,).",
    ),
    "other next": (
        "next_observations",
        np.zeros((5, 3)),
        "next_observations: expected the shape (5, 2), since observations is (5, 2), got (5, 3).",
    ),
    "other terminals": (
        "terminals",
        np.ones(4, bool),
        "terminals: expected the shape (5,), since observations has 5 rows, got (4,).",
    ),
    "no terminal": (
        "terminals",
        np.zeros(5, bool),
        "terminals: expected True on each trajectory's last row, got no True at all.",
    ),
    "open end": (
        "terminals",
        np.array([1, 0, 0, 0, 0], bool),
        "terminals: expected True on each trajectory's last row, got False on the last row.",
    ),
    "counts": (
        "terminals",
        np.arange(5),
        "terminals: expected True and False alone, got an array of int64 with other values.",
    ),
    "words": (
        "observations",
        np.array([["a", "b"]] * 5),
        "observations: expected an array of numbers, got an array of <U1.",
    ),
    "objects": (
        "observations",
        np.array([None, 1, 2, 3, 4], dtype=object),
        "observations: expected an array of numbers, got an array of Python objects.",
    ),
    "group of floats": (
        "group",
        np.zeros(5),
        "group: expected whole numbers, got an array of float64.",
    ),
    "short group": (
        "group",
        np.zeros(4, int),
        "group: expected the shape (5,), since observations has 5 rows, got (4,).",
    ),
    "time as a column": (
        "time",
        np.zeros((5, 1)),
        "time: expected the shape (5,), since observations is (5, 2), got (5, 1).",
    ),
    "no rows": (
        "observations",
        np.empty((0, 2)),
        "observations: expected at least one row, got none.",
    ),
}


@pytest.mark.parametrize(("key", "value", "message"), REPLACED.values(), ids=REPLACED)
def test_refusals(tmp_path: Path, arrays: Arrays, key: str, value: Any, message: str) -> None:
    assert refusal(saved(tmp_path, {**arrays, key: value}), tmp_path) == f"data.npz: {message}"


def test_a_missing_array(tmp_path: Path, arrays: Arrays) -> None:
    arrays["terminal"] = arrays.pop("terminals")
    got = "only actions, next_observations, observations, terminal"
    assert (
        refusal(saved(tmp_path, arrays), tmp_path)
        == f"data.npz: terminals: expected an array of that name, got {got}."
    )
    assert (
        refusal(saved(tmp_path, {}), tmp_path)
        == "data.npz: observations: expected an array of that name, got no arrays at all."
    )


def test_files_that_cannot_be_read(tmp_path: Path, arrays: Arrays) -> None:
    archive = "an .npz file, as numpy.savez writes it"
    (tmp_path / "empty.npz").touch()
    assert (
        refusal(tmp_path / "empty.npz", tmp_path)
        == f"empty.npz: expected {archive}, got an empty file."
    )
    (tmp_path / "text.npz").write_text("hello")
    assert refusal(tmp_path / "text.npz", tmp_path).startswith(
        f"text.npz: expected {archive}, got a file that cannot be read as one ("
    )
    whole = saved(tmp_path, arrays).read_bytes()
    (tmp_path / "half.npz").write_bytes(whole[: len(whole) // 2])
    assert refusal(tmp_path / "half.npz", tmp_path).startswith(
        f"half.npz: expected {archive}, got a file that cannot be read as one ("
    )
    (tmp_path / "log.csv").write_text("t,q\n")
    assert refusal(tmp_path / "log.csv", tmp_path) == (
        "log.csv: expected an .npz file (`dropo data import` makes one from tables and "
        "logs), got a file '.csv'."
    )
    assert refusal(tmp_path / "none.npz", tmp_path) == (
        "none.npz: expected an .npz file, a folder of .npy files or a Minari data set, got "
        "no such file."
    )


def test_an_empty_folder_and_an_empty_list(tmp_path: Path) -> None:
    (tmp_path / "folder").mkdir()
    assert refusal(tmp_path / "folder", tmp_path) == (
        "folder: expected a folder with observations.npy, actions.npy, terminals.npy, or a "
        "Minari data set, got neither."
    )
    assert refusal([], tmp_path) == "data: expected at least one file, got an empty list."


def test_an_array_file_with_objects(tmp_path: Path, arrays: Arrays) -> None:
    np.save(tmp_path / "observations.npy", np.array([{}], dtype=object))
    assert refusal(tmp_path, tmp_path).endswith(
        "observations.npy: expected an array of numbers, got an array of Python objects."
    )


def test_files_of_a_list_must_have_the_same_columns(tmp_path: Path, arrays: Arrays) -> None:
    one = saved(tmp_path, arrays)
    wide = saved(tmp_path, {**arrays, "actions": np.zeros((5, 3))}, "wide.npz")
    assert (
        refusal([one, wide], tmp_path)
        == "wide.npz: actions: expected 1 columns, as in data.npz, got 3."
    )
    timed = saved(tmp_path, {**arrays, "time": np.arange(5.0)}, "timed.npz")
    message = (
        "data.npz: time: expected the array in every file or in none, got none here and one in "
        "timed.npz."
    )
    assert refusal([one, timed], tmp_path) == refusal([timed, one], tmp_path) == message


def test_every_file_of_a_list_ends_a_trajectory(tmp_path: Path, arrays: Arrays) -> None:
    one = saved(tmp_path, arrays)
    opened = saved(tmp_path, {**arrays, "terminals": np.array([1, 0, 0, 0, 0], bool)}, "open.npz")
    assert refusal([opened, one], tmp_path).startswith("open.npz: terminals: ")


# Minari, with a stand-in for the package


class _Episode:
    def __init__(self, observations: Any, actions: Any):
        self.observations = observations
        self.actions = actions
        self.rewards = np.zeros(len(actions))


@pytest.fixture
def minari(monkeypatch: pytest.MonkeyPatch) -> list[_Episode]:
    """A package `minari` whose data sets hold the episodes of the returned list; its name is
    "hopper/simple-v0".
    """
    episodes: list[_Episode] = []
    package = types.ModuleType("minari")

    def load_dataset(name: str) -> Any:
        if name != "hopper/simple-v0":
            raise FileNotFoundError(f"Dataset {name} not found locally.")
        return types.SimpleNamespace(iterate_episodes=lambda: iter(episodes))

    package.load_dataset = load_dataset  # type: ignore[attr-defined]
    package.MinariDataset = lambda path: load_dataset("hopper/simple-v0")  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "minari", package)
    return episodes


def test_minari_episodes_are_trajectories(tmp_path: Path, minari: list[_Episode]) -> None:
    """T + 1 observations and T actions give T transitions."""
    rng = np.random.default_rng(0)
    minari += [
        _Episode(rng.normal(size=(4, 2)), rng.normal(size=(3, 1))),
        _Episode(rng.normal(size=(3, 2)), rng.normal(size=2)),
    ]
    found = read("minari:hopper/simple-v0")
    assert found.spans == [(0, 3), (3, 5)]
    assert found.actions.shape == (5, 1)
    np.testing.assert_array_equal(found.next_observations[:2], found.observations[1:3])
    np.testing.assert_array_equal(found.next_observations[2], minari[0].observations[3])
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / "metadata.json").write_text("{}")
    assert same(found, read(tmp_path))


def test_minari_refusals(tmp_path: Path, minari: list[_Episode]) -> None:
    wanted = "a Minari data set of this machine (`minari download` fetches one)"
    assert (
        refusal("minari:other", tmp_path)
        == f"minari:other: expected {wanted}, got none of that name."
    )
    assert (
        refusal("minari:hopper/simple-v0", tmp_path)
        == "minari:hopper/simple-v0: expected at least one episode with a step, got none."
    )
    minari.append(_Episode({"position": np.zeros((3, 2))}, np.zeros((2, 1))))
    message = (
        "minari:hopper/simple-v0: observations: expected one array for each episode, got a "
        "dict of arrays."
    )
    assert refusal("minari:hopper/simple-v0", tmp_path) == message


def test_without_minari(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "minari", None)
    wanted = "the extra 'minari' to read it (pip install 'dropo[minari]')"
    assert (
        refusal("minari:any", tmp_path)
        == f"minari:any: expected {wanted}, got a Minari data set and no such package."
    )


def test_runs_are_named_by_their_groups(tmp_path: Path, arrays: Arrays) -> None:
    """Each trajectory by its group's name, without names by none; fewer names than groups are
    refused.
    """
    group = np.array([1, 1, 1, 0, 0])
    named = arrays | {"group": group, "run_names": np.array(["slow", "fast"])}
    assert run_names(saved(tmp_path, named)) == ["fast", "slow"]
    assert run_names(saved(tmp_path, arrays)) == ["", ""]
    assert run_names(saved(tmp_path, arrays | {"group": group})) == ["", ""]
    with pytest.raises(BadFile, match="run_names: expected a name for each of 2 groups, got 1"):
        run_names(saved(tmp_path, named | {"run_names": np.array(["slow"])}))


def test_a_name_too_long_for_a_file_is_none(tmp_path: Path) -> None:
    with pytest.raises(BadFile, match=r"x{100}"):
        read(str(tmp_path / ("x" * 5000)))
