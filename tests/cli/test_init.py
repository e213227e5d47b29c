"""`dropo init`: what it prints and asks."""

import json
from pathlib import Path

import pytest

from dropo.cli import init
from dropo.cli.main import main
from dropo.problems.simulated.example_log import ExampleMachine, write_example


@pytest.fixture
def example(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The example's files in the present folder."""
    write_example(tmp_path, runs=1, machine=ExampleMachine(rows=240))
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_guesses_and_the_next_command_are_printed(
    example: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """In lines; as JSON; and the command that is printed is one."""
    assert main(["init", "arm.xml", "log1.csv", "--out", "first"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "robot: arm, MJCF, 2 joints, 2 actuators"
    assert lines[1] == "time: 'ms' in ms, since its name says so"
    assert lines[-1] == "Next: dropo diagnose first/problem.yaml"
    assert main(["data", "check", "first/problem.yaml"]) == 0
    capsys.readouterr()
    assert main(["init", "arm.xml", "log1.csv", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["folder"] == "arm"
    assert found["mapping"]["ctrl"]["elbow_servo"] == {"column": "elbow target", "unit": "deg"}


def test_what_is_not_decided_is_refused_without_a_terminal(
    example: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """In a sentence that says what to write; nothing is written."""
    text = (example / "log1.csv").read_text()
    table = [line.split(",", 1)[1] for line in text.splitlines()]
    (example / "log1.csv").write_text("\n".join(table) + "\n")
    assert main(["init", "arm.xml", "log1.csv"]) == 2
    said = capsys.readouterr().err
    assert said.startswith("dropo: log1.csv has no column of time stamps: how many rows a second")
    assert "give it with --map" in said
    assert not (example / "arm").exists()
    (example / "mine.yaml").write_text("rate: 100\n")
    assert main(["init", "arm.xml", "log1.csv", "--map", "mine.yaml"]) == 0


def test_questions_go_on_until_an_answer_is_an_option(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    answers = iter(["grad", "3", "2"])
    monkeypatch.setattr("builtins.input", lambda: next(answers))
    assert init.ask("In which unit?", ["rad", "deg"]) == "deg"
    assert capsys.readouterr().err.count("In which unit? [1 rad, 2 deg]") == 3
