"""`dropo diagnose` from the command line."""

import json
import os
import signal

import numpy as np
import pytest

from dropo.cli.main import main
from dropo.cli.support.output import Progress
from dropo.problems.file.writer import write_problem
from dropo.problems.loading import load
from dropo.problems.measured.external_data import find_data
from tests.models.hidden_in_arm import problem
from tests.models.wiring import log_of, read_otherwise, scaled

MEASURED = find_data("swinging-pendulum/runs.npz") is not None
SOME = ["--effects", "joint_damping", "joint_friction", "actuator_gain"]


@pytest.fixture(scope="module")
def damped(tmp_path_factory):
    """A problem file whose data have more damping than its model."""
    return write_problem(
        problem([("joint_damping:elbow", [0.05])], episodes=6), tmp_path_factory.mktemp("damped")
    )


def test_it_prints_and_writes(damped, tmp_path, capsys):
    """The headline on standard output, nothing on standard error in a pipe; diagnosis.json; an
    extended problem that is consistent, and the same with the cause's size to be fitted.
    """
    out = tmp_path / "out"
    assert main(["diagnose", str(damped), *SOME, "--steps", "5", "--out", str(out)]) == 0
    printed = capsys.readouterr()
    assert "Cause: joint damping at elbow" in printed.out
    assert printed.err == ""
    kept = json.loads((out / "diagnosis.json").read_text())
    assert (kept["verdict"], kept["causes"][0]["target"]) == ("explained", "elbow")
    extended = out / kept["extended_problem"]
    damping = load(extended).simulator.model.dof_damping[1]
    assert damping == pytest.approx(0.1, rel=0.02)
    to_fit = load(extended.with_name("fit.yaml")).simulator
    assert to_fit.space.names[-1] == "joint_damping:elbow/damping"
    added = damping - to_fit.model.dof_damping[1]
    assert 0 < to_fit.space.low[-1] < added < to_fit.space.high[-1]
    assert main(["diagnose", str(extended), *SOME, "--steps", "5", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["verdict"] == "consistent"


def test_a_signal_leaves_the_best_so_far(damped, tmp_path, capsys, monkeypatch):
    """Status 1 and "interrupted"; the same command goes on to what an undisturbed run finds and
    leaves no records; another command is refused the folder.
    """
    out = tmp_path / "out"
    undisturbed = tmp_path / "undisturbed"
    effects = ["--effects", "joint_damping:elbow", "actuator_gain:elbow_motor"]
    options = ["--disturbances", "off", "--quiet", "--steps", "5"]
    command = ["diagnose", str(damped), *effects, *options]
    assert main([*command, "--out", str(undisturbed)]) == 0
    told = []

    def ended(progress, fraction, text):
        if "screening" in text:
            told.append(text)
        if "screening" in text and len(told) == 2:
            os.kill(os.getpid(), signal.SIGTERM)

    with monkeypatch.context() as patch:
        patch.setattr(Progress, "__call__", ended)
        assert main([*command, "--out", str(out)]) == 1
    assert capsys.readouterr() == ("", "")
    assert result(out)["status"] == "interrupted"
    assert len(result(out)["causes"]) == 1
    assert (out / "search.jsonl").is_file()
    assert main([*command, "--seed", "1", "--out", str(out)]) == 2
    assert "seed" in capsys.readouterr().err
    assert main([*command, "--out", str(out)]) == 0
    assert result(out) == result(undisturbed)
    assert sorted(path.name for path in out.iterdir()) == sorted(
        path.name for path in undisturbed.iterdir()
    )


def result(folder):
    """What diagnosis.json holds but how long it took."""
    return {**json.loads((folder / "diagnosis.json").read_text()), "wall_time_s": None}


def test_quick(tmp_path, capsys):
    """By regression: the number in the table and in diagnosis.json, and an extended problem."""
    out = tmp_path / "quick"
    hidden = ["--hide", "joint_armature:elbow=0.01"]
    assert main(["diagnose", "torque-arm", "--quick", *hidden, "--out", str(out)]) == 0
    printed = capsys.readouterr().out
    assert "joint armature at elbow" in printed
    assert "RMS forces on held-out data" in printed
    kept = json.loads((out / "diagnosis.json").read_text())
    assert kept["method"] == "regression"
    assert kept["simulator_steps"] == 0
    (cause,) = [cause for cause in kept["causes"] if cause["effect"] == "joint_armature"]
    size = cause["estimate"]["armature"]["value"]
    extended = load(out / kept["extended_problem"]).simulator
    assert extended.model.dof_armature[1] == pytest.approx(0.005 + size, rel=1e-4)


def test_refusals_end_with_2(damped, tmp_path, capsys):
    """Unknown names, a file where a folder should be, nothing to hide in: status 2, a sentence,
    nothing written.
    """
    taken = tmp_path / "file"
    taken.write_text("")
    for arguments, told in (
        ([str(damped), "--effects", "joint_dampin"], "Did you mean 'joint_damping'?"),
        ([str(damped), "--effects", "joint_damping:elbo"], "Did you mean 'elbow'?"),
        (["hoper"], "hopper"),
        (["hopper", "--quick"], "that of 'rootx' is not observed"),
        (["torque-arm", "--quick", "--steps", "5"], "--steps belongs to the search"),
        (["swinging-pendulum", "--quick"], "needs a drive") if MEASURED else (["hoper"], "hopper"),
        ([str(damped), "--out", str(taken)], "a folder"),
        (["slide", "--hide", "joint_damping:elbow=1"], "half-cheetah"),
        (["hopper", "--hide", "joint_damping:leg=1"], "Did you mean 'leg_joint'?"),
        (["hopper", "--hide", "joint_dampin:leg_joint=1"], "Did you mean 'joint_damping'?"),
        (
            ["hopper", "--hide", "joint_damping:leg_joint=much"],
            "must give a number for damping [N m s/rad]",
        ),
        (["hopper", "--hide", "joint_damping:leg_joint=1,2"], "must give a number"),
        (["hopper", "--hide", "joint_damping:leg_joint=nan"], "must be finite and at least -1"),
        (["hopper", "--hide", "joint_damping:leg_joint=-5"], "must be finite and at least -1"),
        (["hopper", "--hide", "joint_damping:leg_joint=inf"], "must be finite and at least -1"),
        (["slide"], "needs a MuJoCo model"),
    ):
        assert main(["diagnose", *arguments]) == 2, arguments
        assert told in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == [taken]


def test_columns_that_mean_something_else(tmp_path, capsys):
    """A turned angle: status 0, the cause in print and in JSON, a problem with the column turned
    back, and a page.
    """
    log = log_of("arm, 3 joints", np.random.default_rng(7))
    path = write_problem(read_otherwise(log, angles=scaled(1, -1)), tmp_path / "log")
    out = tmp_path / "out"
    assert main(["diagnose", str(path), "--out", str(out)]) == 0
    printed = capsys.readouterr().out
    assert "'joint1' has the wrong sign" in printed
    assert "error removed" in printed
    kept = json.loads((out / "diagnosis.json").read_text())
    assert [(one["effect"], one["target"]) for one in kept["causes"]] == [("sign", "joint1")]
    mended = load(out / kept["extended_problem"]).trajectories.observations[:, :3]
    np.testing.assert_allclose(mended, log.trajectories.observations, atol=1e-9)
    assert main(["report", str(out)]) == 0
    assert "sign: -1" in (out / "report.html").read_text()


def test_columns_are_taken_as_they_are(damped, tmp_path, monkeypatch):
    """With `--wiring off` nobody asks what they mean, and run.json says so."""

    def asked(*given):
        raise AssertionError("columns were looked at")

    monkeypatch.setattr("dropo.diagnosis.diagnose.wiring_of", asked)
    out = tmp_path / "out"
    few = ["--effects", "joint_damping:elbow", "--steps", "5", "--disturbances", "off", "--quiet"]
    assert main(["diagnose", str(damped), *few, "--wiring", "off", "--out", str(out)]) == 0
    assert result(out)["causes"][0]["target"] == "elbow"
    assert json.loads((out / "run.json").read_text())["settings"]["wiring"] == "off"
