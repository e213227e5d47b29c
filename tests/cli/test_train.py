"""`dropo train` and `dropo evaluate`: what they print, write and refuse, and how training goes on
after an interruption.
"""

import json
import os
import pickle
import subprocess
import sys

import numpy as np
import pytest

from dropo.cli.main import main
from dropo.problems.loading import load
from dropo.training.policy import load_policy

REWARD = """import numpy as np


def near(before, actions, after):
    return -np.abs(after[:, 0] - 0.05)


def still_there(states):
    return np.abs(states[:, 0]) < 5
"""
MADE = """

def task():
    from dropo.core.records.task import Task

    return Task(near, lambda rng, n: np.zeros((n, 2)), steps=5)
"""
TASK = "task: {reward: reward.py:near, alive: reward.py:still_there, steps: 15, bonus: 0.5}\n"


@pytest.fixture
def trained(problem, tmp_path):
    """The cart with a task, and a fit of it."""
    (tmp_path / "reward.py").write_text(REWARD)
    problem.write_text(problem.read_text() + TASK)
    assert main(["fit", str(problem), "--quiet", "--out", str(tmp_path / "fit")]) == 0
    return problem


def arguments(problem, out="policy", budget=4):
    folder = problem.parent
    return [
        "train",
        str(problem),
        "--trust",
        "--fit",
        str(folder / "fit"),
        "--budget",
        str(budget),
        "--out",
        str(folder / out),
        "--threads",
        "1",
    ]


def test_trains_saves_and_evaluates(trained, tmp_path, capsys):
    """The returns under the fit and on the target; a policy that `dropo evaluate` plays to the same
    returns.
    """
    assert main([*arguments(trained), "--json"]) == 0
    made = json.loads(capsys.readouterr().out)
    assert made["policy"] == str(tmp_path / "policy" / "policy.json")
    assert made["about"]["law"] == "dropo fit of problem, with the uncertainty of its means"
    assert set(made["returns"]) == {"under the fit", "as it is"}
    assert set(made["returns"]["as it is"]["lengths"]) == {15}
    assert (
        main(["evaluate", str(tmp_path / "policy"), "--trust", "--on", str(trained), "--json"]) == 0
    )
    assert json.loads(capsys.readouterr().out) == made["returns"]["as it is"]
    assert (
        main(
            [
                "evaluate",
                made["policy"],
                "--trust",
                "--on",
                str(trained),
                "--fit",
                str(tmp_path / "fit"),
                "--json",
            ]
        )
        == 0
    )
    assert json.loads(capsys.readouterr().out) == made["returns"]["under the fit"]
    assert (
        main(
            [
                "evaluate",
                made["policy"],
                "--trust",
                "--on",
                str(trained),
                "--episodes",
                "3",
                "--steps",
                "4",
            ]
        )
        == 0
    )
    assert capsys.readouterr().out.splitlines()[-1].split()[:2] == ["problem", "3"]


def test_goes_on_after_an_interruption(trained, tmp_path, capsys, monkeypatch):
    """To the same file, also where the fit was made again in another time; another run's folder is
    refused and left as it is.
    """
    assert main([*arguments(trained, "whole", 6), "--quiet"]) == 0
    from dropo.training.ars import ARS

    update = ARS._update
    calls = []

    def interrupted(self, *given):
        calls.append(1)
        if len(calls) == 4:
            raise KeyboardInterrupt
        update(self, *given)

    monkeypatch.setattr(ARS, "_update", interrupted)
    assert main([*arguments(trained, "parts", 6), "--quiet"]) == 1
    assert capsys.readouterr().err == "dropo: Interrupted: the same command goes on from here.\n"
    fit = tmp_path / "fit" / "fit.json"
    again = json.loads(fit.read_text())
    again["wall_time_s"] += 1.0
    fit.write_text(json.dumps(again))
    assert main([*arguments(trained, "parts", 6), "--quiet"]) == 0
    assert len(calls) == 4 + 3
    assert (tmp_path / "parts" / "policy.json").read_bytes() == (
        tmp_path / "whole" / "policy.json"
    ).read_bytes()
    assert main([*arguments(trained, "parts", 7), "--quiet"]) == 2
    assert "settings of this run" in capsys.readouterr().err


