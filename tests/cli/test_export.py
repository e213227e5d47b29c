"""`dropo export` from the command line."""

import json

import pytest

from dropo.cli.main import main


@pytest.fixture
def fitted(problem, tmp_path):
    """The folder of a fit of the cart."""
    out = tmp_path / "run"
    assert main(["fit", str(problem), "--out", str(out), "--quiet"]) == 0
    return out


def test_a_fit_for_every_target(fitted, capsys):
    """Paths and sentences are printed; --json and --quiet; the folder is in DIR by default."""
    assert main(["list", "exports", "--json"]) == 0
    targets = list(json.loads(capsys.readouterr().out))
    assert len(targets) >= 6
    for target in set(targets) - {"effect"}:  # which takes a law
        assert main(["export", str(fitted), "--to", target]) == 0
        lines = capsys.readouterr().out.splitlines()
        assert (fitted / target / "export.json").is_file()
        assert lines[0].startswith(str(fitted / target))
        assert main(["export", str(fitted), "--to", target, "--json"]) == 0
        content = json.loads(capsys.readouterr().out)
        assert [*content["files"], *content["left_out"], *content["approximated"]] == lines
    assert main(["export", str(fitted), "--to", "mjx", "--quiet"]) == 0
    assert capsys.readouterr().out == ""


def test_an_extended_model(tmp_path, capsys):
    """A diagnosis has no distribution, which is said; its causes are in the model."""
    out = tmp_path / "quick"
    hidden = ["--hide", "joint_armature:elbow=0.01"]
    assert main(["diagnose", "torque-arm", "--quick", *hidden, "--out", str(out), "--quiet"]) == 0
    for target in ("mujoco", "mjx", "mjlab", "isaac-lab", "bam"):
        assert main(["export", str(out), "--to", target]) == 0
        assert ("a diagnosis has no distribution" in capsys.readouterr().out) == (target != "bam")
    text = (out / "isaac-lab" / "isaac_lab.yaml").read_text()
    assert "events: {}" in text
    elbow = json.loads((out / "bam" / "elbow.json").read_text())
    assert elbow["armature"] == pytest.approx(0.005 + 0.01, rel=0.05)
    assert not (out / "mujoco" / "randomize.py").exists()


def test_refusals(fitted, problem, tmp_path, capsys):
    """Status 2, one line, nothing written: target, folder, another model, files in the way."""
    assert main(["export", str(fitted), "--to", "mjlabs"]) == 2
    assert "Did you mean 'mjlab'" in capsys.readouterr().err
    assert main(["export", str(tmp_path / "none"), "--to", "mjx"]) == 2
    (fitted / "mjx").mkdir()
    (fitted / "mjx" / "model.xml").write_text("mine")
    assert main(["export", str(fitted), "--to", "mjx"]) == 2
    assert "one of an earlier export to mjx" in capsys.readouterr().err
    assert (fitted / "mjx" / "model.xml").read_text() == "mine"
    (fitted / "made.json").unlink()
    assert main(["export", str(fitted), "--to", "bam"]) == 2
    assert "--problem on the command line" in capsys.readouterr().err
    assert main(["export", str(fitted), "--to", "bam", "--problem", str(problem)]) == 0
    capsys.readouterr()
    xml = problem.parent / "robot.xml"
    xml.write_text(xml.read_text().replace('mass="2"', 'mass="3"'))
    arguments = ["export", str(fitted), "--to", "mjlab", "--problem", str(problem)]
    assert main(arguments) == 2
    assert "is of another model than that of 'problem' now" in capsys.readouterr().err
    assert not (fitted / "mjlab").exists()
