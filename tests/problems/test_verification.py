"""What a diagnosis announces holds in plain MuJoCo."""

import json
import shutil
from contextlib import contextmanager

import numpy as np
import pytest

from dropo.cli.main import main
from dropo.problems.file.verification import TOLERANCE, verify
from dropo.problems.file.writer import write_problem
from tests.models.hidden_in_arm import problem

SOME = ["--effects", "joint_damping", "actuator_delay"]


@pytest.fixture(scope="module")
def diagnosis(tmp_path_factory):
    """The folder of a diagnosis that names a late command."""
    folder = tmp_path_factory.mktemp("late")
    path = write_problem(problem([("actuator_delay", [0.012])], episodes=12), folder / "problem")
    out = folder / "out"
    assert main(["diagnose", str(path), *SOME, "--out", str(out), "--quiet"]) == 0
    return out


@pytest.fixture
def copied(diagnosis, tmp_path):
    """A copy of it."""
    return shutil.copytree(diagnosis, tmp_path / "out")


@contextmanager
def diagnosis_of(folder):
    """The content of its diagnosis.json, which is written again as it was changed."""
    kept = folder / "diagnosis.json"
    content = json.loads(kept.read_text())
    yield content
    kept.write_text(json.dumps(content))


def test_errors_are_those_announced(diagnosis, capsys):
    """At every horizon and unit, on the terminal and as JSON; status 0."""
    found = verify(diagnosis)
    announced = json.loads((diagnosis / "diagnosis.json").read_text())["extended"]["horizons"]
    assert len(found.errors) == sum(len(one["units"]) for one in announced) > 0
    assert found.difference < 1e-6
    assert main(["verify", str(diagnosis)]) == 0
    assert "The errors are as announced" in capsys.readouterr().out
    assert main(["verify", str(diagnosis), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["holds"] is True


def test_another_model_is_noticed(copied, capsys):
    """The control: with a joint's damping doubled the errors are others; status 1."""
    path = copied / "extended" / "model.npz"
    with np.load(path) as kept:
        numbers = dict(kept)
    np.savez(path, **numbers, dof_damping=np.array([0.1, 0.1]))
    found = verify(copied)
    assert found.difference > TOLERANCE
    assert main(["verify", str(copied)]) == 1
    assert "NOT as announced" in capsys.readouterr().out


def test_a_changed_file_runs_when_trusted(copied):
    """Without its delay the errors are others; without --trust it is not run."""
    path = copied / "extended" / "model.py"
    text = path.read_text()
    path.write_text(
        text.replace("return Robot(model, FRAME_SKIP, EFFECTS)", "return Robot(model, FRAME_SKIP)")
    )
    assert path.read_text() != text
    assert main(["verify", str(copied)]) == 2
    assert verify(copied, trusted=True).difference > TOLERANCE


def test_an_error_that_was_not_announced_is_refused(copied, capsys):
    """A unit taken out of diagnosis.json is named."""
    with diagnosis_of(copied) as content:
        del content["extended"]["horizons"][0]["units"]["rad"]
    assert main(["verify", str(copied)]) == 2
    told = capsys.readouterr().err
    assert "extended.horizons.0.units: expected an error in rad, got rad/s" in told


def test_an_error_that_is_null_is_refused(copied, capsys):
    """Of a horizon whose own error is known."""
    with diagnosis_of(copied) as content:
        content["extended"]["horizons"][0]["units"]["rad"]["rmse"] = None
    assert main(["verify", str(copied)]) == 2
    told = capsys.readouterr().err
    assert "extended.horizons.0.units.rad.rmse: expected a number" in told


def test_an_error_of_none_is_no_error_of_the_model(copied):
    """An announced error of 0 does not hold; nothing is divided by it."""
    with diagnosis_of(copied) as content:
        content["extended"]["horizons"][0]["units"]["rad"]["rmse"] = 0.0
    assert TOLERANCE < verify(copied).difference < np.inf


@pytest.mark.parametrize("wrong", [None, [1, 2, 3]])
def test_windows_of_no_length_are_refused(copied, capsys, wrong):
    """Without a length, and with one that is no number."""
    with diagnosis_of(copied) as content:
        content["window_steps"] = wrong
        if wrong is None:
            del content["window_steps"]
    assert main(["verify", str(copied)]) == 2
    assert "window_steps" in capsys.readouterr().err


def test_folders_without_a_diagnosis_are_refused(tmp_path, capsys):
    """None, an empty one, one of a regression alone: status 2, a sentence."""
    quick = ["--quick", "--hide", "joint_armature:elbow=0.01", "--quiet"]
    assert main(["diagnose", "torque-arm", *quick, "--out", str(tmp_path / "quick")]) == 0
    capsys.readouterr()
    (tmp_path / "empty").mkdir()
    for name in ("none", "empty", "quick"):
        assert main(["verify", str(tmp_path / name)]) == 2
        told = capsys.readouterr().err
        assert "a diagnosis" in told
        assert told.count("\n") == 1


def test_nothing_missing_is_verified_too(tmp_path):
    """A model that explains its data: its fitted parameters are in the extended one."""
    path = write_problem(problem([], episodes=8), tmp_path / "problem")
    out = tmp_path / "out"
    assert main(["diagnose", str(path), *SOME, "--out", str(out), "--quiet"]) == 0
    assert json.loads((out / "diagnosis.json").read_text())["verdict"] == "consistent"
    assert verify(out).holds


def test_broken_numbers_are_refused(copied, capsys):
    """A number of another type, an archive that Python cannot read, a text that is no UTF-8, code
    that does not run: one line each.
    """
    kept = copied / "extended" / "model.npz"
    numbers = dict(np.load(kept))
    np.savez(kept, **{**numbers, "opt.disableflags": np.array(1.5)})
    assert main(["verify", str(copied)]) == 2
    np.savez(kept, **numbers)
    archive = bytearray(kept.read_bytes())
    archive[archive.index(b"PK\x01\x02") + 8] |= 0x20  # a feature of archives that Python lacks
    kept.write_bytes(archive)
    assert main(["verify", str(copied)]) == 2
    np.savez(kept, **numbers)
    code = copied / "extended" / "model.py"
    code.write_bytes(code.read_bytes() + b"# \xff\n")
    assert main(["verify", str(copied)]) == 2
    code.write_text("robot = ")
    assert main(["verify", str(copied), "--trust"]) == 2
    told = capsys.readouterr().err
    assert told.count("\n") == 4
    assert told.count("expected") == 4


def test_a_model_that_diverges_is_off(copied, tmp_path, monkeypatch, capfd):
    """It is no error, and MuJoCo neither prints nor writes its log file."""
    kept = copied / "extended" / "model.npz"
    numbers = dict(np.load(kept))
    np.savez(kept, **numbers, dof_damping=np.array([-1e9, -1e9]))
    monkeypatch.chdir(tmp_path)
    assert main(["verify", str(copied)]) == 1
    assert capfd.readouterr().err == ""
    assert not (tmp_path / "MUJOCO_LOG.TXT").exists()
