"""The published transitions against the problem's own simulator, and how external data are fetched
and refused.
"""

import hashlib

import numpy as np
import pooch
import pytest

from dropo.core.services.errors import BadFile
from dropo.problems.hopper import published as hopper_published
from dropo.problems.hopper.model import TRUTH
from dropo.problems.hopper.problem import NOISE, hopper_simulator
from dropo.problems.measured import external_data
from dropo.problems.measured.external_data import fetch_arrays, find_data, missing

MASSES = np.array(list(TRUTH.values()))
BASE = "https://example.org/sets"


def at_hand(which):
    """All transitions of a published set as segments; skipped, visibly, where the data are not at
    hand.
    """
    if find_data(f"hopper-published/{which}.npz") is None:
        pytest.skip(f"hopper-published/{which}.npz is not at hand (DROPO_DATA)")
    return hopper_published.published(which).segments()


def test_clean_transitions_are_predicted_to_rounding():
    """At the truth the largest error over all 10,000 transitions and 11 signals is below 1e-12; at
    1.001 x the masses it is not.
    """
    segments = at_hand("clean")
    simulator = hopper_simulator()
    at_truth, beside = simulator.predict([MASSES, 1.001 * MASSES], segments) - simulator.targets(
        segments
    )
    assert len(segments) == 10_000
    assert np.abs(at_truth).max() < 1e-12
    assert np.abs(beside).max() > 1e-4


def test_noisy_transitions_leave_the_noise():
    """At the truth the residual variance is 1e-5 within 3 standard errors, overall; at 1.01 x the
    masses it is not.
    """
    segments = at_hand("noisy-1e-5")
    simulator = hopper_simulator()
    at_truth, beside = simulator.predict([MASSES, 1.01 * MASSES], segments) - simulator.targets(
        segments
    )
    off = lambda residual: abs(np.mean(residual**2) / NOISE - 1) / np.sqrt(2 / residual.size)
    assert off(at_truth) < 3
    assert off(beside) > 3


@pytest.mark.parametrize("which", ["hopper_published", "hopper_published_noisy"])
def test_problems_take_the_first_thousand(which):
    """A fit takes 1000 transitions in two trajectories of 500; more where they are asked for."""
    at_hand("clean" if which == "hopper_published" else "noisy-1e-5")
    problem = getattr(hopper_published, which)(1)
    assert len(problem.trajectories) == 1000
    assert problem.trajectories.spans == [(0, 500), (500, 1000)]
    assert len(problem.using(transitions=2500).trajectories) == 2500
    assert problem.truth == TRUTH


def digest(array):
    """The sha256 of an array's float64 content."""
    return hashlib.sha256(np.ascontiguousarray(array, dtype=np.float64).tobytes()).hexdigest()


@pytest.fixture
def source(tmp_path, monkeypatch):
    """A folder that stands for the web, a cache beside it, and a list of the addresses that were
    asked for.
    """
    web = tmp_path / "web"
    asked = []
    (web / "set").mkdir(parents=True)
    monkeypatch.setattr(pooch, "os_cache", lambda name: tmp_path / "cache" / name)

    def copy(url, output, caller):
        asked.append(url)
        output = getattr(output, "name", output)
        with open(output, "wb") as kept:  # noqa: PTH123
            kept.write((web / url.removeprefix(BASE + "/")).read_bytes())

    monkeypatch.setattr(pooch.core, "choose_downloader", lambda *args, **more: copy)
    return web, tmp_path / "cache" / "dropo", asked


def test_right_content_is_fetched_once(source):
    """float32 files become float64 arrays; the second time they come from the cache."""
    web, cache, asked = source
    array = np.arange(6, dtype=np.float32).reshape(3, 2)
    np.save(web / "set" / "actions.npy", array)
    files = {"actions": ("set/actions.npy", digest(array))}
    for _ in range(2):
        found = fetch_arrays(BASE, files)
        np.testing.assert_array_equal(found["actions"], array)
        assert found["actions"].dtype == np.float64
    assert asked == [f"{BASE}/set/actions.npy"]
    assert [path.name for path in cache.iterdir()] == ["set-actions.npy"]


