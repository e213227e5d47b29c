"""Raw logs to data that a fit takes: checked, aligned, resampled on the model's control step, with
the noise of every signal.
"""

import os
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from dropo._version import __version__
from dropo.core.services.atomic_write import atomic_write, write_json, write_npz, write_text
from dropo.core.services.errors import BadArgument, BadFile
from dropo.core.services.strict_yaml import format_yaml, read_yaml
from dropo.core.services.tables import Report, Table, number
from dropo.core.services.validation import Array
from dropo.data.checks.findings import Finding
from dropo.logs.grids import (
    CLOSE,
    LeftOut,
    commanded,
    measured,
    observed,
    steps_per_action,
    whole_spans,
)
from dropo.logs.log_checks import check_runs
from dropo.logs.mapping import Mapping, read_mapping
from dropo.logs.preparing import Noise, cleaned, with_velocities
from dropo.logs.readers.reader import Progress
from dropo.logs.recordings import Run, read_runs
from dropo.logs.signals.clocks import Lateness, aligned
from dropo.mjmodel.joints import ModelJoints, load_model_joints

PROBLEM = "problem.yaml"
RECORD = "import.json"
SHOWN = 20
OURS = ("model", "frame_skip", "data", "observation", "action")
HEAD = """# Written by `dropo data import`. `dropo fit` needs parameters; noise levels of the signals stand in {record}. For example:
# parameters:
#   mass: {{field: body_mass, name: {body}, low: {low:.3g}, high: {high:.3g}, unit: kg}}
"""


@dataclass(frozen=True, eq=False, repr=False)
class Import(Report):
    """What an import made of the logs: the arrays of data.npz, and all that import.json says.

    rows: by run, read, resampled and dropped; trajectories: rows of each; noise: by signal.
    """

    arrays: dict[str, Array]
    observation: list[str]
    action: list[str]
    frame_skip: int
    control_step: float
    rows: dict[str, dict[str, Any]]
    trajectories: list[int]
    delays: list[Lateness]
    noise: dict[str, Noise]
    left_out: list[LeftOut]
    findings: list[Finding]
    inputs: tuple[str, ...]

    def to_json(self) -> dict[str, Any]:
        """The content of import.json."""
        return {
            "version": __version__,
            "frame_skip": self.frame_skip,
            "control_step_s": self.control_step,
            "runs": self.rows,
            "trajectories": self.trajectories,
            "inputs": list(self.inputs),
            "delays": [asdict(late) | {"removed": late.removed} for late in self.delays],
            "noise": {name: asdict(noise) for name, noise in self.noise.items()},
            "left_out": [
                {"run": span.run, "from_s": span.start, "to_s": span.stop, "why": span.why}
                for span in self.left_out
            ],
            "findings": [asdict(finding) for finding in self.findings],
        }

    def parts(self) -> list[str | Table]:
        """Counts, a table of the noise, delays, spans left out, and findings."""
        read, resampled, dropped = (
            sum(run[key] for run in self.rows.values()) for key in ("read", "resampled", "dropped")
        )
        counts = (
            f"{len(self.arrays['observations'])} rows in {len(self.trajectories)} "
            f"trajectories of {len(self.rows)} runs, every "
            f"{1e3 * self.control_step:.6g} ms ({self.frame_skip} physics steps); of "
            f"{read} rows read, {dropped} were dropped; "
            f"{resampled} rows are resampled."
        )
        rows = tuple(
            (
                name,
                noise.unit,
                "-" if noise.sd is None else number(noise.sd),
                "estimated" if noise.estimated else "logged",
            )
            for name, noise in self.noise.items()
        )
        left_out = [
            f"left out: {span.run}, {span.start:.6g} s to {span.stop:.6g} s: {span.why}"
            for span in self.left_out
        ]
        more = (
            [f"... and {len(left_out) - SHOWN} more spans left out"]
            if len(left_out) > SHOWN
            else []
        )
        delays = [str(late) for late in self.delays if late.removed]
        on_time = len(self.delays) - len(delays)
        delays += (
            [f"Delays too small to tell, and left: {on_time} (see {RECORD})."] if on_time else []
        )
        return [
            counts,
            Table("", ("signal", "unit", "noise sd", ""), rows),
            *delays,
            *left_out[:SHOWN],
            *more,
            *map(str, self.findings),
        ]


