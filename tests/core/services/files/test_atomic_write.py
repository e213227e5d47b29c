"""A file appears whole or not at all, and nothing is left beside it."""

import json
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest

from dropo.core.services.files.atomic_write import atomic_write, write_json, write_npz, write_text


def write_half(path: Path) -> None:
    """Write a piece of a new file, then fail."""
    with atomic_write(path) as part:
        part.write_text("half of the new")
        raise KeyboardInterrupt


def test_an_interrupted_write_leaves_the_old_file(tmp_path: Path) -> None:
    """The old content stays, no temporary file does; the control: the same write in full replaces
    it.
    """
    path = tmp_path / "fit.json"
    path.write_text("the old")
    with pytest.raises(KeyboardInterrupt):
        write_half(path)
    assert path.read_text() == "the old"
    assert list(tmp_path.iterdir()) == [path]
    write_text(path, "the new, with an é")
    assert path.read_text(encoding="utf-8") == "the new, with an é"
    assert list(tmp_path.iterdir()) == [path]


def test_nothing_is_at_the_place_before_the_end(tmp_path: Path) -> None:
    """While a file is being written only the temporary file is there, in the same folder and of the
    same kind.
    """
    path = tmp_path / "made" / "model.zip"
    with atomic_write(path) as part:
        part.write_bytes(b"1")
        assert not path.exists()
        assert part.parent == path.parent
        assert part.suffix == ".zip"
    assert path.read_bytes() == b"1"
    assert list(path.parent.iterdir()) == [path]


class Broken:
    """What fails when it is saved."""

    def __array__(self, dtype: object = None, copy: object = None) -> np.ndarray:
        raise RuntimeError("no array")


def test_a_failed_write_leaves_nothing(tmp_path: Path) -> None:
    """JSON with a number that is not finite, and an array that cannot be saved; the controls are
    written.
    """
    with pytest.raises(ValueError, match="not JSON compliant"):
        write_json(tmp_path / "a.json", {"x": float("nan")})
    with pytest.raises(RuntimeError, match="no array"):
        write_npz(tmp_path / "a.npz", {"rows": np.zeros(2), "broken": Broken()})
    assert list(tmp_path.iterdir()) == []
    write_json(tmp_path / "a.json", {"x": 1.5})
    assert json.loads((tmp_path / "a.json").read_text()) == {"x": 1.5}
    for compressed in (False, True):
        write_npz(tmp_path / "a.npz", {"rows": np.arange(3.0)}, compressed=compressed)
        assert (np.load(tmp_path / "a.npz")["rows"] == [0, 1, 2]).all()


@pytest.mark.parametrize("fails", [True, False])
def test_files_that_belong_together(tmp_path: Path, fails: bool) -> None:
    """Of two files none appears where the second cannot be written; the control: both do."""
    paths = [tmp_path / "data.npz", tmp_path / "problem.yaml"]
    try:
        with ExitStack() as stack:
            parts = [stack.enter_context(atomic_write(path)) for path in paths]
            write_npz(parts[0], {"rows": np.zeros(2)})
            if fails:
                raise OSError("no space")
            write_text(parts[1], "data: data.npz\n")
    except OSError:
        pass
    assert sorted(tmp_path.iterdir()) == ([] if fails else paths)
