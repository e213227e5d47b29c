"""From a robot and its logs to a complete folder, in one call.

In reading order: `init` finds the robot, guesses the mapping (`guessing/`), gives the model drives
where it has none (`_make_model`), imports the logs, and writes everything at once.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from dropo.core.services.errors import BadArgument, BadFile
from dropo.core.services.files.places import way_to
from dropo.core.services.files.strict_yaml import format_yaml, read_yaml
from dropo.core.services.tables import Report, Table, number
from dropo.core.services.validation import Array
from dropo.data.checks.sensors import unit_of
from dropo.logs.guessing.files_beside import own_recordings
from dropo.logs.guessing.guess import Ask, guess_mapping
from dropo.logs.guessing.guessed import NAMED, Guess, in_one_line
from dropo.logs.guessing.servos import estimate_drives
from dropo.logs.import_files import (
    PROBLEM,
    RECORD,
    check_place,
    is_as_written,
    sum_of,
    write_import,
)
from dropo.logs.importing import (
    DEFAULTS,
    Import,
    ImportSettings,
    ignore_progress,
    prepare,
    worse_velocities,
)
from dropo.logs.mapping import KIND, check_mapping
from dropo.logs.preparing import clean_run, compare_velocities
from dropo.logs.readers.reader import Progress, open_log
from dropo.logs.recordings import LogRun, read_runs
from dropo.logs.sensor_pairs import sensor_pairs
from dropo.mjmodel.files.loading import load_model
from dropo.mjmodel.files.robots import (
    DriveGuess,
    RobotFile,
    add_drives,
    find_robot,
    fit_step,
    load_spec,
    write_spec,
)
from dropo.mjmodel.joints import ModelJoints, model_joints

MAP = "map.yaml"
MODEL = "model.xml"
DATA = "data.npz"
MAP_SUM = "map_sum"
"""In import.json the SHA-256 of the mapping file as it was written."""
MAP_HEAD = """\
# Guessed by `dropo init`. To change it, edit it and give it to `dropo init` with --map, or to
# `dropo data import` with the model.
"""


@dataclass(frozen=True, eq=False, repr=False)
class InitResult(Report):
    """What `init` wrote.

    Attributes
    ----------
    folder : Path
        Where.
    robot : str
        The robot's name.
    lines : tuple of str
        Every guess, with its reason.
    mapping : dict
        The content of map.yaml.
    imported : Import
        What the import made of the logs.
    next : str
        The command to type next.
    """

    folder: Path
    robot: str
    lines: tuple[str, ...]
    mapping: dict[str, Any]
    imported: Import
    next: str

    def to_json(self) -> dict[str, Any]:
        """Give all of it as JSON holds it.

        Returns
        -------
        dict
            By the names of its fields.
        """
        return {
            "folder": str(self.folder),
            "robot": self.robot,
            "guesses": list(self.lines),
            "mapping": self.mapping,
            "import": self.imported.to_json(),
            "next": self.next,
        }

    def parts(self) -> list[str | Table]:
        """Give the guesses, the import, and the next command."""
        return [*self.lines, *self.imported.parts(), f"Next: {self.next}"]


def init(
    robot: str | Path,
    logs: str | Path | Sequence[str | Path],
    out: str | Path | None = None,
    *,
    mapping: str | Path | None = None,
    ask: Ask | None = None,
    progress: Progress = ignore_progress,
    settings: ImportSettings = DEFAULTS,
) -> InitResult:
    """Make a folder that can be diagnosed, of a robot and its logs.

    Parameters
    ----------
    robot : str or Path
        An MJCF file, a URDF file, or the name of a description of the package robot_descriptions.
    logs : str, Path, or sequence of them
        Files or folders; the mapping is guessed from the first.
    out : str or Path, optional
        The folder; by default one of the robot's name.
    mapping : str or Path, optional
        A mapping file whose entries are taken as they are; the others are guessed.
    ask : callable, optional
        Asks what cannot be decided; without it, that is refused.
    progress : callable
        As of `import_logs`.
    settings : ImportSettings, optional
        How logs are checked and aligned.

    Returns
    -------
    InitResult
        What was written: map.yaml, data.npz, problem.yaml, import.json, and model.xml where the
        model had no actuators.

    Raises
    ------
    BadFile
        If the robot or a log cannot be read, or a file is there that would be lost. Nothing is
        written.
    BadArgument
        If something cannot be decided, or a check finds an error in a log. Nothing is written.
    Incompatible
        If the base is fixed in the model and moves in the log, or the model's actuators take other
        commands. Nothing is written.
    """
    paths = [logs] if isinstance(logs, str | Path) else list(logs)
    found = find_robot(robot)
    folder = Path(out) if out is not None else Path(re.sub(r"[^\w.-]+", "_", found.name))
    _check_folder(folder, None if mapping is None else Path(mapping))
    given = read_yaml(Path(mapping), KIND) if mapping is not None else {}
    called = folder / MAP if mapping is None else Path(mapping)
    spec, lost = load_spec(found)
    joints = model_joints(load_model(spec))
    paths = own_recordings(paths)
    guess = guess_mapping(open_log(paths[0]), joints, given, ask)
    if guess.undecided:
        raise BadArgument(_describe_undecided(guess))
    content = _merge(guess.mapping, given)
    lines = [_say_robot(found, joints, lost), *guess.lines]
    text = None
    if guess.drives or found.is_urdf:
        joints, text, more = _make_model(found, spec, guess, content, paths, folder, called)
        lines += more
    if guess.sensor_units:
        content, more = _choose_sensor_units(content, guess, paths, called, joints)
        lines += more
    if "qvel" in content and "qvel" not in given:
        content, more = _choose_velocities(content, paths, called, joints)
        lines += more
    checked = check_mapping(called, content, joints)
    imported = prepare(paths, checked, joints, progress, settings)
    files = {MAP: MAP_HEAD + format_yaml(content)}
    sums = {MAP_SUM: sum_of(files[MAP].encode())}
    origin = way_to(found.path, folder)
    model = origin
    if text is not None:
        files[MODEL] = text
        model = MODEL
    facts = {"robot": found.name, "model": origin, "guesses": lines, **sums}
    write_import(imported, folder / DATA, model, joints, "init", facts, files)
    command = f"dropo diagnose {folder / PROBLEM}"
    return InitResult(folder, found.name, tuple(lines), content, imported, command)


def _check_folder(folder: Path, mapping: Path | None) -> None:
    """Refuse a folder in which a file would be lost that `init` did not write, or that was edited.

    A mapping that is given is not lost, since its entries stand.
    """
    check_place(folder / DATA)
    place = folder / MAP
    is_given = mapping is not None and mapping.resolve() == place.resolve()
    is_lost = place.exists() and not is_given
    if is_lost and not is_as_written(place, folder / RECORD, MAP_SUM):
        expected = f"no file, or one that `init` wrote (give this one with --map {place})"
        raise BadFile(place, "", expected, "one that was changed")
    if (folder / PROBLEM).exists():
        return  # which an import wrote, with the others
    for name in (MODEL, DATA):
        if (folder / name).exists():
            expected = "no such file, since this one would be lost (choose another --out)"
            raise BadFile(folder / name, "", expected, "one that is there")


def _describe_undecided(guess: Guess) -> str:
    """What was not decided, and what to do, in a sentence."""
    questions = " ".join(guess.undecided)
    answers = [f"`{key}: {in_one_line(value)}`" for key, value in guess.answers.items()]
    return (
        f"{questions} Write the answer into a mapping file and give it with --map, such as "
        f"{' and '.join(answers)}: what it does not say is guessed."
    )


def _say_robot(found: RobotFile, joints: ModelJoints, lost: Sequence[str]) -> str:
    """The line about the robot."""
    form = "URDF" if found.is_urdf else "MJCF"
    without = ""
    if lost:
        without = (
            f"; without the meshes {', '.join(lost)}, which are not there: no contacts of these"
        )
    return (
        f"robot: {found.name}, {form}, {len(joints.joints)} joints, {len(joints.actuators)} "
        f"actuators{without}"
    )


def _merge(guessed: dict[str, Any], given: dict[Any, Any]) -> dict[str, Any]:
    """The mapping, in which what was given stands in the place of what was guessed."""
    out: dict[str, Any] = dict(guessed)
    for key, value in given.items():
        if isinstance(value, dict) and isinstance(out.get(key), dict):
            out[key] = _merge(out[key], value)
        else:
            out[key] = value
    if "inputs" in given:
        out.pop("ctrl", None)
    order = ("time", "qpos", "qvel", "sensordata", "ctrl", "inputs", "run", "rate")
    known = {key: out[key] for key in order if key in out}
    return known | out


def _choose_velocities(
    content: dict[str, Any], paths: Sequence[str | Path], called: Path, joints: ModelJoints
) -> tuple[dict[str, Any], list[str]]:
    """The mapping without logged velocities that are worse than smoothed ones, and why."""
    mapping = check_mapping(called, content, joints)
    runs = read_runs(paths[:1], mapping, ignore_progress)
    longest = max(runs, key=lambda run: run.rows)
    noise = compare_velocities(clean_run(longest, joints))
    worse = worse_velocities(noise)
    if len(worse) <= len(noise) / 2:
        return content, []
    name = f"qvel.{worse[0]}"
    line = (
        f"velocities: smoothed from the positions in place of the logged ones, since {name} has a "
        f"noise of {number(noise[name].sd or 0.0)} {noise[name].unit} and a smoothed one "
        f"{number(noise[name].smoothed or 0.0)}"
    )
    return {key: value for key, value in content.items() if key != "qvel"}, [line]


def _choose_sensor_units(
    content: dict[str, Any],
    guess: Guess,
    paths: Sequence[str | Path],
    called: Path,
    joints: ModelJoints,
) -> tuple[dict[str, Any], list[str]]:
    """The mapping with units of sensors by what the model's own show, where no name says them."""
    mapping = check_mapping(called, content, joints)
    runs = read_runs(paths[:1], mapping, ignore_progress)
    lines = []
    entries = dict(content["sensordata"])
    for pair in sensor_pairs(runs, joints):
        name = pair.name.removeprefix("sensordata.")
        unit = unit_of(pair)
        by_name = guess.sensor_units.get(name) in (None, NAMED)
        if unit is None or by_name or unit == entries[name].get("unit"):
            continue
        entries[name] = entries[name] | {"unit": unit}
        lines.append(f"sensor: {name} is in {unit}, by what the model's own shows along the motion")
    return content | {"sensordata": entries}, lines


