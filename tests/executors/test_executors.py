"""Executors by name: the same numbers everywhere, workers that die are replaced, refusals."""

import json
import os
import signal
import stat
import sys
from pathlib import Path

import pytest

from dropo.cli.main import main
from dropo.core.services.errors import BadArgument, DropoError, UnknownName
from dropo.core.services.plugin_files import load_plugins
from dropo.executors.named import executor_named
from dropo.studies.engine.work import Work

SBATCH = """#!{python}
# Runs each task of an array in the background, as a node would, and lets `srun` begin its command.
import itertools, os, re, subprocess, sys

script = open(sys.argv[1]).read()  # as it is now: whoever submits moves the file then
array = re.search(r"--array=0-(\\d+)", script)
job = str(os.getpid())
for task in range(int(array[1]) + 1) if array else [None]:
    own = dict(os.environ, SLURM_JOB_ID=job, SLURM_NTASKS="1", SLURM_PROCID="0", SLURM_LOCALID="0",
               SLURM_NODEID="0", SLURM_NNODES="1", SLURM_JOB_NODELIST="here")
    if task is not None:
        own.update(SLURM_ARRAY_JOB_ID=job, SLURM_ARRAY_TASK_ID=str(task))
    silent = subprocess.DEVNULL
    subprocess.Popen(["bash", "-c", script], env=own, stdout=silent, stderr=silent)
    open(os.path.join("{folder}", "jobs"), "a").write(f"{{job}} {{task}}\\n")
print(f"Submitted batch job {{job}}")
"""
SRUN = """#!/bin/bash
while [ "${1:0:1}" = "-" ]; do
  case "$1" in --output|--error|--job-name) shift 2 ;; *) shift ;; esac
done
exec "$@"
"""
SACCT = """#!{python}
# A job whose process ended without an answer has failed.
import sys
jobs = [line.split() for line in open("{folder}/jobs")]
dead = open("{folder}/dead").read().split() if __import__("os").path.exists("{folder}/dead") else []
print("JobID|State|NodeList")
for job, task in jobs:
    name = job if task == "None" else job + "_" + task
    print(name + "|" + ("FAILED" if name in dead else "RUNNING") + "|here")
"""


