"""What is drawn on a terminal and what goes into a pipe; the options that every command has."""

import argparse
import hashlib
import io
import json
import os
import re
import signal
import threading
import time
from pathlib import Path

import pytest

from dropo.cli.main import _parser, main
from dropo.cli.support import output
from dropo.cli.support.output import STOPPING as STOPPED
from dropo.cli.support.output import Progress, show, time_left
from dropo.core.services.tables import Report, Table
from dropo.diagnosis.search.selection import STOPPING

EVERY = 10.0
FURTHER = {"--threads", "--seed", "--json", "--quiet"}


class _Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


class _Unread(io.StringIO):
    def write(self, text: str) -> int:
        raise BrokenPipeError


@pytest.fixture(autouse=True)
def _same_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    """Width and colours do not depend on where the tests run."""
    monkeypatch.setenv("COLUMNS", "120")
    monkeypatch.setenv("TERM", "xterm-256color")
    monkeypatch.delenv("NO_COLOR", raising=False)


class _Result(Report):
    def parts(self) -> list[str | Table]:
        return [
            "a [bold]robot[/bold]",
            Table("", ("joint", "damping [N m s/rad]"), (("knee", "0.6"),)),
            "warning: little data",
        ]


def arguments(**given: bool) -> argparse.Namespace:
    return argparse.Namespace(**{"json": False, "quiet": False, **given})


def leaves(parser: argparse.ArgumentParser) -> list[argparse.ArgumentParser]:
    """The parsers of the commands that run."""
    below = [action for action in parser._actions if isinstance(action, argparse._SubParsersAction)]
    return (
        [leaf for action in below for child in action.choices.values() for leaf in leaves(child)]
        if below
        else [parser]
    )


@pytest.mark.parametrize("parser", leaves(_parser()), ids=lambda parser: parser.prog)
def test_every_command_has_the_further_options(parser: argparse.ArgumentParser) -> None:
    assert set(parser._option_string_actions) >= FURTHER


def test_a_pipe_gets_plain_text(capsys: pytest.CaptureFixture[str]) -> None:
    show(arguments(), _Result(), None)
    lines = [
        "a [bold]robot[/bold]",
        "joint  damping [N m s/rad]",
        "-----  -------------------",
        "knee                   0.6",
    ]
    assert capsys.readouterr().out.splitlines() == [*lines, "warning: little data"]


def test_a_terminal_gets_drawn_tables(monkeypatch: pytest.MonkeyPatch) -> None:
    """The same words, with units, and lines around; brackets are no markup."""
    terminal = _Terminal()
    monkeypatch.setattr("sys.stdout", terminal)
    show(arguments(), _Result(), None)
    drawn = terminal.getvalue()
    words = re.sub(r"\x1b\[[0-9;]*m", "", drawn).replace("─", "").split()
    assert words == [word for word in str(_Result()).split() if not word.startswith("---")]
    assert "───" in drawn
    assert "\x1b[" in drawn


def test_json_and_quiet(capsys: pytest.CaptureFixture[str]) -> None:
    show(arguments(quiet=True), _Result(), {"a": 1})
    assert capsys.readouterr().out == ""
    show(arguments(json=True, quiet=True), _Result(), {"a": 1})
    assert json.loads(capsys.readouterr().out) == {"a": 1}


def test_quiet_list(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["list", "methods", "--quiet", "--seed", "3", "--threads", "1"]) == 0
    assert capsys.readouterr() == ("", "")


def test_progress_on_a_terminal() -> None:
    """One line with the share, what was spent and what is left, taken away at the end; nothing
    where it is silent; it never runs backward.
    """
    terminal = _Terminal()
    silent = _Terminal()
    for progress in (Progress(stream=terminal), Progress(stream=silent, silent=True)):
        progress._begun -= 30
        progress(0.5, "60 evaluations, 1,200 simulator steps")
        progress(0.4, "a new round")
        progress.close()
    assert silent.getvalue() == ""
    drawn = re.sub(r"\x1b\[[0-9;?]*[a-zA-Z]", "", terminal.getvalue())
    assert re.search(r"50% 0:00:0\d about 0:00:30 left a new round", drawn)
    assert "40%" not in drawn
    assert terminal.getvalue().rstrip("\r\n").endswith("\x1b[2K")


