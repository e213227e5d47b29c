"""Paths in files that move."""

from pathlib import Path

import pytest

from dropo.core.services.files.places import way_to, without_root


def test_the_way_moves_with_both(tmp_path: Path) -> None:
    """Relative, also where a folder is reached through a link; a file's own link is kept."""
    folder = tmp_path / "real" / "run"
    folder.mkdir(parents=True)
    (tmp_path / "real" / "data.npz").write_bytes(b"")
    (tmp_path / "real" / "other.npz").symlink_to("data.npz")
    (tmp_path / "link").symlink_to("real")
    assert way_to(tmp_path / "link" / "data.npz", folder) == "../data.npz"
    assert way_to(tmp_path / "real" / "other.npz", tmp_path / "link" / "run") == "../other.npz"
    assert way_to(folder, folder) == "."


def test_words_of_commands(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Absolute paths alone change, also behind an option's equals sign."""
    monkeypatch.chdir(tmp_path)
    assert without_root(str(tmp_path / "a" / "b.yaml")) == "a/b.yaml"
    assert without_root(f"--out={tmp_path / 'a'}") == "--out=a"
    assert without_root(f"{tmp_path.parent / 'c.py'}") == "../c.py"
    for word in ("hopper", "a/b.yaml", "--quiet", "--hide", "joint:elbow=0.01", "--seed=3", ""):
        assert without_root(word) == word
