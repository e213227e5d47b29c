"""The command itself: quick help, one line for an error, exit statuses."""

import os
import signal
import subprocess
import sys
import time

import pytest

import dropo
from dropo.cli.main import main
from dropo.core.services.errors import SimulationFailed

HEAVY = (
    "numpy",
    "mujoco",
    "scipy",
    "torch",
    "cma",
    "emcee",
    "nlopt",
    "gymnasium",
    "pydantic",
    "ruamel",
    "rich",
)


def test_help_imports_nothing_heavy() -> None:
    code = (
        "import sys; from dropo.cli.main import main; main(['--help']); print([m for m in "
        f"{HEAVY} if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "[]"


def test_help_is_quick() -> None:
    """Under a second, the best of three."""
    times = []
    for _ in range(3):
        begun = time.perf_counter()
        subprocess.run([sys.executable, "-m", "dropo", "--help"], capture_output=True, check=True)
        times.append(time.perf_counter() - begun)
    assert min(times) < 1.0


@pytest.mark.parametrize(
    "command",
    [[], ["fit"], ["data"], ["data", "check"], ["data", "describe"], ["list"], ["schema"]],
)
def test_every_command_has_help(command: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*command, "--help"]) == 0
    assert capsys.readouterr().out.startswith(f"usage: {' '.join(['dropo', *command])} ")


def test_help_is_for_users(capsys: pytest.CaptureFixture[str]) -> None:
    """It describes what the package does, not how its files are made."""
    assert main(["--help"]) == 0
    printed = capsys.readouterr().out
    assert "Makes robot simulators honest" in printed
    assert ".pyi" not in printed


def test_version(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"dropo {dropo.__version__}\n"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "The following arguments are required: COMMAND. See `dropo --help`."),
        (["fit"], "The following arguments are required: PROBLEM. See `dropo fit --help`."),
        (
            ["fit", "hopper", "--optimzer", "x"],
            "Unrecognized arguments: --optimzer x. Did you mean '--optimizer'? See `dropo fit"
            " --help`.",
        ),
        (
            ["data", "check", "p", "--mpa=x"],
            "Unrecognized arguments: --mpa=x. Did you mean '--map'? See `dropo data check --help`.",
        ),
        (["fit", "p", "q"], "Unrecognized arguments: q. See `dropo fit --help`."),
        (["fit", "hoper"], "No problem called 'hoper'. Did you mean 'hopper'?"),
        (["list", "method"], "No kind called 'method'. Did you mean 'methods'?"),
        (["data", "check", "nothing"], None),
    ],
)
def test_refusals_are_one_line(
    arguments: list[str], message: str | None, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(arguments) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("dropo: ")
    assert err.count("\n") == 1
    assert message is None or err == f"dropo: {message}\n"


def test_a_failure_is_status_1(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail(arguments: object) -> int:
        raise SimulationFailed("It diverged\nat once.")

    monkeypatch.setattr("dropo.cli.fit.run", fail)
    assert main(["fit", "p"]) == 1
    assert capsys.readouterr().err == "dropo: It diverged at once.\n"


PRINTED = "import sys; from dropo.cli.main import main; sys.exit(main(sys.argv[1:]))"


def run(arguments: str, redirected: str, **environment: str) -> "subprocess.CompletedProcess[str]":
    """A command of a shell, whose output goes elsewhere."""
    command = f"'{sys.executable}' -c '{PRINTED}' {arguments} {redirected}"
    return subprocess.run(
        ["bash", "-c", f"set -o pipefail; {command}"],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, **environment},
    )


@pytest.mark.parametrize(
    ("redirected", "status", "told"),
    [
        ("| head -c 1", 0, ""),
        ("> /dev/full", 1, "dropo: standard output: No space left on device.\n"),
        (">&-", 0, ""),
        (">&- 2>&- <&-", 0, ""),
        ("2> /dev/full", 0, ""),
    ],
)
def test_output_that_cannot_be_written(redirected: str, status: int, told: str) -> None:
    """Never a traceback: who has read enough is no error, a full device is one line."""
    done = run("list families", redirected)
    assert (done.returncode, done.stderr) == (status, told)


def test_help_that_cannot_be_written() -> None:
    """One line, as of everything else; what is read in part is no error."""
    done = run("--help", "> /dev/full")
    told = "dropo: standard output: No space left on device.\n"
    assert (done.returncode, done.stderr) == (1, told)
    assert (run("--help", "| head -c 1").returncode, run("--help", ">&-").returncode) == (0, 0)


def test_an_empty_path_is_refused() -> None:
    """A variable that is not set is not the present folder."""
    done = run("fit slide --out ''", "")
    assert (done.returncode, done.stdout) == (2, "")
    assert "--out: expected a path, got nothing" in done.stderr


def test_any_character_in_the_locale_c() -> None:
    """Characters that the locale lacks are written as their codes."""
    ascii_only = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    done = run("fit λ", "", **ascii_only)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.count("\n") == 1


def test_errors_of_the_system_are_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """With the file where it is known; so is a lack of memory."""
    for error, told in (
        (OSError(5, "Input/output error", "data.npz"), "data.npz: Input/output error."),
        (OSError(5, "Input/output error"), "Input/output error."),
        (OSError("odd"), "odd."),
        (MemoryError(), "Out of memory."),
        (MemoryError("Unable to allocate\n8 TiB"), "Out of memory. Unable to allocate 8 TiB"),
    ):

        def fail(arguments: object, error: BaseException = error) -> int:
            raise error

        monkeypatch.setattr("dropo.cli.fit.run", fail)
        assert main(["fit", "p"]) == 1
        assert capsys.readouterr() == ("", f"dropo: {told}\n")


@pytest.mark.parametrize("kind", [signal.SIGTERM, signal.SIGINT])
@pytest.mark.parametrize("command", ["fit p", "diagnose p", "train p", "recover p"])
def test_signals_end_every_command(
    command: str,
    kind: signal.Signals,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """In one line where there is no result yet; the handler of the process is put back."""
    before = signal.getsignal(signal.SIGTERM)
    name = command.split()[0]
    monkeypatch.setattr(f"dropo.cli.{name}.run", lambda arguments: os.kill(os.getpid(), kind))
    assert main(command.split()) == 1
    assert capsys.readouterr() == ("", "dropo: Interrupted before there was a result.\n")
    assert signal.getsignal(signal.SIGTERM) is before