def test_progress_into_a_pipe(monkeypatch: pytest.MonkeyPatch) -> None:
    """A plain line at most every ten seconds, none before; a pipe that nobody reads is no error."""
    monkeypatch.setattr(output, "EVERY", EVERY)
    pipe = io.StringIO()
    progress = Progress(stream=pipe)
    progress(0.1, "too early")
    for spent in (EVERY, 2 * EVERY):
        progress._begun = time.monotonic() - spent
        progress._last_line = time.monotonic() - EVERY
        progress(spent / 40, "60 evaluations")
        progress(spent / 40, "too early")
    assert pipe.getvalue().splitlines() == [
        "dropo: 25%, 0:00:10, about 0:00:30 left: 60 evaluations",
        "dropo: 50%, 0:00:20, about 0:00:20 left: 60 evaluations",
    ]
    unread = Progress(stream=_Unread())
    unread._last_line -= EVERY
    unread(0.5, "60 evaluations")


def test_the_answer_to_an_interruption_does_not_wait() -> None:
    """A line at once, in a pipe too; other lines wait."""
    stream = io.StringIO()
    progress = Progress(stream=stream)
    progress(0.4, "fitting")
    progress(0.9, f"{STOPPING}, 12 simulator steps")
    (line,) = stream.getvalue().splitlines()
    assert line.endswith("stopping after the figures of what was found so far, 12 simulator steps")


def test_what_a_long_run_costs_stays_on_the_terminal() -> None:
    """A line above the bar, which other texts do not take away; into a pipe at once."""
    text = "an iteration takes 4 minutes; --likelihood linear would take about 20 s"
    terminal, pipe = _Terminal(), io.StringIO()
    for stream in (terminal, pipe):
        progress = Progress(stream=stream)
        for one in ("round 1", text, "round 2"):
            progress(0.1, one)
        progress.close()
    assert f"dropo: {text}\n" in re.sub(r"\x1b\[[0-9;?]*[a-zA-Z]", "", terminal.getvalue())
    assert pipe.getvalue().endswith(f": {text}\n")


def test_ctrl_c_is_answered_while_c_is_at_work() -> None:
    """At once, where Python hears of it only when the call returns; once; silent where asked."""
    lines: list[tuple[float, str]] = []

    class Stream(io.StringIO):
        def write(self, text: str) -> int:
            lines.append((time.monotonic(), text))
            return len(text)

    for silent in (False, True):
        lines.clear()
        progress = Progress(stream=Stream(), silent=silent)
        told = threading.Timer(0.05, os.kill, (os.getpid(), signal.SIGINT))
        heard = 0.0
        with progress.answering():
            told.start()
            try:
                while True:  # long calls that leave the interpreter to other threads
                    hashlib.pbkdf2_hmac("sha256", b"", b"", 1_000_000)
            except KeyboardInterrupt:
                heard = time.monotonic()
        told.join()
        assert "".join(text for _, text in lines) == ("" if silent else f"dropo: {STOPPED}\n")
        assert all(heard - at > 0.02 for at, _ in lines)
    assert signal.set_wakeup_fd(-1) == -1


def test_time_left() -> None:
    """In proportion to what was done; nothing before there is enough to tell."""
    assert time_left(0.25, 1200.0) == "about 1:00:00 left"
    assert time_left(0.01, 1200.0) == ""


def test_a_fit_says_what_it_cost_so_far(problem: Path) -> None:
    """Progress tells the simulator steps, which grow."""
    from dropo import DROPO, load

    told: list[str] = []
    loaded = load(problem)
    fit = DROPO().fit(loaded, rng=0, progress=lambda share, text: told.append(text))
    steps = [
        int(found[1].replace(",", ""))
        for found in (re.search(r"([\d,]+) simulator steps$", text) for text in told)
        if found
    ]
    assert len(steps) == len(told) > 0
    assert steps == sorted(steps)
    assert 0 < steps[0] <= steps[-1] <= fit.simulator_steps


def test_a_notebook_gets_html() -> None:
    html = _Result()._repr_html_()
    assert re.sub(r' style="[^"]*"', "", html).splitlines() == [
        "<p>a [bold]robot[/bold]</p>",
        "<table><thead><tr><th>joint</th><th>damping [N m s/rad]</th></tr></thead>"
        "<tbody><tr><td>knee</td><td>0.6</td></tr></tbody></table>",
        "<p>warning: little data</p>",
    ]
    assert repr(_Result()) == str(_Result())
