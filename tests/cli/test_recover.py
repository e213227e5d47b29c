"""`dropo recover`: what it prints, writes and refuses, and how it goes on after an interruption."""

import json

import pytest

from dropo.cli.main import main
from dropo.core.services import registry as catalogue
from dropo.studies.engine.study import Study, Table

DONE: list[int] = []
STOP_AT: list[int] = []


def toy(work, seeds=None):
    """A study for this test."""
    found = work.map(task, range(seeds or 4))
    return Study(
        "toy",
        "Toy",
        (Table("t", ("a", "b"), (("x", str(sum(row["n"] for row in found))),)),),
        (),
        {"found": found},
    )


def task(item):
    """Counts, and is interrupted where the test says so."""
    if item in STOP_AT:
        raise KeyboardInterrupt
    DONE.append(item)
    return {"n": item}


@pytest.fixture(autouse=True)
def _toy(monkeypatch):
    DONE.clear()
    STOP_AT.clear()
    monkeypatch.setitem(catalogue._registered, "studies", {"toy": toy})


def test_prints(capsys):
    """The tables; as JSON with --json; nothing with --quiet."""
    assert main(["recover", "toy"]) == 0
    assert capsys.readouterr().out == "Toy\n\nt\na  b\n-  -\nx  6\n"
    assert main(["recover", "toy", "--json", "--seeds", "2"]) == 0
    assert json.loads(capsys.readouterr().out)["data"] == {"found": [{"n": 0}, {"n": 1}]}
    assert main(["recover", "toy", "--quiet"]) == 0
    assert capsys.readouterr().out == ""


def test_resumes(tmp_path, capsys):
    """What was finished before an interruption is not done again, and the result is the same."""
    out = ["--out", str(tmp_path), "--threads", "1"]
    STOP_AT.append(3)
    assert main(["recover", "toy", *out]) == 1
    assert capsys.readouterr().err == "dropo: Interrupted: the same command goes on from here.\n"
    assert not (tmp_path / "toy.md").exists()
    assert DONE == [0, 1, 2]
    STOP_AT.clear()
    assert main(["recover", "toy", *out]) == 0
    assert DONE == [0, 1, 2, 3], "each task once"
    assert "x  6" in capsys.readouterr().out
    assert (tmp_path / "toy.md").exists()


def test_some_problems_alone(monkeypatch, capsys):
    """Those named, in their order."""
    several = lambda work, seeds=None, *, problems=("a", "b", "c"): Study(
        "several", " ".join(problems), ()
    )
    monkeypatch.setitem(catalogue._registered["studies"], "several", several)
    assert main(["recover", "several"]) == 0
    assert main(["recover", "several", "--problems", "c", "a"]) == 0
    assert capsys.readouterr().out == "a b c\nc a\n"


def test_parts_are_exchanged(monkeypatch, capsys):
    """Every combination is handed to a study that takes them; names are repeated either way."""
    takes = lambda work, seeds=None, *, variants=(): Study(
        "takes", "; ".join(variant.label for variant in variants), ()
    )
    monkeypatch.setitem(catalogue._registered["studies"], "takes", takes)
    parts = ["--optimizer", "cma-es", "nlopt-sbplx", "--optimizer", "nlopt-bobyqa", "--budget", "9"]
    assert main(["recover", "takes", *parts]) == 0
    assert capsys.readouterr().out == (
        "dropo, optimizer cma-es, budget 9; dropo, optimizer nlopt-sbplx, budget 9;"
        " dropo, optimizer nlopt-bobyqa, budget 9\n"
    )


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["table-61"], "No study called 'table-61'. Did you mean 'table-6.1'?"),
        (["toy", "--seeds", "0"], "expected a whole number of at least 1, got '0'"),
        (
            ["figure-6.4", "--published", "full"],
            "has no runs of the published method at full size. Leave --published full out.",
        ),
        (
            ["toy", "--published"],
            "The study 'toy' has no runs of the published method. Leave --published out.",
        ),
        (
            ["toy", "--problems", "hopper"],
            "The study 'toy' is not one of several problems. Leave --problems out.",
        ),
    ],
)
def test_refuses(words, message, capsys):
    """Status 2 and a sentence."""
    assert main(["recover", *words]) == 2
    assert message in capsys.readouterr().err


def test_studies_are_listed(capsys):
    """Each with its first sentence."""
    assert main(["list", "studies"]) == 0
    assert "figure-6.4" in capsys.readouterr().out