def test_a_task_travels_with_its_problem(trained, tmp_path):
    """Into the extended problem's folder: `write_problem` names the same functions."""
    from dropo.problems.file.writer import write_problem

    back = load(write_problem(load(trained), tmp_path / "extended"))
    assert back.task.steps == 15
    assert back.task.bonus == 0.5
    states = np.array([[0.3, 0.0], [9.0, 0.0]])
    np.testing.assert_allclose(
        back.task.rewards(states, np.zeros((2, 1)), states, np.zeros((2, 0))), [-0.25, -8.95]
    )
    assert back.task.are_alive(states).tolist() == [True, False]
    starts = back.task.starts(np.random.default_rng(0), 50)
    data = load(trained).trajectories
    assert {tuple(row) for row in starts} == {
        tuple(data.observations[first]) for first, _ in data.spans
    }


@pytest.mark.parametrize(
    ("task", "said"),
    [
        ("{reward: reward.py:nearer}", "task.reward: expected a function as module:name"),
        ("{reward: nowhere.py:near}", "no such file"),
        ("{reward: near}", "task.reward: expected a function"),
        ("{alive: reward.py:near}", "task.reward: expected"),
        (
            "{rewards: reward.py:near}",
            "task.rewards: expected a known key (the nearest is 'reward')",
        ),
        ("{reward: reward.py:near, steps: 0}", "task.steps: expected a whole number of at least 1"),
        ("reward.py:near", "near() missing 3 required positional arguments"),
        ("reward.py:np", "task: expected a Task"),
    ],
)
def test_bad_tasks(task, said, trained, capsys):
    """Each names the file, the key and what is wrong."""
    trained.write_text(trained.read_text().replace(TASK, f"task: {task}\n"))
    assert main(["train", str(trained), "--trust"]) == 2
    assert said in capsys.readouterr().err


def test_refusals(trained, tmp_path, capsys, monkeypatch):
    """A problem without a task, a fit of another model, no fit, a policy of another action space,
    no extra: status 2, nothing written.
    """
    without = tmp_path / "without.yaml"
    without.write_text(trained.read_text().replace(TASK, ""))
    other = tmp_path / "other.yaml"
    (tmp_path / "heavy.xml").write_text(
        (tmp_path / "robot.xml").read_text().replace('mass="2"', 'mass="3"')
    )
    other.write_text(trained.read_text().replace("robot.xml", "heavy.xml"))
    cases = [
        (["train", str(without)], "has no task to train for"),
        (
            ["train", str(other), "--trust", "--fit", str(tmp_path / "fit")],
            "of another model, that of 'problem': not that of 'other'",
        ),
        (
            ["train", str(trained), "--trust", "--fit", str(tmp_path)],
            "a fit written by `dropo fit --out`",
        ),
        (["train", str(trained), "--widen", "100"], "no --fit was given"),
        (["train", "hoper"], "Did you mean 'hopper'?"),
        (["train", str(trained), "--noise", "-1"], "expected a variance of 0 or more, got '-1'"),
        (["evaluate", str(tmp_path), "--on", "hopper"], "a policy written by `dropo train --out`"),
    ]
    out = tmp_path / "refused"
    for line, said in cases:
        assert main([*line, *(["--out", str(out)] if line[0] == "train" else [])]) == 2
        assert said in capsys.readouterr().err
        assert not out.exists()
    assert main([*arguments(trained, budget=1), "--quiet"]) == 0
    assert main(["evaluate", str(tmp_path / "policy"), "--on", "Hopper-v5"]) == 2
    assert "'Hopper-v5' has 11 and 3" in capsys.readouterr().err
    monkeypatch.setattr("dropo.core.services.optional_dependencies.find_spec", lambda name: None)
    assert main(["train", str(trained), "--trust", "--algorithm", "sac", "--out", str(out)]) == 2
    assert "pip install 'dropo[rl]'" in capsys.readouterr().err
    assert not out.exists()
    assert load_policy(tmp_path / "policy").about["algorithm"] == "ars"


