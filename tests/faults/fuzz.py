"""Breaks input files in many ways and runs the command line on them.

`python tests/faults/fuzz.py --cases 10000 --seed 0` makes a long run. It prints every case that
broke a rule; `--first NUMBER --cases 1` makes it again.
"""

import argparse
import contextlib
import faulthandler
import io
import json
import os
import shutil
import signal
import sys
import tempfile
import time
import traceback
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.random import Generator

from dropo.cli.main import main

LIMIT = 10
"""Seconds of computing that a command may take."""
WAIT = 60
"""Seconds that it may take in all, but for those in which other work has the processor."""
LONGEST = 1500
"""Characters of a refusal."""
XML = """<mujoco>
  <option timestep="0.01"/>
  <worldbody>
    <body name="cart"><joint name="slide" type="slide" axis="1 0 0" damping="0.5"/>
      <geom name="box" size="0.1" mass="2"/></body>
  </worldbody>
  <actuator><motor name="push" joint="slide" ctrllimited="true" ctrlrange="-1 1"/></actuator>
</mujoco>
"""
PROBLEM = """model: robot.xml
data: data.npz
frame_skip: 1
observation: [qpos, qvel]
parameters:
  mass: {field: body_mass, name: cart, low: 1, high: 4, unit: kg}
  damping: {field: dof_damping, name: slide, low: 0.1, high: 1.0, unit: N s/m}
effects:
  - {effect: actuator_gain, target: push, sizes: {gain: 0.1}}
motors: {slide: {rotor_inertia: 1e-5, gear_ratio: 2}}
epsilon: {qpos.slide: 1e-8, qvel.slide: 1e-8}
reset: transition
task: {reward: reward.py:near, steps: 5}
"""
REWARD = "def near(before, actions, after):\n    return -abs(after[:, 0])\n"
MAPPING = """time: {column: t, unit: s}
qpos: {slide: {column: q, unit: m, sign: -1, offset: 0.1}}
ctrl: {push: {column: u, unit: N}}
rate: 100
"""
WORDS = (
    *("null", "true", "-1", "0", "1e308", "-1e308", "nan", ".inf", "2.5", "9" * 400, "text", "''"),
    *("[]", "{}", "[[[]]]", "&a", "*a", "!!float 1", "~", "\t", "λ", "\x00", "../..", "/dev/null"),
)
VALUES: tuple[Any, ...] = (
    *(None, True, -1, 0, 1e308, 10**30, "text", "", [], {}, [[]], {"a": 1}, [1, 2, 3], -0.5),
    *("9.9.9", "x" * 5000, float("nan"), float("inf"), "λ\n"),
)


@dataclass(frozen=True)
class Case:
    """A command, the files that may be broken for it, and how often it is chosen."""

    files: tuple[str, ...]
    command: tuple[str, ...]
    weight: int = 1