# A model that has no actuators


def _make_model(
    found: RobotFile,
    spec: mujoco.MjSpec,
    guess: Guess,
    content: dict[str, Any],
    paths: Sequence[str | Path],
    folder: Path,
    called: Path,
) -> tuple[ModelJoints, str, list[str]]:
    """The model with drives and a step of the log's, its MJCF, and what to say of it.

    called: what messages call the mapping's file.
    """
    drives = {joint: DriveGuess(kind) for joint, kind in guess.drives.items()}
    trial = spec.copy()
    add_drives(trial, {joint: DriveGuess("torque") for joint in drives})
    bare = model_joints(load_model(trial))
    mapping = check_mapping(called, content, bare)
    runs = read_runs(paths[:1], mapping, ignore_progress)
    estimates = estimate_drives(runs, bare, drives) if drives else {}
    rate = content.get("rate")
    control_step = 1 / float(rate) if rate else _median_step(runs)
    add_drives(spec, estimates)
    lines = []
    for joint, drive in estimates.items():
        if drive.kind != "torque":
            lines.append(f"drive: {joint} is a {drive.describe()}, which a fit corrects")
    if found.is_urdf:
        fit_step(spec, control_step)
        step = spec.option.timestep
        lines.append(
            f"time step: {1e3 * step:.6g} ms, a whole part of the log's {1e3 * control_step:.6g} ms"
        )
    text = write_spec(spec, folder, f"Made by `dropo init` of {found.path.name}.")
    return model_joints(load_model(spec)), text, lines


def _median_step(runs: Sequence[LogRun]) -> float:
    """The distance of the positions' rows [s], of which five digits are meant."""
    steps: list[Array] = []
    for run in runs:
        time = next(one for one in run.series if one.channel.field == "qpos").time
        steps.append(np.diff(time))
    median = float(np.median(np.concatenate(steps)))
    rounded = float(f"{median:.3g}")
    return rounded if abs(rounded / median - 1) < 2e-3 else median
