"""`dropo fit`: one answer however often it is killed and however many threads it has; nothing
written on refusal.
"""

import json
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dropo.cli.main import main
from dropo.cli.support.output import STOPPING
from dropo.core.contracts.problem import Problem
from dropo.core.records.fits.fit import Fit
from dropo.core.services.files.evaluation_log import read_log
from dropo.core.services.tables import estimate
from dropo.problems.loading import load
from dropo.studies.unlogged_states.machines import ARM, simulate_log

SAMPLED = ("--likelihood", "monte-carlo", "--optimizer", "cma-es")
SMALL = (*SAMPLED, "--draws", "10", "--budget", "60")
LONG = (*SAMPLED, "--draws", "10", "--budget", "160")


def result(folder: Path) -> dict[str, Any]:
    """fit.json without the time."""
    content: dict[str, Any] = json.loads((folder / "fit.json").read_text())
    assert content.pop("wall_time_s") >= 0
    return content


def start(problem: Path, *arguments: str) -> "subprocess.Popen[str]":
    command = [sys.executable, "-m", "dropo", "fit", str(problem), *arguments]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> Callable[[Path], Path]:
    """A function: the folder of a long run of a problem on one thread that nothing interrupts; all
    problems here are the same, so it runs once.
    """
    folder = tmp_path_factory.mktemp("undisturbed") / "whole"

    def run(problem: Path) -> Path:
        if not folder.exists():
            arguments = [*LONG, "--out", str(folder), "--threads", "1", "--quiet"]
            assert main(["fit", str(problem), *arguments]) == 0
        return folder

    return run


def wait_for_lines(evaluation_log: Path, lines: int, run: "subprocess.Popen[str]") -> None:
    until = time.monotonic() + 60
    while not evaluation_log.exists() or evaluation_log.read_bytes().count(b"\n") < lines:
        assert run.poll() is None, run.communicate()
        assert time.monotonic() < until
        time.sleep(0.001)