FIT = ("fit", "problem.yaml", "--method", "uniform-randomization", "--out", "new", "--quiet")
PLAY = ("evaluate", "policy", "--on", "problem.yaml", "--episodes", "1", "--steps", "2", "--trust")
INTO = ("--out", "new/data.npz")
INIT = ("init", "robot.xml", "log.csv", "--out", "new", "--quiet")
SEARCH = ("--effects", "joint_friction:slide", "actuator_gain:push", "--steps", "2")
VARIANT = ("--method", "uniform-randomization", "--seeds", "1", "--quiet")
AGAIN = ("problem.yaml", "--out", "new", "--quiet")
PROBLEM_FILES = ("problem.yaml", "data.npz", "robot.xml")
EXTENDED = ("problem.yaml", "data.npz", "model.xml", "model.npz", "model.py")
DIAGNOSED = ("checked/diagnosis.json", *(f"checked/extended/{name}" for name in EXTENDED))
RUN = ("fit.json", "fit.npz", "run.json", "made.json", "predictions.npz", "evaluations.jsonl")
CASES = (
    Case(PROBLEM_FILES, FIT, 4),
    Case(PROBLEM_FILES, ("data", "check", "problem.yaml"), 2),
    Case(("data.npz",), ("data", "describe", "data.npz"), 2),
    Case(
        ("log.csv", "map.yaml", "robot.xml"),
        ("data", "import", "log.csv", "--map", "map.yaml", "--model", "robot.xml", *INTO),
        3,
    ),
    Case(("run/fit.json", "run/fit.npz"), (*PLAY, "--fit", "run"), 3),
    Case(("policy/policy.json",), PLAY, 2),
    Case(
        ("policy/ars.npz", "policy/run.json"),
        ("train", "problem.yaml", "--budget", "1", "--out", "policy", "--quiet", "--trust"),
        2,
    ),
    Case(
        ("run/evaluations.jsonl", "run/run.json"),
        ("fit", "problem.yaml", "--out", "run", "--quiet"),
    ),
    Case(tuple(f"run/{name}" for name in RUN), ("report", "run", "--out", "new.html")),
    Case(
        ("found/diagnosis.json", "found/run.json", "found/made.json"),
        ("report", "found", "--out", "new.html"),
    ),
    Case(("log.csv", "map.yaml", "robot.xml"), (*INIT, "--map", "map.yaml"), 3),
    Case(("log.csv", "robot.xml"), INIT, 2),
    Case(PROBLEM_FILES, ("diagnose", "problem.yaml", *SEARCH, "--out", "new", "--quiet"), 2),
    Case(DIAGNOSED, ("verify", "checked"), 4),
    Case(DIAGNOSED, ("export", "checked", "--to", "mujoco", "--out", "new"), 2),
    Case(("run/fit.json", "run/fit.npz"), ("export", "run", "--to", "bam", "--out", "new"), 2),
    Case(PROBLEM_FILES, ("compare", "--problem", "problem.yaml", *VARIANT, "--out", "new")),
    Case(PROBLEM_FILES, ("data", "states", "problem.yaml", "--out", "new")),
    Case(PROBLEM_FILES, ("data", "actions", "problem.yaml", *INTO)),
    Case(("run/fit.json", "run/fit.npz"), ("fit", *AGAIN, "--start", "run")),
)


def build_inputs(folder: Path) -> None:
    """Write a whole problem, its data and a log into a folder."""
    rng = np.random.default_rng(0)
    n = 60
    actions = rng.uniform(-1, 1, (n, 1))
    speed = np.concatenate([[0], np.cumsum(0.01 * actions[:, 0] / 2)])
    states = np.column_stack([0.01 * np.cumsum(speed), speed]) + rng.normal(0, 1e-4, (n + 1, 2))
    (folder / "robot.xml").write_text(XML)
    (folder / "problem.yaml").write_text(PROBLEM)
    (folder / "reward.py").write_text(REWARD)
    (folder / "map.yaml").write_text(MAPPING)
    rows = (f"{i / 100},{states[i, 0]},{actions[i, 0]}" for i in range(n))
    (folder / "log.csv").write_text("\n".join(["t,q,u", *rows]) + "\n")
    np.savez(
        folder / "data.npz",
        observations=states[:-1],
        actions=actions,
        next_observations=states[1:],
        terminals=np.arange(n) % 20 == 19,
    )


def build(folder: Path) -> None:
    """Write whole files of every kind into a folder."""
    build_inputs(folder)
    with inside(folder), contextlib.redirect_stdout(io.StringIO()):
        hidden = ("--hide", "joint_armature:elbow=0.01", "--wiring", "off", "--out", "found")
        for command in (
            ("fit", "problem.yaml", "--out", "run"),
            ("train", "problem.yaml", "--budget", "1", "--out", "policy", "--trust"),
            ("diagnose", "torque-arm", "--quick", *hidden),
            ("diagnose", "problem.yaml", *SEARCH, "--out", "checked"),
        ):
            assert main([*command, "--quiet"]) == 0, command


@contextlib.contextmanager
def inside(folder: Path) -> Any:
    """Work in a folder."""
    before = Path.cwd()
    os.chdir(folder)
    try:
        yield
    finally:
        os.chdir(before)


# Breaking


def break_file(path: Path, rng: Generator) -> str:
    """Break a file in one way; say which."""
    if rng.random() < 0.25:
        return _break_bytes(path, rng)
    kinds: dict[str, Callable[[Path, Generator], str]] = {
        ".npz": _break_arrays,
        ".json": _break_json,
        ".jsonl": _break_lines,
    }
    return kinds.get(path.suffix, _break_text)(path, rng)


