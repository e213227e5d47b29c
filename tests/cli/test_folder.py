"""The folder of a run: tried before anything is computed, locked, kept from other runs."""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from dropo.cli.main import main
from dropo.cli.support.folder import run_folder
from dropo.core.services.errors import BadFile, Incompatible, InvalidInput
from dropo.core.services.files.progress_file import LOCK

RECORD = {"command": "test", "seed": 0}
HOLD = """
import sys
from pathlib import Path
from dropo.cli.support.folder import run_folder
with run_folder(Path(sys.argv[1])):
    print("at work", flush=True)
    sys.stdin.read()
"""


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def begin(out: Path, record: dict[str, Any], error: Exception | None = None) -> None:
    """Begin a run in a folder, which writes a file and then fails, where an error is given."""
    with run_folder(out) as folder:
        folder.claim(record)
        log = folder.file("log")
        if error is not None and log is not None:
            if not log.exists():
                log.write_text("half")
            raise error


def test_it_is_made_and_keeps_the_record(tmp_path: Path) -> None:
    """The same run goes on with it; another is refused and changes nothing."""
    out = tmp_path / "a" / "b"
    with run_folder(out) as folder:
        assert names(out) == [LOCK]
        folder.claim(RECORD)
    assert names(out) == ["run.json"]
    assert json.loads((out / "run.json").read_text()) == RECORD
    with run_folder(out) as folder:
        folder.claim(RECORD)
    with pytest.raises(BadFile, match="seed: expected the settings of this run"):
        begin(out, {**RECORD, "seed": 1})
    assert names(out) == ["run.json"]


def test_without_a_folder_nothing_is_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with run_folder(None) as folder:
        folder.claim(RECORD)
        assert folder.file("a") is None
    assert names(tmp_path) == []


def test_a_refused_run_leaves_nothing(tmp_path: Path) -> None:
    """Neither its files nor the folders that it made; what was there stays."""

    for out in (tmp_path / "a" / "b", tmp_path):
        with pytest.raises(InvalidInput, match="later"):
            begin(out, RECORD, InvalidInput("later"))
    assert names(tmp_path) == []
    (tmp_path / "log").write_text("own")
    (tmp_path / "notes").write_text("own")
    with pytest.raises(InvalidInput, match="later"):
        begin(tmp_path, RECORD, InvalidInput("later"))
    assert names(tmp_path) == ["log", "notes"]


def test_a_run_that_failed_keeps_what_it_has(tmp_path: Path) -> None:
    with pytest.raises(OSError, match="full"):
        begin(tmp_path, RECORD, OSError("full"))
    assert names(tmp_path) == ["log", "run.json"]


@pytest.mark.parametrize("name", ["fit.json", "diagnosis.json", "policy.json"])
def test_a_result_of_unknown_origin_is_not_overwritten(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_text("{}")
    with pytest.raises(BadFile, match=f"a new one, got one with {name} of another"):
        begin(tmp_path, RECORD)
    assert names(tmp_path) == [name]


def test_a_run_that_lives_is_named(tmp_path: Path) -> None:
    """By its process; when it has been killed, the folder is free."""
    command = [sys.executable, "-c", HOLD, str(tmp_path)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as other:
        assert other.stdout is not None
        other.stdout.readline()
        message = f"another dropo, process {other.pid} on .*, is at work here"
        with pytest.raises(Incompatible, match=message), run_folder(tmp_path):
            pass
        assert names(tmp_path) == [LOCK]
        other.kill()
    with run_folder(tmp_path):
        pass
    assert names(tmp_path) == []


def test_what_cannot_be_written_is_told_before_anything_is_computed(
    problem: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A folder below a file, a name that is too long: status 1, one line with the name."""
    monkeypatch.setattr("dropo.problems.loading.load", None)
    below = problem / "x" / "y"
    for out, told in ((below, f"{below}: Not a directory."), ("a" * 300, "File name too long.")):
        for command in ("fit", "diagnose", "train"):
            assert main([command, str(problem), "--out", str(out)]) == 1
            assert capsys.readouterr().err.endswith(f"{told}\n")
        assert main(["recover", "toy", "--out", str(out)]) == 1
        assert capsys.readouterr().err.count("\n") == 1


def test_a_diagnosis_is_not_written_onto_another_run(
    problem: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    assert main(["fit", str(problem), "--method", "least-squares", "--out", str(out)]) == 0
    before = {path: path.read_bytes() for path in out.iterdir()}
    capsys.readouterr()
    assert main(["diagnose", str(problem), "--effects", "joint_friction", "--out", str(out)]) == 2
    assert "expected the settings of this run, got those of another run" in capsys.readouterr().err
    assert {path: path.read_bytes() for path in out.iterdir()} == before


@pytest.mark.parametrize("saved", ["fit.npz", "fit.json", "predictions.npz", "made.json"])
def test_a_disk_that_is_full_at_the_end(
    problem: Path,
    tmp_path: Path,
    saved: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """The table is printed all the same; one line names the file; the same command ends as it
    would have.
    """
    out = tmp_path / "out"
    arguments = ["fit", str(problem), "--method", "least-squares", "--out", str(out)]
    replace = Path.replace

    def fail(self: Path, target: Path) -> Path:
        if Path(target).name == saved:
            raise OSError(28, os.strerror(28))
        return replace(self, target)

    with monkeypatch.context() as full:
        full.setattr(Path, "replace", fail)
        assert main(arguments) == 1
    text, errors = capsys.readouterr()
    assert "log-likelihood" in text
    assert errors == f"dropo: {out / saved}: No space left on device.\n"
    assert not (out / saved).exists()
    assert not [name for name in names(out) if name.startswith(".")]
    assert main(arguments) == 0
    assert {"fit.json", "fit.npz", "predictions.npz", "made.json"} < set(names(out))
