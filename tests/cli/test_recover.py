"""`dropo recover`: what it prints, writes and refuses, and how it goes on after an interruption."""

import json
import os
import signal
import subprocess
import sys
import time

import pytest

from dropo.cli.main import main
from dropo.core.services import registry as catalogue
from dropo.core.services.files.journal import read_lines
from dropo.studies.engine.study import Study, Table

DONE: list[int] = []
STOP_AT: list[int] = []


def toy(work, seeds=None, *, full=False):
    """A study for this test; its full size has tasks of its own, which come first."""
    found = work.map(task, range(10, 13)) if full else []
    found += work.map(task, range(seeds or 4))
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
    assert capsys.readouterr().err == (
        "dropo: Interrupted, stopping: 3 finished tasks kept, the same command goes on from here.\n"
    )
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


@pytest.mark.filterwarnings("always:.*is kept as")
def test_another_size_takes_nothing_from_an_interrupted_run(tmp_path, capsys):
    """A plain run uses what it shares with the journal of a full one and leaves the rest; both
    results stay in the folder, the first under another name, of which a line warns.
    """
    out = ["--out", str(tmp_path), "--threads", "1"]
    journal = tmp_path / ".toy.jsonl"
    STOP_AT.append(3)
    assert main(["recover", "toy", "--published", "full", *out]) == 1
    before = journal.read_bytes()
    STOP_AT.clear()
    assert main(["recover", "toy", *out]) == 0
    assert DONE == [10, 11, 12, 0, 1, 2, 3]
    assert journal.read_bytes().startswith(before)
    plain = {path.suffix: path.read_text() for path in tmp_path.glob("toy.*")}
    capsys.readouterr()
    assert main(["recover", "toy", "--published", "full", *out]) == 0
    assert DONE == [10, 11, 12, 0, 1, 2, 3], "each task once"
    assert not journal.exists()
    full = json.loads((tmp_path / "toy.json").read_text())
    assert full["settings"]["published"] == "full"
    (kept,) = tmp_path.glob("toy.*.json")
    warning = f'is kept as {kept.name}: published false there and "full" here.\n'
    assert capsys.readouterr().err.endswith(warning)
    assert {path.suffix: path.read_text() for path in tmp_path.glob(f"{kept.stem}.*")} == plain


def test_the_same_command_again_replaces_its_own_pages(tmp_path):
    """Without a copy."""
    for _ in range(2):
        assert main(["recover", "toy", "--out", str(tmp_path)]) == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["toy.json", "toy.md"]


def test_a_journal_of_another_version_is_refused(tmp_path, monkeypatch, capsys):
    """In one line that says which; it is left as it is."""
    STOP_AT.append(3)
    out = ["--out", str(tmp_path), "--threads", "1"]
    assert main(["recover", "toy", *out]) == 1
    before = (tmp_path / ".toy.jsonl").read_bytes()
    monkeypatch.setattr("dropo.studies.engine.work.__version__", "0.0.7")
    monkeypatch.setattr("dropo.core.services.files.saved_files.__version__", "9.0")
    capsys.readouterr()
    assert main(["recover", "toy", *out]) == 2
    assert 'and "0.0.7" here (use another --out' in capsys.readouterr().err
    assert (tmp_path / ".toy.jsonl").read_bytes() == before


SLEEPING = '''
import time
from pathlib import Path
from dropo import register
from dropo.studies.engine.study import Study


def nap(item):
    """A task that ends at once, or that nobody waits for."""
    if item > 1:
        Path(f"begun_{item}").touch()
        time.sleep(60)
    return {"n": item}


def sleeping(work, seeds=None):
    """Two tasks that end and some that sleep."""
    return Study("sleeping", str(work.map(nap, range(6))), ())


register("studies", "sleeping", sleeping)
'''


@pytest.mark.parametrize(
    ("kind", "where"),
    [
        (signal.SIGTERM, ("--threads", "2")),
        (signal.SIGINT, ("--threads", "2")),
        (signal.SIGTERM, ("--executor", "threads:2")),
        (signal.SIGTERM, ("--executor", "processes:2")),
    ],
)
def test_an_interrupted_process_ends_while_its_tasks_run(kind, where, tmp_path):
    """In seconds, with status 1 and one line; what was finished is kept."""
    (tmp_path / "naps.py").write_text(SLEEPING)
    command = [sys.executable, "-m", "dropo", "recover", "sleeping", "--plugin", "naps.py"]
    run = subprocess.Popen(
        [*command, *where, "--out", "out"],
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
    )
    journal = tmp_path / "out" / ".sleeping.jsonl"
    until = time.monotonic() + 60
    while not (
        (tmp_path / "begun_2").exists()
        and journal.exists()
        and journal.read_bytes().count(b"\n") == 3
    ):
        assert run.poll() is None, run.communicate()
        assert time.monotonic() < until
        time.sleep(0.05)
    told = time.monotonic()
    run.send_signal(kind)
    _, errors = run.communicate(timeout=30)
    assert time.monotonic() - told < 10
    assert run.returncode == 1
    assert errors.splitlines()[-1] == (
        "dropo: Interrupted, stopping: 2 finished tasks kept, the same command goes on from here."
    )
    assert len(read_lines(journal, "answers")) == 1 + 2