def _break_bytes(path: Path, rng: Generator) -> str:
    """Cut off, flipped, emptied, doubled or exchanged."""
    raw = bytearray(path.read_bytes())
    kind = int(rng.integers(5))
    if kind == 0:
        path.write_bytes(raw[: rng.integers(len(raw))])
    elif kind == 1:
        for _ in range(rng.integers(1, 6)):
            raw[rng.integers(len(raw))] = rng.integers(256)
        path.write_bytes(raw)
    elif kind == 2:
        junk = (b"", b"\xff\xfe\x00", b"words", b"[" * 50_000, b"PK\x03\x04", b"{}", b"null")
        path.write_bytes(junk[rng.integers(len(junk))])
    elif kind == 3:
        path.write_bytes(raw * 2)
    else:
        path.unlink()
        path.mkdir()
    return f"bytes {kind}"


def _break_text(path: Path, rng: Generator) -> str:
    """A line taken out or doubled, or a word of it exchanged."""
    lines = path.read_text().splitlines()
    i = int(rng.integers(len(lines)))
    kind = int(rng.integers(4))
    if kind == 0:
        del lines[i]
    elif kind == 1:
        lines.insert(i, lines[rng.integers(len(lines))])
    else:
        words = lines[i].replace(":", ": ").replace(",", " , ").replace('"', ' " ').split(" ")
        at = int(rng.integers(len(words)))
        words[at] = WORDS[rng.integers(len(WORDS))]
        lines[i] = " ".join(words)
    path.write_text("\n".join(lines) + "\n")
    return f"line {i}: {lines[i] if i < len(lines) else ''}"[:80]


def _break_json(path: Path, rng: Generator) -> str:
    """A key or an entry taken out or exchanged."""
    content = json.loads(path.read_text())
    told = _break_content(content, rng)
    path.write_text(json.dumps(content))
    return told


def _break_lines(path: Path, rng: Generator) -> str:
    """A line of JSON lines, the same way, or exchanged with another."""
    lines = path.read_text().splitlines()
    i = int(rng.integers(len(lines)))
    if rng.random() < 0.5:
        content = json.loads(lines[i])
        told = _break_content(content, rng)
        lines[i] = json.dumps(content)
    else:
        j = int(rng.integers(len(lines)))
        lines[i], lines[j] = lines[j], lines[i]
        told = f"{i} for {j}"
    path.write_text("\n".join(lines) + "\n")
    return told


def _break_content(content: Any, rng: Generator) -> str:
    """One place of nested lists and mappings."""
    places = list(_places(content))
    container, key = places[rng.integers(len(places))]
    if rng.random() < 0.3:
        del container[key]
        return f"without {key}"
    container[key] = VALUES[rng.integers(len(VALUES))]
    return f"{key} = {str(container[key])[:30]}"


def _places(content: Any) -> Any:
    """Every container in a content with every key."""
    keys = list(content) if isinstance(content, dict) else range(min(len(content), 8))
    for key in keys:
        yield content, key
        if isinstance(content[key], dict | list):
            yield from _places(content[key])


def _break_arrays(path: Path, rng: Generator) -> str:
    """An array taken out, of another shape or type, or with other numbers."""
    with np.load(path, allow_pickle=False) as kept:
        arrays = dict(kept)
    name = sorted(arrays)[rng.integers(len(arrays))]
    array = arrays.pop(name)
    row = np.atleast_1d(array)
    others = (
        *(np.zeros(0), np.zeros((2, 3, 4)), np.array("text"), np.array(["a", "b"]), np.array(True)),
        *(np.full(3, np.nan), np.array(1e300), np.array([{}], dtype=object), np.zeros((0, 7))),
        *(row[None], row[..., :1], row.astype(str), row[:-1]),
    )
    kind = int(rng.integers(4))
    if kind == 1:
        arrays[name] = others[rng.integers(len(others))]
    elif kind > 1:
        flat = array.astype(float).ravel() if array.dtype.kind in "biuf" else np.zeros(1)
        if flat.size:
            flat[rng.integers(flat.size)] = (np.nan, np.inf, 1e30, -1e30, -1, 0)[rng.integers(6)]
        arrays[name] = flat.reshape(array.shape if flat.size == array.size else (-1,))
    np.savez(path, **arrays)
    told = arrays.get(name)
    return f"{name}: {None if told is None else (told.dtype, told.shape)}"