@pytest.fixture
def fake_slurm(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A SLURM of this machine: its four commands on the path."""
    texts = {"sbatch": SBATCH, "sacct": SACCT}
    programs = tmp_path / "bin"
    programs.mkdir()
    for name in ("sbatch", "sacct", "srun", "scancel"):
        text = texts.get(name, "").format(python=sys.executable, folder=tmp_path)
        text = {"srun": SRUN, "scancel": "#!/bin/bash\n"}.get(name, text)
        program = programs / name
        program.write_text(text)
        program.chmod(program.stat().st_mode | stat.S_IXUSR)
    monkeypatch.setenv("PATH", f"{programs}:{os.environ['PATH']}")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def square(item: int) -> dict[str, float]:
    """A task."""
    return {"square": item**2 + 0.1}


def die_once(folder: str) -> int:
    """Kill the worker unless it did so before; the number of the process that answers."""
    died = Path(folder) / "died"
    if not died.exists():
        died.write_text(str(os.getpid()))
        (Path(folder) / "dead").write_text(os.environ.get("SLURM_JOB_ID", ""))
        os.kill(os.getpid(), signal.SIGKILL)
    return os.getpid()


def die(_: int) -> None:
    """Kill the worker."""
    os.kill(os.getpid(), signal.SIGKILL)


@pytest.mark.parametrize("name", ["threads:2", "ray"])
def test_tasks_give_the_same_everywhere(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """A study's tasks; an exception of a task comes back as itself."""
    if name == "ray":
        pytest.importorskip("ray")
        monkeypatch.setattr("dropo.executors.clusters.cores", lambda: 1)
    with executor_named(name) as executor:
        assert Work(executor).map(square, [1, 2, 3]) == Work(threads=1).map(square, [1, 2, 3])
        with pytest.raises(ZeroDivisionError):
            executor.submit(divmod, 1, 0).result()


def test_jobs_of_slurm(fake_slurm: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One array for what is asked together; answers come back, and the folder of jobs goes; a job
    that is lost is started again.
    """
    slurm = pytest.importorskip("submitit.slurm.slurm")
    monkeypatch.setattr(slurm.SlurmJob, "watcher", slurm.SlurmInfoWatcher(delay_s=1))
    # How long it waits for the answer of a job that has ended: files are here at once.
    monkeypatch.setattr(slurm.SlurmJob, "_results_timeout_s", 2)
    with executor_named("slurm:cpu,time=5,mem=1") as executor:
        assert Work(executor).map(square, [1, 2]) == Work(threads=1).map(square, [1, 2])
        assert len((fake_slurm / "jobs").read_text().splitlines()) == 2
        after = executor.submit(die_once, str(fake_slurm))
        assert after.result() != int((fake_slurm / "died").read_text())
    assert not list((fake_slurm / "slurm_jobs").iterdir())


@pytest.mark.parametrize("name", ["processes:1", "joblib:1"])
def test_a_worker_that_dies_is_replaced(name: str, tmp_path: Path) -> None:
    """What it had not ended is run again by another; an exception of a task comes back as itself,
    and is no lost worker.
    """
    if name.startswith("joblib"):
        pytest.importorskip("joblib")
    with executor_named(name) as executor:
        after = executor.submit(die_once, str(tmp_path))
        others = [executor.submit(square, k) for k in range(3)]
        assert after.result() != int((tmp_path / "died").read_text())
        assert [other.result() for other in others] == [square(k) for k in range(3)]
        with pytest.raises(ZeroDivisionError):
            executor.submit(divmod, 1, 0).result()


def test_what_always_kills_its_worker_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("dropo.executors.restarting.MOST_LOSSES", 1)
    with (
        executor_named("processes:1") as executor,
        pytest.raises(DropoError, match="1 times in a row a worker died"),
    ):
        executor.submit(die, 0).result()


def test_workers_know_the_plug_ins(tmp_path: Path) -> None:
    """A part that a file of one's own registered is found by name in another process, where the
    file is not in its place any more too.
    """
    file = tmp_path / "part_of_the_test_of_executors.py"
    file.write_text("import dropo\n\ndropo.register('optimizers', 'elsewhere', print)\n")
    load_plugins(file)
    with executor_named("processes:1") as executor:
        assert "elsewhere" in executor.submit(names_of_optimizers).result()
    sys.modules.pop(file.stem)


def names_of_optimizers() -> list[str]:
    """What a worker finds."""
    from dropo.core.services.registry import names

    return names("optimizers")


def test_a_whole_command_elsewhere(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The same fit, its table printed here; a refusal is one line and status 2."""
    command = ["fit", "slide", "--method", "least-squares", "--json", "--quiet"]
    assert main(command) == 0
    here = json.loads(capsys.readouterr().out)
    assert main([*command, "--executor=processes:1", "--out", str(tmp_path / "there")]) == 0
    there = json.loads(capsys.readouterr().out)
    assert there["parameters"] == here["parameters"]
    assert (tmp_path / "there" / "fit.json").exists()
    assert main(["fit", "slid", "--executor", "threads:1"]) == 2
    assert "Did you mean 'slide'" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("name", "error", "said"),
    [
        ("proceses:2", UnknownName, "Did you mean 'processes'"),
        ("processes:many", BadArgument, "a number of at least 1"),
        ("threads:0", BadArgument, "a number of at least 1"),
        ("slurm", BadArgument, "slurm:PARTITION"),
        ("slurm:cpu,tme=3", UnknownName, "Did you mean 'time'"),
        ("slurm:cpu,time=long", BadArgument, "whole number"),
        ("slurm:cpu", DropoError, "no sbatch"),
        ("dask://localhost:1", DropoError, "No Dask scheduler answers at localhost:1"),
    ],
)
def test_refusals(
    name: str, error: type[Exception], said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    package = {"slurm": "submitit", "dask": "distributed"}.get(name.split(":")[0])
    if package:
        pytest.importorskip(package)
    monkeypatch.setattr("dropo.executors.clusters.WAIT", 0.5)
    with pytest.raises(error, match=said), executor_named(name):
        pass
