"""`dropo report` from the command line."""

import json

from dropo.cli.main import main


def test_a_fit_then_its_report(problem, tmp_path, capsys, monkeypatch):
    """The page lies in the folder unless said otherwise; its path is printed; --json and --quiet;
    data and model are not needed. The command has no absolute path.
    """
    monkeypatch.chdir(tmp_path)
    out = tmp_path / "run"
    assert main(["fit", str(problem), "--out", str(out), "--quiet"]) == 0
    for name in ("data.npz", "robot.xml", "problem.yaml"):
        (problem.parent / name).unlink()
    assert main(["report", str(out)]) == 0
    printed = capsys.readouterr()
    assert (printed.out, printed.err) == (f"{out / 'report.html'}\n", "")
    text = (out / "report.html").read_text()
    way = problem.relative_to(tmp_path)
    assert f"dropo fit {way} --out run" in text
    for path in out.iterdir():
        assert str(tmp_path).encode() not in path.read_bytes()
    assert "damping" in text
    elsewhere = tmp_path / "new" / "page.html"
    assert main(["report", str(out), "--out", str(elsewhere), "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == {"report": str(elsewhere)}
    assert elsewhere.read_bytes() == (out / "report.html").read_bytes()
    assert main(["report", str(out), "--quiet"]) == 0
    assert capsys.readouterr().out == ""


def test_a_quick_diagnosis_then_its_report(tmp_path, capsys):
    """Causes and forces of a regression, and its command; run.json says that it was quick."""
    out = tmp_path / "quick"
    hidden = ["--hide", "joint_armature:elbow=0.01"]
    assert main(["diagnose", "torque-arm", "--quick", *hidden, "--out", str(out), "--quiet"]) == 0
    assert json.loads((out / "run.json").read_text())["settings"]["quick"] is True
    assert main(["report", str(out)]) == 0
    text = (out / "report.html").read_text()
    for word in ("joint armature at elbow", "regression alone", "shoulder", "dropo diagnose"):
        assert word in text
    assert capsys.readouterr().err == ""


def test_refusals(tmp_path, capsys):
    """Status 2, one line, nothing written."""
    assert main(["report", str(tmp_path)]) == 2
    error = capsys.readouterr().err
    assert error.startswith(
        f"dropo: {tmp_path}: expected a folder that `dropo fit --out` or `dropo diagnose "
        "--out` wrote"
    )
    assert main(["report", str(tmp_path / "none")]) == 2
    assert list(tmp_path.iterdir()) == []