# Running


class HangError(BaseException):
    """A command that takes too long; no handler of exceptions takes it for another error."""


def _hang(*_: object) -> None:
    raise HangError


def _end_what_hears_nothing() -> None:
    """End a command that hangs where no signal is heard; called again as long as one is."""
    faulthandler.dump_traceback_later(2 * WAIT, exit=True)


def _clock() -> float:
    """Seconds by the clock without those of waiting for a processor, where these are known."""
    delay = Path("/proc/self/schedstat")
    waited = int(delay.read_text().split()[1]) / 1e9 if delay.exists() else 0.0
    return time.monotonic() - waited


def snapshot(folder: Path) -> dict[str, bytes | None]:
    """All files of a folder with their contents."""
    return {
        str(path.relative_to(folder)): path.read_bytes() if path.is_file() else None
        for path in sorted(folder.rglob("*"))
    }


def run_case(whole: Path, folder: Path, number: int, seed: int, kinds: str = "") -> str | None:
    """Break a copy of the files in one way and run one command; what rule was broken, or None."""
    rng = np.random.default_rng([seed, number])
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(whole, folder)
    chosen = [case for case in CASES if kinds in " ".join(case.command)]
    weights = np.array([case.weight for case in chosen], dtype=float)
    case = chosen[rng.choice(len(chosen), p=weights / weights.sum())]
    name = case.files[rng.integers(len(case.files))]
    told = break_file(folder / name, rng)
    before = snapshot(folder)
    found = _run(folder, case.command, before)
    return found and f"case {number}: dropo {' '.join(case.command)} | {name}: {told} | {found}"


def _run(folder: Path, command: tuple[str, ...], before: dict[str, bytes | None]) -> str | None:
    """What rule a command breaks."""
    out = io.StringIO()
    err = io.StringIO()
    begun = _clock()

    def waited(*_: object) -> None:
        if _clock() - begun > WAIT:
            raise HangError
        _end_what_hears_nothing()

    signal.signal(signal.SIGPROF, _hang)
    signal.signal(signal.SIGALRM, waited)
    # Again and again, since an exception within a callback is lost.
    signal.setitimer(signal.ITIMER_REAL, WAIT, 1)
    signal.setitimer(signal.ITIMER_PROF, LIMIT, 1)
    try:
        with (
            inside(folder),
            contextlib.redirect_stdout(out),
            contextlib.redirect_stderr(err),
            warnings.catch_warnings(),
        ):
            warnings.simplefilter("ignore")
            status = main(list(command))
    except HangError:
        return f"takes more than {LIMIT} s"
    except Exception as error:
        last = [frame for frame in traceback.extract_tb(error.__traceback__) if "dropo" in frame[0]]
        return f"{type(error).__name__}: {str(error)[:100]} in {last[-1][0]}:{last[-1][1]}"
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.setitimer(signal.ITIMER_PROF, 0)
        faulthandler.cancel_dump_traceback_later()
    refusal = err.getvalue()
    if "Interrupted" in refusal:
        raise KeyboardInterrupt
    if status == 0:
        return None
    if status not in (1, 2):
        return f"status {status}"
    if status == 2 and refusal:
        if refusal.count("\n") != 1 or len(refusal) > LONGEST:
            return f"a refusal of {refusal.count(chr(10))} lines, {len(refusal)} characters"
        if snapshot(folder) != before:
            return f"a refusal that writes: {refusal}"
    return None


def main_fuzz() -> int:
    """A long run."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", type=int, default=10_000)
    parser.add_argument("--first", type=int, default=0, help="the first case")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--kind", default="", help="a word of the command")
    arguments = parser.parse_args()
    broken = 0
    with tempfile.TemporaryDirectory() as place:
        whole = Path(place) / "whole"
        whole.mkdir()
        build(whole)
        for number in range(arguments.first, arguments.first + arguments.cases):
            _end_what_hears_nothing()
            found = run_case(whole, Path(place) / "case", number, arguments.seed, arguments.kind)
            if found:
                broken += 1
                print(found.replace("\n", " "), flush=True)
    print(f"{broken} of {arguments.cases} cases broke a rule.")
    return int(broken > 0)


if __name__ == "__main__":
    sys.exit(main_fuzz())