def import_logs(
    logs: str | Path | Sequence[str | Path],
    mapping: str | Path,
    model: str | Path,
    out: str | Path,
    *,
    progress: Progress = lambda share, text: None,
) -> Import:
    """Reads logs by a mapping file, and writes the data, problem.yaml and import.json beside it;
    nothing where something is refused.

    logs: files or folders, of which each is a recording (or holds several runs); mapping: the YAML
    file that says which column is which joint or actuator; model: the MJCF file; out: the data
    file, .npz; progress(share, text): called while it works.
    """
    place = Path(out)
    _check_place(place)
    logs = [logs] if isinstance(logs, str | Path) else logs
    machine = load_model_joints(model)
    found = prepare(logs, read_mapping(mapping, machine), machine, progress=progress)
    _write(found, place, Path(model), machine)
    return found


def prepare(
    logs: Sequence[str | Path],
    mapping: Mapping,
    machine: ModelJoints,
    *,
    progress: Progress = lambda share, text: None,
) -> Import:
    """What `import_logs` writes, without writing it."""
    raw = read_runs(logs, mapping, lambda share, text: progress(0.5 * share, text))
    findings = check_runs(raw, machine)
    for finding in findings:
        if finding.level == "error":
            raise BadArgument(
                f"{', '.join(map(str, logs))}: {str(finding).removeprefix('error: ')}"
            )
    progress(0.5, "aligning")
    runs, delays = aligned([cleaned(run, machine) for run in raw], machine)
    skip, off = steps_per_action(runs, machine.timestep, mapping.rate)
    if abs(off) > CLOSE and mapping.rate is not None:
        near = 1 / (skip * machine.timestep)
        expected = (
            "a rate whose control step is a whole number of physics steps of "
            f"{machine.timestep:g} s, such as {near:.6g} Hz"
        )
        raise mapping.refusal("rate", expected, f"{mapping.rate:g}")
    progress(0.7, "velocities")
    runs, noise = with_velocities(runs, machine)
    progress(0.9, "resampling")
    return _gathered(raw, runs, mapping, machine, skip, delays, noise, findings)


@dataclass(frozen=True, eq=False)
class _Piece:
    """One trajectory."""

    observations: Array
    actions: dict[str, Array]
    time: Array
    run: int


def _gathered(
    raw: Sequence[Run],
    runs: Sequence[Run],
    mapping: Mapping,
    machine: ModelJoints,
    skip: int,
    delays: list[Lateness],
    noise: dict[str, Noise],
    findings: list[Finding],
) -> Import:
    step = skip * machine.timestep
    pieces: list[_Piece] = []
    left_out: list[LeftOut] = []
    rows: dict[str, dict[str, Any]] = {}
    items: list[str] = []
    action, places = _action(mapping, machine)
    for number_, (before, run) in enumerate(zip(raw, runs, strict=True)):
        own, without = whole_spans(run, run.series, step)
        left_out += without
        for span in own:
            names = [channel.name for channel in mapping.of("qpos")]
            states = {
                field: [
                    measured(s, span, machine.joints[name])
                    for name in names
                    if (s := run.of(field, name))
                ]
                for field in ("qpos", "qvel")
            }
            items, observations = observed(machine, names, states["qpos"], states["qvel"])
            pieces.append(
                _Piece(observations, _commands(run, span, step, mapping, places), span.at, number_)
            )
        kept = min((len(series.time) for series in run.series), default=0)
        longest = max((len(stamps.time) for stamps in before.stamps), default=0)
        rows[_unique(run, rows)] = {
            "log": str(run.path),
            "read": before.rows,
            "dropped": before.without_stamp + longest - kept,
            "resampled": sum(len(span.at) for span in own if span.resampled),
            "kept": sum(len(span.at) for span in own),
            "trajectories": len(own),
        }
    if not pieces:
        why = left_out[0].why if left_out else "too few rows"
        raise BadArgument(
            f"No run holds a trajectory: {why}. See `dropo data check LOG --map MAP --model MODEL`."
        )
    return Import(
        _arrays(pieces, mapping),
        items,
        action,
        skip,
        step,
        rows,
        [len(p.time) for p in pieces],
        delays,
        noise,
        left_out,
        findings,
        mapping.candidates,
    )


