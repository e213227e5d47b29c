"""`dropo data describe` and `dropo data check` print what the functions say."""

import json
from pathlib import Path

import numpy as np
import pytest

from dropo.cli.main import main


def test_describe_a_problem(problem: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """With the signals' names and units; the data alone have numbered columns."""
    assert main(["data", "describe", str(problem)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "40 transitions in 2 trajectories of 20"
    assert [line.split()[:2] for line in lines[3:5]] == [["qpos.slide", "m"], ["qvel.slide", "m/s"]]
    assert lines[5].startswith("ctrl.push ")
    assert main(["data", "describe", str(problem.parent / "data.npz"), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["transitions"] == 40
    assert list(found["signals"]) == ["observation[0]", "observation[1]", "action[0]"]


def test_check(problem: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Noise on the next observations is information: status 0."""
    assert main(["data", "check", str(problem)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split(":")[:2] for line in lines] == [["information", " qpos.slide"], ["information", " qvel.slide"]]
    data = dict(np.load(problem.parent / "data.npz"))
    data["next_observations"][:-1] = data["observations"][1:]
    np.savez(problem.parent / "data.npz", **data)
    assert main(["data", "check", str(problem)]) == 0
    assert capsys.readouterr().out == "Nothing looks odd.\n"


def test_an_error_is_status_2(problem: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Here the check prints it; `dropo fit` refuses it."""
    data = dict(np.load(problem.parent / "data.npz"))
    np.savez(problem.parent / "data.npz", **data, time=np.zeros(40))
    assert main(["data", "check", str(problem), "--json"]) == 2
    sentence = "38 rows are not later than the row before them, the first is row 1."
    assert json.loads(capsys.readouterr().out)["findings"][0] == {"level": "error", "signal": "time", "sentence": sentence}
    assert main(["fit", str(problem)]) == 2
    assert capsys.readouterr().err == f"dropo: {problem}: data: time: {sentence}\n"


def test_unknown_targets(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["data", "check", "cube-tos"]) == 2
    assert capsys.readouterr().err == "dropo: No data and no problem called 'cube-tos'. Did you mean 'cube-toss'?\n"
    assert main(["data", "describe", "none.npz"]) == 2
    wanted = "an .npz file, a folder of .npy files or a Minari data set"
    assert capsys.readouterr().err == f"dropo: none.npz: expected {wanted}, got no such file.\n"