def test_video(trained, tmp_path, capsys):
    """An episode as it moves, in its own time."""
    ffmpeg = pytest.importorskip("imageio_ffmpeg", reason="imageio-ffmpeg is not installed")
    assert main([*arguments(trained, budget=1), "--quiet"]) == 0
    small = (
        "import sys; from dropo.report.robot import video; video.WIDTH = video.HEIGHT = 96; from "
        "dropo.cli.main import main; sys.exit(main())"
    )
    line = [
        "evaluate",
        str(tmp_path / "policy"),
        "--trust",
        "--on",
        str(trained),
        "--episodes",
        "1",
        "--video",
        "--json",
    ]
    done = subprocess.run(
        [sys.executable, "-c", small, *line],
        capture_output=True,
        text=True,
        env=os.environ | {"MUJOCO_GL": "egl"},
    )
    if "MuJoCo cannot draw here" in done.stderr:
        pytest.skip("no graphics library for drawing off screen")
    assert done.returncode == 0, done.stderr
    path = tmp_path / "policy" / "policy.mp4"
    assert json.loads(done.stdout)["video"] == str(path)
    unpack = [ffmpeg.get_ffmpeg_exe(), "-i", str(path), "-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
    frames = np.frombuffer(
        subprocess.run(unpack, capture_output=True, check=True).stdout, np.uint8
    ).reshape(-1, 96, 96, 3)
    assert len(frames) == 5  # 16 states, 0.01 s apart, at 30 a second
    assert frames.std() > 5


class Marks:
    """Makes a file as it is unpickled."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return os.mkdir, (str(self.path),)


def test_a_training_of_a_network_is_read_only_where_it_is_trusted(tmp_path, capsys):
    """The files that it goes on from are pickles: without --trust they are refused by name, unread;
    with it, they are read, code and all.
    """
    pytest.importorskip("stable_baselines3", reason="stable-baselines3 is not installed")
    out = tmp_path / "out"
    out.mkdir()
    (out / "networks.json").write_text('{"steps": 5}')
    (out / "scale.pkl").write_bytes(pickle.dumps(Marks(tmp_path / "ran")))
    command = ["train", "hopper", "--algorithm", "ppo", "--budget", "9", "--out", str(out)]
    assert main([*command, "--quiet"]) == 2
    told = capsys.readouterr().err
    assert str(out / "model.zip") in told
    assert "--trust" in told
    assert not (tmp_path / "ran").exists()
    assert main([*command, "--quiet", "--trust"]) == 2
    assert str(out / "scale.pkl") in capsys.readouterr().err
    assert (tmp_path / "ran").is_dir()


CODE = "from pathlib import Path\nPath(__file__).with_name('ran').touch()\n"


def test_code_of_a_problem_file_runs_only_where_it_is_trusted(trained, tmp_path, capsys):
    """No command imports it without --trust: those that need none do without, training and
    evaluation are refused and write nothing; with --trust, and in Python, it runs.
    """
    assert main([*arguments(trained), "--quiet"]) == 0
    (tmp_path / "reward.py").write_text(CODE + REWARD)
    ran = tmp_path / "ran"
    play = ["evaluate", str(tmp_path / "policy"), "--on", str(trained), "--episodes", "1"]
    fit = ["fit", str(trained), "--method", "least-squares", "--out", str(tmp_path / "new")]
    check = ["data", "check", str(trained)]
    for command, status in ((fit, 0), (check, 0), (play, 2)):
        assert main(command) == status
    untrusted = [word for word in arguments(trained, "other") if word != "--trust"]
    assert main(untrusted) == 2
    told = "task: 'reward.py:near' is Python code, which runs only where it is trusted"
    assert capsys.readouterr().err.count(told) == 2
    assert not (tmp_path / "other").exists()
    assert not ran.exists()
    assert main([*play, "--trust"]) == 0
    assert ran.exists()


def test_no_path_of_the_machine_is_kept(trained, tmp_path):
    """Neither in what a run keeps of its problem, nor in a problem that is written elsewhere."""
    from dropo.problems.file.writer import write_problem

    for task in (TASK, "task: reward.py:task\n"):
        base = trained.read_text().split("task:")[0]
        (tmp_path / "reward.py").write_text(REWARD + MADE)
        trained.write_text(base + task)
        out = tmp_path / "runs" / "copy"
        path = write_problem(load(trained, trusted=False), out)
        assert str(tmp_path) not in path.read_text()
        assert "../../reward.py:" in path.read_text()
        assert load(path).task is not None
    made = json.loads((tmp_path / "fit" / "made.json").read_text())
    assert made["problem"] == "../problem.yaml"