def _unique(run: Run, taken: dict[str, Any]) -> str:
    return (
        run.name
        if run.name not in taken
        else str(run.path)
        if str(run.path) not in taken
        else f"{run.path}: {run.name} ({len(taken)})"
    )


def _action(mapping: Mapping, machine: ModelJoints) -> tuple[list[str], list[str]]:
    """The items of an action row, and the actuators in their order; all of them, at zero, where no
    command is mapped.
    """
    names = {channel.name for channel in mapping.channels if channel.field == "ctrl"}
    ordered = [name for name in machine.actuators if name in names or not names]
    return (
        ["ctrl"]
        if len(ordered) == len(machine.actuators)
        else [f"ctrl[{machine.actuators[name].id}]" for name in ordered]
    ), ordered


def _commands(
    run: Run, span: Any, step: float, mapping: Mapping, names: list[str]
) -> dict[str, Array]:
    """The actions (n, q) of every candidate."""
    if not mapping.candidates:
        return {"": np.zeros((len(span.at), len(names)))}
    return {
        candidate: np.hstack(
            [commanded(s, span, step) for name in names if (s := run.of("ctrl", name, candidate))]
        )
        for candidate in mapping.candidates
    }


def _arrays(pieces: list[_Piece], mapping: Mapping) -> dict[str, Array]:
    """The arrays of data.npz; the first candidate's commands are the actions, and all candidates'
    stand beside them.
    """

    def joined(of: Callable[[_Piece], Array]) -> Array:
        return np.concatenate([of(piece) for piece in pieces])

    candidates = list(pieces[0].actions)
    arrays = {
        "observations": joined(lambda p: p.observations),
        "actions": joined(lambda p: p.actions[candidates[0]]),
        "terminals": joined(lambda p: np.arange(len(p.time)) == len(p.time) - 1),
        "time": joined(lambda p: p.time),
        "group": joined(lambda p: np.full(len(p.time), p.run)),
    }
    if len(candidates) > 1:
        arrays |= {
            f"actions.{name}": joined(lambda p, name=name: p.actions[name]) for name in candidates
        }  # type: ignore[misc]
    return arrays


def _check_place(out: Path) -> None:
    """Refuses a place that is no .npz file, and a problem file there that someone has worked on."""
    if out.suffix != ".npz":
        raise BadFile(out, "--out", "a file that ends in .npz", repr(out.suffix))
    problem = out.parent / PROBLEM
    if not problem.exists():
        return
    try:
        changed = bool(set(read_yaml(problem, "a problem file")) - set(OURS))
    except BadFile:
        changed = True
    if changed:
        expected = (
            "no file, or one that an import wrote, since this one would be lost (move it, or "
            "import into another folder)"
        )
        raise BadFile(problem, "", expected, "one that was changed")


def _write(found: Import, out: Path, model: Path, machine: ModelJoints) -> None:
    """The three files, each whole; none where one cannot be written."""
    out.parent.mkdir(parents=True, exist_ok=True)
    body, mass = machine.heaviest_body
    head = HEAD.format(record=RECORD, body=body, low=mass / 2, high=2 * mass)
    content = {
        "model": os.path.relpath(model, out.parent),
        "frame_skip": found.frame_skip,
        "data": out.name,
        "observation": found.observation,
        "action": found.action,
    }
    with ExitStack() as stack:
        names = (out.name, PROBLEM, RECORD)
        parts = [stack.enter_context(atomic_write(out.parent / name)) for name in names]
        write_npz(parts[0], found.arrays)
        write_text(parts[1], head + format_yaml(content))
        write_json(parts[2], found.to_json() | {"model": str(model)})