def test_wrong_content_is_refused_and_removed(source):
    """The message names address and both digests; the bad file is gone, so that the next try
    fetches again.
    """
    web, cache, asked = source
    good = np.ones((2, 2))
    bad = np.zeros((2, 2))
    np.save(web / "set" / "actions.npy", bad)
    files = {"actions": ("set/actions.npy", digest(good))}
    with pytest.raises(BadFile) as caught:
        fetch_arrays(BASE, files)
    assert str(caught.value) == (
        f"{BASE}/set/actions.npy: expected content with sha256 {digest(good)}, got {digest(bad)}."
    )
    assert list(cache.iterdir()) == []
    np.save(web / "set" / "actions.npy", good)
    np.testing.assert_array_equal(fetch_arrays(BASE, files)["actions"], good)
    assert len(asked) == 2


def test_without_a_network_it_is_refused(tmp_path, monkeypatch):
    """A download that fails is one sentence with the address and the way out, and no traceback of
    the network's.
    """
    monkeypatch.setattr(pooch, "os_cache", lambda name: tmp_path / name)

    def fail(*args, **more):
        raise ConnectionError("Failed to resolve host")

    monkeypatch.setattr(pooch.core, "choose_downloader", lambda *args, **more: fail)
    with pytest.raises(
        BadFile,
        match=r"actions\.npy: expected a public file .* DROPO_DATA names, "
        "got ConnectionError while fetching it",
    ):
        fetch_arrays(BASE, {"actions": ("actions.npy", "0" * 64)})


def test_published_sets_are_fetched_where_they_are_not_at_hand(monkeypatch):
    """Without the data, the six files of the authors' repository are asked for, and cut into
    trajectories of 500.
    """
    asked = []

    def fetch(base, files):
        asked.append((base, files))
        return {
            "observations": np.zeros((1500, 11)),
            "actions": np.zeros((1500, 3)),
            "next_observations": np.ones((1500, 11)),
        }

    monkeypatch.setattr(hopper_published, "find_data", lambda name: None)
    monkeypatch.setattr(hopper_published, "fetch_arrays", fetch)
    for which in ("clean", "noisy-1e-5"):
        assert hopper_published.published(which).spans == [(0, 500), (500, 1000), (1000, 1500)]
    assert {base for base, _ in asked} == {hopper_published.SOURCE}
    names = [file for _, files in asked for file, _ in files.values()]
    assert names == [
        *(
            f"hopper10000/hoppermass_n10000_{kind}.npy"
            for kind in ("observations", "actions", "nextobservations")
        ),
        *(
            f"hoppernoisy1e-510000/hopper_n10000_{kind}.npy"
            for kind in ("observations", "actions", "nextobservations")
        ),
    ]
    assert len({digest for _, files in asked for _, digest in files.values()}) == 6


@pytest.mark.parametrize("which", ["clean", "noisy-1e-5"])
def test_digests_are_those_of_the_data_at_hand(which):
    """What would be fetched has the content that lies in the data folder."""
    data = at_hand(which).trajectories
    assert (
        tuple(digest(getattr(data, key)) for key in hopper_published.KEYS)
        == hopper_published.DIGESTS[which]
    )


def test_named_folder_comes_first(tmp_path, monkeypatch):
    """DROPO_DATA is searched before the other folders; what is in none of them gets a message with
    all of them.
    """
    monkeypatch.setenv("DROPO_DATA", str(tmp_path))
    (tmp_path / "set").mkdir()
    (tmp_path / "set" / "runs.npz").touch()
    assert find_data("set/runs.npz") == tmp_path / "set" / "runs.npz"
    assert find_data("set/none.npz") is None
    words = str(missing("set/none.npz", "someone"))
    assert words.startswith(
        "set/none.npz: expected the data of someone in the folder that DROPO_DATA names, "
        "got no such file in "
    )
    assert all(str(folder) in words for folder in external_data.data_folders())