def test_it_prints_and_saves_the_same(problem: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The table holds what fit.json holds; run.json says what was asked for; the Python API gives
    the same numbers.
    """
    out = problem.parent / "out"
    assert main(["fit", str(problem), *SMALL, "--out", str(out)]) == 0
    text, errors = capsys.readouterr()
    found = result(out)
    assert errors == ""
    assert "mass" in text
    assert (
        estimate(found["parameters"]["mass"]["mean"], found["parameters"]["mass"]["mean_se"])
        in text
    )
    assert abs(found["parameters"]["mass"]["mean"] - 2) < 0.2
    assert sorted(path.name for path in out.iterdir()) == [
        "evaluations.jsonl",
        "fit.json",
        "fit.npz",
        "made.json",
        "predictions.npz",
        "run.json",
    ]
    record = json.loads((out / "run.json").read_text())
    assert (record["problem"], record["seed"], record["settings"]["draws"], record["lambda"]) == (
        "problem",
        0,
        10,
        1,
    )
    assert "threads" not in json.dumps(record)
    from dropo.estimators.dropo import DROPO

    api = DROPO(likelihood="monte-carlo", optimizer="cma-es", draws=10, budget=60).fit(
        load(problem), rng=0
    )
    assert {**api.to_json(), "wall_time_s": 0} == {**found, "wall_time_s": 0}
    np.testing.assert_array_equal(Fit.load(out).mean, api.mean)


def test_json_and_quiet(problem: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["fit", str(problem), *SMALL, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["method"] == "dropo"
    assert main(["fit", str(problem), *SMALL, "--quiet"]) == 0
    assert capsys.readouterr() == ("", "")


def test_options_reach_the_problem(problem: Path, tmp_path: Path) -> None:
    """--lambda, --transitions, --seed and --epsilon."""
    options = ("--lambda", "3", "--transitions", "30", "--seed", "4", "--epsilon", "1e-6")
    assert (
        main(["fit", str(problem), *SMALL, *options, "--out", str(tmp_path / "out"), "--quiet"])
        == 0
    )
    found = result(tmp_path / "out")
    record = json.loads((tmp_path / "out" / "run.json").read_text())
    assert (found["seed"], found["transitions"], found["epsilon"]) == (
        4,
        27,
        [1e-6, 1e-6],
    )  # 6 + 3 segments of 3
    assert (record["lambda"], record["transitions"], record["settings"]["epsilon"]) == (3, 30, 1e-6)


def test_lambda_auto(problem: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """It says what it chose, keeps the table, and is told apart from a run with that lambda."""
    out = problem.parent / "out"
    arguments = ["fit", str(problem), "--epsilon", "1e-8", "--out", str(out), "--lambda"]
    assert main([*arguments, "auto"]) == 0
    found = result(out)
    chosen = next(row["lambda"] for row in found["lambda_choice"] if row["chosen"])
    assert f"lambda = {chosen} predicts held-out data best, of " in capsys.readouterr().out
    assert main([*arguments, "auto", "--quiet"]) == 0
    assert result(out) == found
    assert main([*arguments, str(chosen)]) == 2
    assert "run.json: lambda: expected the settings of this run" in capsys.readouterr().err


def test_the_kind_of_noise_reaches_the_fit(problem: Path) -> None:
    """--start-noise, --student-t, --start and --starts are recorded, and change the likelihood."""
    options = ("--epsilon", "1e-6", "--start", "random", "--quiet", "--out")
    assert main(["fit", str(problem), *options, str(problem.parent / "plain")]) == 0
    noisy = ("--start-noise", "--student-t", "8", "--starts", "measured")
    assert main(["fit", str(problem), *noisy, *options, str(problem.parent / "noisy")]) == 0
    settings = json.loads((problem.parent / "noisy" / "run.json").read_text())["settings"]
    assert (
        settings["start_noise"],
        settings["degrees"],
        settings["starts"],
        settings["start"],
    ) == (True, 8.0, "measured", "random")
    assert (
        result(problem.parent / "noisy")["log_likelihood"]
        != result(problem.parent / "plain")["log_likelihood"]
    )


@pytest.mark.parametrize("method", ["least-squares", "droid", "uniform-randomization"])
def test_other_methods(problem: Path, method: str, capsys: pytest.CaptureFixture[str]) -> None:
    """A method that evaluates nothing is saved, and asked for again, like the others."""
    out = problem.parent / "out"
    arguments = ["fit", str(problem), "--method", method, "--out", str(out), "--json"]
    assert main(arguments) == 0
    before = result(out)
    assert main(arguments) == 0
    assert result(out) == before
    assert before["method"] == method


def test_the_problem_suggests_settings(problem: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where the user says nothing, and only those that the method has."""
    from dataclasses import replace

    from dropo.core.services import registry as catalogue

    def suggesting(threads: int = 0) -> Problem:
        return replace(
            load(problem, threads=threads),
            name="suggesting",
            settings={"draws": 7, "budget": 40, "colour": "red"},
        )

    monkeypatch.setitem(catalogue._registered["problems"], "suggesting", suggesting)
    out = problem.parent / "out"
    assert (
        main(["fit", "suggesting", *SAMPLED, "--budget", "50", "--out", str(out), "--quiet"]) == 0
    )
    settings = json.loads((out / "run.json").read_text())["settings"]
    assert (settings["draws"], settings["budget"]) == (7, 50)


REFUSALS = {
    "unknown method": (
        ["--method", "drop"],
        "No method called 'drop'. Did you mean 'dropo'?",
    ),
    "unknown optimizer": (
        ["--optimizer", "cma"],
        "No optimizer called 'cma'. Did you mean 'cma-es'?",
    ),
    "unknown family": (
        ["--family", "uniforn"],
        "No family called 'uniforn'. Did you mean 'uniform'?",
    ),
    "unknown likelihood": (
        ["--likelihood", "monte"],
        "No likelihood called 'monte'. Did you mean 'monte-carlo'?",
    ),
    "a setting of another method": (
        ["--method", "least-squares", "--family", "full"],
        "method 'least-squares' takes no family. It takes weights, budget, step, start.",
    ),
    "too few degrees": (
        ["--student-t", "2"],
        (
            "Argument --student-t: expected degrees of freedom, a number above 2, got '2'. See "
            "`dropo fit --help`."
        ),
    ),
    "noise that a likelihood does not know": (
        ["--likelihood", "random-effects", "--student-t", "8"],
        (
            "RandomEffects knows no Student t: its integral is Gaussian. Leave degrees out, or "
            "use 'emulated'."
        ),
    ),
    "lambda below 1": (
        ["--lambda", "0"],
        (
            "Argument --lambda: expected a whole number of at least 1, got '0'. See `dropo fit "
            "--help`."
        ),
    ),
    "lambda too long": (
        ["--lambda", "21"],
        (
            "lambda = 21 is longer than trajectory 0, which has 20 transitions. Choose a "
            "smaller lambda, or leave that trajectory out."
        ),
    ),
    "one draw": (
        ["--draws", "1"],
        "Argument --draws: expected a whole number of at least 2, got '1'. See `dropo fit --help`.",
    ),
    "no budget": (
        ["--budget", "0"],
        (
            "Argument --budget: expected a whole number of at least 1, got '0'. See `dropo fit "
            "--help`."
        ),
    ),
    "negative epsilon": (
        ["--epsilon=-1"],
        (
            "Argument --epsilon: expected a variance of 0 or more, 'tune' or 'learn', got "
            "'-1'. See `dropo fit --help`."
        ),
    ),
    "NaN epsilon": (
        ["--epsilon", "nan"],
        (
            "Argument --epsilon: expected a variance of 0 or more, 'tune' or 'learn', got "
            "'nan'. See `dropo fit --help`."
        ),
    ),
    "singular covariance": (
        ["--epsilon", "0", "--draws", "2", "--start", "middle", *SAMPLED],
        "The covariance of the K = 2 predictions at row 0 is singular in p = 2 signals, "
        "and an epsilon is 0."
        " Give epsilon > 0 (the variance of the measurement noise), or more draws.",
    ),
    "draws of a likelihood without": (
        ["--likelihood", "emulated", "--draws", "9"],
        "The likelihood 'emulated' draws nothing. Leave draws out, or use 'monte-carlo'.",
    ),
    "half a seed": (
        ["--seed", "0.5"],
        (
            "Argument --seed: expected a whole number of at least 0, got '0.5'. See `dropo fit "
            "--help`."
        ),
    ),
}


@pytest.mark.parametrize(("arguments", "message"), REFUSALS.values(), ids=REFUSALS)
def test_refusals_write_nothing(
    problem: Path, arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    before = sorted(problem.parent.rglob("*"))
    assert main(["fit", str(problem), *arguments, "--out", str(problem.parent / "out")]) == 2
    assert capsys.readouterr() == ("", f"dropo: {message}\n")
    assert sorted(problem.parent.rglob("*")) == before


def test_a_refusal_later_in_the_run_writes_nothing(
    problem: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also where some evaluations were recorded already."""
    from dropo.core.services.errors import BadArgument
    from dropo.core.services.files.journal import Journal

    append = Journal.append
    out = problem.parent / "out"

    def third(self: Journal, entry: dict[str, Any]) -> None:
        append(self, entry)
        assert out.exists()
        if self.path.read_bytes().count(b"\n") > 3:
            raise BadArgument("No more.")

    monkeypatch.setattr(Journal, "append", third)
    assert main(["fit", str(problem), *SMALL, "--out", str(out)]) == 2
    assert not out.exists()


def test_a_problem_without_parameters(problem: Path, capsys: pytest.CaptureFixture[str]) -> None:
    problem.write_text("model: robot.xml\ndata: data.npz\n")
    assert main(["fit", str(problem)]) == 2
    assert (
        capsys.readouterr().err
        == f"dropo: {problem}: parameters: expected at least one parameter to fit, got none "
        "(`dropo init` and `dropo data import` list some as comments).\n"
    )
    beside = problem.with_name("fit.yaml")
    beside.touch()
    assert main(["fit", str(problem)]) == 2
    assert f"got none; {beside} has what was found as parameters.\n" in capsys.readouterr().err


def test_lambda_means_nothing_with_reset_start(
    problem: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    problem.write_text(problem.read_text() + "reset: start\n")
    assert main(["fit", str(problem), "--lambda", "2"]) == 2
    assert "--lambda has no meaning with `reset: start`" in capsys.readouterr().err


def test_warnings_are_shown(problem: Path, capsys: pytest.CaptureFixture[str]) -> None:
    data = dict(np.load(problem.parent / "data.npz"))
    data["actions"][0] = 1.5
    data["terminals"][1] = True
    np.savez(problem.parent / "data.npz", **data)
    assert main(["fit", str(problem), *SMALL, "--lambda", "3", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["warnings"][:2] == [
        (
            "ctrl.push: 1 of 40 actions are outside the control range [-1, 1] and are clipped; "
            "the farthest is 1.5, row 0 at 0 s."
        ),
        "1 of 3 trajectories are shorter than lambda = 3 and are left out.",
    ]


@pytest.mark.parametrize("method", ["dropo", "uniform-randomization"])
def test_a_folder_of_another_run_is_refused(
    problem: Path, method: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Another seed, or other data under the same name."""
    out = problem.parent / "out"
    arguments = [
        "fit",
        str(problem),
        "--method",
        method,
        "--out",
        str(out),
        "--quiet",
        *(SMALL if method == "dropo" else ()),
    ]
    assert main(arguments) == 0
    before = (out / "fit.json").read_text()
    assert main([*arguments, "--seed", "1"]) == 2
    got = "those of another run: seed 0 there and 1 here"
    way_out = "(use another --out, or the settings of that run)"
    assert capsys.readouterr().err == (
        f"dropo: {out}/run.json: seed: expected the settings of this run, got {got} {way_out}.\n"
    )
    data = dict(np.load(problem.parent / "data.npz"))
    data["next_observations"][0] += 1e-9
    np.savez(problem.parent / "data.npz", **data)
    assert main(arguments) == 2
    assert "run.json: data_sha256: " in capsys.readouterr().err
    (problem.parent / "robot.xml").write_text(
        (problem.parent / "robot.xml").read_text().replace('size="0.1"', 'size="0.2"')
    )
    assert main(arguments) == 2
    assert "run.json: data_sha256, model_sha256: " in capsys.readouterr().err
    assert (out / "fit.json").read_text() == before


def test_out_must_be_a_folder(problem: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["fit", str(problem), "--out", str(problem)]) == 2
    assert capsys.readouterr().err == f"dropo: {problem}: --out: expected a folder, got a file.\n"


def test_kill_and_resume(
    problem: Path, undisturbed: Callable[[Path], Path], capsys: pytest.CaptureFixture[str]
) -> None:
    """A run that was killed gives what an undisturbed one gives, and one with another number
    of threads.
    """
    whole = undisturbed(problem)
    killed = problem.parent / "killed"
    run = start(problem, *LONG, "--out", str(killed), "--threads", "2")
    wait_for_lines(killed / "evaluations.jsonl", 3, run)
    run.send_signal(signal.SIGKILL)
    run.communicate()
    assert run.returncode == -signal.SIGKILL
    assert not (killed / "fit.json").exists()
    with (killed / "evaluations.jsonl").open("a") as evaluation_log:
        evaluation_log.write('{"n": 9, "crc32": "')  # a kill in the middle of a line
    assert main(["fit", str(problem), *LONG, "--out", str(killed), "--threads", "2"]) == 0
    assert capsys.readouterr().err == ""
    assert result(killed) == result(whole)
    assert read_log(killed / "evaluations.jsonl") == read_log(whole / "evaluations.jsonl")


@pytest.mark.parametrize(
    "options",
    [
        (),
        SMALL,
        (*SAMPLED, "--draws", "5", "--budget", "15", "--epsilon", "tune"),
        (*SMALL, "--epsilon", "learn", "--start", "least-squares"),
    ],
)
def test_a_finished_run_is_replayed(problem: Path, options: tuple[str, ...]) -> None:
    """The same command again evaluates nothing and gives the same file; so does another number of
    threads, from the start.
    """
    out = problem.parent / "out"
    other = problem.parent / "other"
    arguments = ["fit", str(problem), *options, "--quiet"]
    assert main([*arguments, "--out", str(out), "--threads", "1"]) == 0
    # none where nothing was worth recording
    before = result(out)
    evaluation_logs = [path.read_bytes() for path in out.glob("*.jsonl")]
    assert main([*arguments, "--out", str(out)]) == 0
    assert (result(out), [path.read_bytes() for path in out.glob("*.jsonl")]) == (
        before,
        evaluation_logs,
    )
    assert main([*arguments, "--out", str(other), "--threads", "2"]) == 0
    assert result(other) == before


@pytest.mark.parametrize("kind", [signal.SIGTERM, signal.SIGINT])
def test_interruption_saves_the_best_so_far(
    problem: Path, undisturbed: Callable[[Path], Path], kind: signal.Signals
) -> None:
    """Status 1 and "interrupted"; the same command then ends as an undisturbed run does."""
    out = problem.parent / "out"
    run = start(problem, *LONG, "--out", str(out))
    wait_for_lines(out / "evaluations.jsonl", 4, run)
    run.send_signal(kind)
    text, errors = run.communicate()
    assert (run.returncode, errors) == (1, f"dropo: {STOPPING}\n")
    assert "interrupted: " in text
    assert result(out)["status"] == "interrupted"
    assert main(["fit", str(problem), *LONG, "--out", str(out), "--quiet"]) == 0
    assert result(out) == result(undisturbed(problem))


def test_quiet_is_silent(problem: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """Nothing is written by libraries either, past Python's streams."""
    assert main(["fit", str(problem), *SMALL, "--quiet"]) == 0
    assert capfd.readouterr() == ("", "")


def test_no_log_of_the_physics_is_left(problem: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(problem.parent)
    before = sorted(problem.parent.iterdir())
    assert main(["fit", "problem.yaml", *SMALL, "--quiet"]) == 0
    assert sorted(problem.parent.iterdir()) == before


def test_it_begins_at_values_or_at_another_fit(
    problem: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """By parameter on the command line or in the problem file, alike; or in the folder of a fit."""
    name = load(str(problem)).space.names[0]
    middle = float(np.mean([load(str(problem)).space.low[0], load(str(problem)).space.high[0]]))
    begun = {}
    with_key = problem.with_name("begun.yaml")
    with_key.write_text(f"{problem.read_text()}\nstart: {{{name}: {0.9 * middle}}}\n")
    for key, file, more in (
        ("option", problem, ("--start", f"{name}={0.9 * middle}")),
        ("file", with_key, ()),
        ("folder", problem, ("--start", str(tmp_path / "option"))),
    ):
        folder = tmp_path / key
        arguments = ["fit", str(file), *SMALL, *more, "--out", str(folder), "--quiet"]
        assert main(arguments) == 0
        begun[key] = result(folder)["parameters"]
    assert begun["option"] == begun["file"] != begun["folder"]
    refused = [
        (f"{name}=x", "expected values such as mass=1.5,friction=0.2"),
        (f"{name}=1e9", f"start of {name} must be within its bounds"),
        (f"{name}x=1", name),
        ("midle", "middle"),
    ]
    for text, words in refused:
        try:
            status = main(["fit", str(problem), "--start", text])
        except SystemExit as ended:
            status = ended.code
        assert status == 2
        assert words in capsys.readouterr().err
    with_key.write_text(f"{problem.read_text()}\nstart: {{{name}: 1e9}}\n")
    assert main(["fit", str(with_key)]) == 2
    assert f"start of {name} must be within its bounds" in capsys.readouterr().err


def test_positions_alone_are_fitted_along_whole_runs(tmp_path, monkeypatch, capsys):
    """One line says so, and fit.json which noise was found; with --lambda segments are as ever."""
    log = simulate_log("arm", "positions, white", 91_000).problem.trajectories.head(480)
    monkeypatch.chdir(tmp_path)
    Path("arm.xml").write_text(ARM)
    np.savez(
        "log.npz",
        observations=log.observations[:, :1],
        next_observations=log.next_observations[:, :1],
        actions=log.actions,
        terminals=log.terminals,
    )
    Path("arm.yaml").write_text(
        "{model: arm.xml, frame_skip: 5, data: log.npz, observation: [qpos], parameters:"
        " {damping: {field: dof_damping, name: hinge, low: 0.02, high: 1.0}}}"
    )
    assert main(["fit", "arm.yaml", "--out", "whole"]) == 0
    assert "start states are found along whole runs" in capsys.readouterr().out
    fit = json.loads(Path("whole/fit.json").read_text())
    assert fit["likelihood"] == "trajectory"
    assert fit["trajectory"]["noise"]["qpos.hinge"]["sd"] == pytest.approx(1e-3, rel=0.2)
    assert main(["fit", "arm.yaml", "--lambda", "10", "--out", "segments"]) == 0
    assert json.loads(Path("segments/fit.json").read_text())["likelihood"] == "emulated"
