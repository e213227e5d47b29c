"""Raw logs to data that a fit takes: checked, aligned, and resampled on the model's control step.

In reading order: `import_logs` calls `prepare`, which does the work step by step, and writes the
three files; `_gather` cuts the runs into trajectories, and `_join_arrays` makes the arrays of
data.npz of them.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dropo._version import __version__
from dropo.core.services.errors import BadArgument
from dropo.core.services.files.places import way_to
from dropo.core.services.tables import Report, Table, number
from dropo.core.services.validation import Array
from dropo.data.checks.findings import Finding, errors_first
from dropo.data.reading import RUN_NAMES
from dropo.logs.floating_base import add_base
from dropo.logs.grids import (
    GridSettings,
    GridSpan,
    UnusedSpan,
    join_observations,
    observation_items,
    sample_command,
    sample_state,
    steps_per_action,
    whole_spans,
)
from dropo.logs.guessing.check import check_logs
from dropo.logs.import_files import RECORD, check_place, write_import
from dropo.logs.log_checks import LogCheckSettings
from dropo.logs.mapping import Mapping as LogMapping
from dropo.logs.mapping import read_mapping
from dropo.logs.preparing import LoggedNoiseSettings, SignalNoise, add_velocities, clean_run
from dropo.logs.readers.reader import Progress
from dropo.logs.recordings import LogReadingSettings, LogRun, read_runs
from dropo.logs.signals.base_motion import BaseMotionSettings
from dropo.logs.signals.clocks import AlignmentSettings, SignalDelay, align_runs
from dropo.mjmodel.joints import ModelJoints, load_model_joints

SHOWN = 20
"""Excluded spans that are printed."""


@dataclass(frozen=True)
class ImportSettings:
    """How logs are imported.

    Attributes
    ----------
    rate_error : float
        How far a rate that the mapping gives may be from one of whole physics steps, as a fraction.
    log_error : float
        How far the log's own rate may be from one without a warning, as a fraction.
    noisier : float
        A logged velocity is called worse where its noise is so many times that of a smoothed one.
    checks : LogCheckSettings
        What makes a raw log look odd.
    alignment : AlignmentSettings
        How delays are estimated and removed.
    noise : LoggedNoiseSettings
        From how much of a log noise levels are estimated.
    recordings : LogReadingSettings
        How stamps of logs are read.
    grid : GridSettings
        How recordings are put on the grid of control steps.
    base : BaseMotionSettings
        How the motion of a base that was not logged is estimated.
    """

    rate_error: float = 0.05
    log_error: float = 0.005
    noisier: float = 2.0
    checks: LogCheckSettings = field(default_factory=LogCheckSettings)
    alignment: AlignmentSettings = field(default_factory=AlignmentSettings)
    noise: LoggedNoiseSettings = field(default_factory=LoggedNoiseSettings)
    recordings: LogReadingSettings = field(default_factory=LogReadingSettings)
    grid: GridSettings = field(default_factory=GridSettings)
    base: BaseMotionSettings = field(default_factory=BaseMotionSettings)


DEFAULTS = ImportSettings()


@dataclass(frozen=True, eq=False, repr=False)
class Import(Report):
    """What an import made of the logs: the arrays of data.npz, and all that import.json says.

    Attributes
    ----------
    arrays : dict
        The arrays of data.npz.
    observation, action : list of str
        The items of an observation and of an action, as a problem file names them.
    frame_skip : int
        Physics steps in a control step.
    control_step : float
        The same in seconds.
    rows : dict
        By run how many rows were "read", "dropped", "resampled" and "kept", its "trajectories" and
        the "log".
    trajectories : list of int
        Rows of each trajectory.
    delays : list of SignalDelay
        All that were found, removed or not.
    noise : dict
        `SignalNoise` by signal.
    left_out : list of UnusedSpan
        What is in no trajectory, and why.
    findings : list of Finding
        What looked odd in the raw logs.
    inputs : tuple of str
        The candidates of the commands.
    notes : tuple of str
        What was chosen, and why.
    """

    arrays: dict[str, NDArray[Any]]
    observation: list[str]
    action: list[str]
    frame_skip: int
    control_step: float
    rows: dict[str, dict[str, Any]]
    trajectories: list[int]
    delays: list[SignalDelay]
    noise: dict[str, SignalNoise]
    left_out: list[UnusedSpan]
    findings: list[Finding]
    inputs: tuple[str, ...]
    notes: tuple[str, ...] = ()

    def to_json(self) -> dict[str, Any]:
        """Give the content of import.json.

        Returns
        -------
        dict
            As import.json has it.
        """
        left_out = []
        for span in self.left_out:
            left_out.append(
                {"run": span.run, "from_s": span.start, "to_s": span.stop, "why": span.why}
            )
        return {
            "version": __version__,
            "frame_skip": self.frame_skip,
            "control_step_s": self.control_step,
            "runs": {name: dict(rows) for name, rows in self.rows.items()},
            "trajectories": self.trajectories,
            "inputs": list(self.inputs),
            "delays": [asdict(delay) for delay in self.delays],
            "noise": {name: asdict(noise) for name, noise in self.noise.items()},
            "left_out": left_out,
            "findings": [asdict(finding) for finding in self.findings],
            "notes": list(self.notes),
        }

    def parts(self) -> list[str | Table]:
        """Give the counts, a table of the noise, delays, excluded spans, and findings."""
        parts: list[str | Table] = [self._counts(), self._noise_table(), *self.notes]
        # delays
        removed = [str(delay) for delay in self.delays if delay.removed]
        parts += removed
        small = len(self.delays) - len(removed)
        if small:
            parts.append(f"Delays too small to tell, and left: {small} (see {RECORD}).")
        # excluded spans
        for span in self.left_out[:SHOWN]:
            parts.append(
                f"left out: {span.run}, {span.start:.6g} s to {span.stop:.6g} s: {span.why}"
            )
        if len(self.left_out) > SHOWN:
            parts.append(f"... and {len(self.left_out) - SHOWN} more spans left out")
        return parts + [str(finding) for finding in self.findings]

    def _counts(self) -> str:
        """How many rows there are, and how many were dropped or resampled."""
        totals = {}
        for key in ("read", "resampled", "dropped"):
            totals[key] = sum(run[key] for run in self.rows.values())
        return (
            f"{len(self.arrays['observations'])} rows in {len(self.trajectories)} trajectories of "
            f"{len(self.rows)} runs, every {1e3 * self.control_step:.6g} ms ({self.frame_skip} "
            f"physics steps); of {totals['read']} rows read, {totals['dropped']} were dropped; "
            f"{totals['resampled']} rows are resampled."
        )

    def _noise_table(self) -> Table:
        """The noise level of every signal."""
        rows = []
        for name, noise in self.noise.items():
            sd = "-" if noise.sd is None else number(noise.sd)
            rows.append((name, noise.unit, sd, "estimated" if noise.estimated else "logged"))
        return Table("", ("signal", "unit", "noise sd", ""), tuple(rows))


def ignore_progress(fraction: float, text: str) -> None:
    """Report no progress.

    Parameters
    ----------
    fraction : float
        How much of the work is done.
    text : str
        What is being done.
    """


def import_logs(
    logs: str | Path | Sequence[str | Path],
    mapping: str | Path,
    model: str | Path,
    out: str | Path,
    *,
    progress: Progress = ignore_progress,
    settings: ImportSettings = DEFAULTS,
) -> Import:
    """Turn raw logs into data, and write these with problem.yaml and import.json beside them.

    Parameters
    ----------
    logs : str, Path, or sequence of them
        Files or folders, of which each is a recording or holds several runs.
    mapping : str or Path
        The YAML file that says which column is which joint or actuator.
    model : str or Path
        The MJCF file.
    out : str or Path
        The data file, .npz.
    progress : callable
        Called while it works, with the fraction of the work that is done and what is being done.
    settings : ImportSettings, optional
        How logs are checked and aligned.

    Returns
    -------
    Import
        What was written.

    Raises
    ------
    BadFile
        If the data cannot be written there, a problem file there was changed by someone, or a log,
        the mapping or the model cannot be read. Nothing is written.
    BadArgument
        If a check finds an error in a log, or no run holds a trajectory. Nothing is written.
    """
    place = Path(out)
    check_place(place)
    paths = [logs] if isinstance(logs, str | Path) else logs
    robot = load_model_joints(model)
    found = prepare(paths, read_mapping(mapping, robot), robot, progress, settings)
    where = way_to(model, place.parent)
    write_import(found, place, where, robot, "data import", {"model": where})
    return found


def prepare(
    logs: Sequence[str | Path],
    mapping: LogMapping,
    robot: ModelJoints,
    progress: Progress = ignore_progress,
    settings: ImportSettings = DEFAULTS,
) -> Import:
    """Turn raw logs into data without writing them.

    Parameters
    ----------
    logs : sequence of str or Path
        Files or folders.
    mapping : Mapping
        Which column is what.
    robot : ModelJoints
        The joints and actuators of the model.
    progress : callable
        As of `import_logs`.
    settings : ImportSettings, optional
        How logs are checked and aligned.

    Returns
    -------
    Import
        What `import_logs` writes.

    Raises
    ------
    BadFile
        If a log cannot be read, or the mapping's rate is not one of whole physics steps.
    BadArgument
        If a check finds an error in a log, or no run holds a trajectory.
    """
    # read and check
    raw = read_runs(
        logs, mapping, lambda fraction, text: progress(0.5 * fraction, text), settings.recordings
    )
    findings = check_logs(logs, raw, mapping, robot, settings.checks)
    for finding in findings:
        if finding.level == "error":
            named = ", ".join(map(str, logs))
            raise BadArgument(f"{named}: {str(finding).removeprefix('error: ')}")
    # bring all stamps to one clock
    progress(0.5, "aligning")
    clean = [clean_run(run, robot) for run in raw]
    runs, delays = align_runs(clean, robot, settings.alignment)
    skip, error = steps_per_action(runs, robot.timestep, mapping.rate)
    if mapping.rate is not None and abs(error) > settings.rate_error:
        near = 1 / (skip * robot.timestep)
        expected = (
            "a rate whose control step is a whole number of physics steps of "
            f"{robot.timestep:g} s, such as {near:.6g} Hz"
        )
        raise mapping.refusal("rate", expected, f"{mapping.rate:g}")
    # estimate what was not logged, and cut into trajectories
    progress(0.7, "velocities")
    if mapping.rate is None and abs(error) > settings.log_error:
        findings = errors_first([*findings, _rate_warning(runs, robot, skip, error)])
    runs, noise = add_velocities(runs, robot, settings.noise)
    worse = worse_velocities(noise, settings)
    with_base = add_base(runs, robot, noise, settings.base)
    findings = errors_first([*findings, *with_base.findings])
    runs = with_base.runs
    progress(0.9, "resampling")
    gathered = _gather(raw, runs, mapping, robot, skip, settings.grid)
    positions = _positions(runs[0])
    sensors = _sensor_names(mapping, robot)
    action, _ = _action_items(mapping, robot)
    return Import(
        arrays=_join_arrays(gathered.pieces, list(gathered.rows)),
        observation=observation_items(robot, positions, sensors),
        action=action,
        frame_skip=skip,
        control_step=skip * robot.timestep,
        rows=gathered.rows,
        trajectories=[len(piece.time) for piece in gathered.pieces],
        delays=delays,
        noise={**noise, **with_base.noise},
        left_out=gathered.excluded,
        findings=findings,
        inputs=mapping.candidates,
        notes=(*_velocity_notes(noise, worse), *with_base.notes),
    )


def _rate_warning(runs: Sequence[LogRun], robot: ModelJoints, skip: int, error: float) -> Finding:
    """That the log's rows are resampled, and the time step with which they are not."""
    wanted = (1 + error) * skip * robot.timestep
    step = _plain_step(wanted, robot.timestep)
    text = (
        f"a row every {1e3 * wanted:.5g} ms is no whole number of the model's physics steps of "
        f"{1e3 * robot.timestep:g} ms: all rows are resampled on {1e3 * skip * robot.timestep:.5g} "
        "ms."
    )
    return Finding("warning", "time", text, f'`<option timestep="{step:.6g}"/>` avoids it.')


def _plain_step(wanted: float, longest: float) -> float:
    """The part of a control step that has the fewest digits, of the first few not above another."""
    first = max(1, math.ceil(wanted / longest - 1e-3))
    parts = [wanted / count for count in range(first, first + 4)]
    return min(parts, key=lambda step: len(f"{step:.6g}"))


def worse_velocities(
    noise: Mapping[str, SignalNoise], settings: ImportSettings = DEFAULTS
) -> tuple[str, ...]:
    """List the joints whose logged velocity is noisier than one smoothed from the positions.

    Parameters
    ----------
    noise : mapping
        `SignalNoise` by signal.
    settings : ImportSettings, optional
        How much noisier.

    Returns
    -------
    tuple of str
    """
    worse = []
    for name, one in noise.items():
        if one.sd is None or one.smoothed is None or not name.startswith("qvel."):
            continue
        if one.sd > settings.noisier * one.smoothed:
            worse.append(name.removeprefix("qvel."))
    return tuple(worse)


def _velocity_notes(noise: dict[str, SignalNoise], worse: tuple[str, ...]) -> tuple[str, ...]:
    """Which velocities were taken, and why."""
    logged = [name for name, one in noise.items() if one.smoothed is not None]
    estimated = [name for name, one in noise.items() if one.estimated]
    notes = []
    if estimated and not logged:
        notes.append("Velocities are smoothed from the positions: none is mapped.")
    if logged:
        name = f"qvel.{worse[0]}" if worse else logged[0]
        one = noise[name]
        compared = (
            f"{name} has a noise of {number(one.sd or 0.0)} {one.unit}, smoothed from its "
            f"positions it would have {number(one.smoothed or 0.0)}"
        )
        advice = (
            f"; leave {', '.join(worse)} out under `qvel` to have them smoothed" if worse else ""
        )
        notes.append(f"Velocities are those of the log: {compared}{advice}.")
    return tuple(notes)


# Trajectories


@dataclass(frozen=True, eq=False)
class _Piece:
    """One trajectory: observations (n, p), the actions (n, q) of every candidate, stamps (n,)."""

    observations: Array
    actions: dict[str, Array]
    time: Array
    run: int


@dataclass(frozen=True, eq=False)
class _Gathered:
    """The trajectories of all runs, counts by run, and what is in no trajectory."""

    pieces: list[_Piece]
    rows: dict[str, dict[str, Any]]
    excluded: list[UnusedSpan]


def _gather(
    raw: Sequence[LogRun],
    runs: Sequence[LogRun],
    mapping: LogMapping,
    robot: ModelJoints,
    skip: int,
    settings: GridSettings,
) -> _Gathered:
    """Cut the runs, of which `raw` are those that were read, into trajectories on the grid."""
    step = skip * robot.timestep
    gathered = _Gathered([], {}, [])
    _, actuators = _action_items(mapping, robot)
    for i, (logged, run) in enumerate(zip(raw, runs, strict=True)):
        spans, excluded = whole_spans(run, run.series, step, settings)
        gathered.excluded.extend(excluded)
        for span in spans:
            observations = _observations(run, span, mapping, robot)
            actions = _commands(run, span, step, mapping, actuators, settings)
            gathered.pieces.append(_Piece(observations, actions, span.at, i))
        gathered.rows[_unique_name(run, gathered.rows)] = _count_rows(logged, run, spans)
    if not gathered.pieces:
        why = gathered.excluded[0].why if gathered.excluded else "too few rows"
        raise BadArgument(
            f"No run holds a trajectory: {why}. See `dropo data check LOG --map MAP --model MODEL`."
        )
    return gathered


def _count_rows(logged: LogRun, run: LogRun, spans: Sequence[GridSpan]) -> dict[str, Any]:
    """What import.json says of the rows of a run, before and after it was prepared."""
    measured = {series.label for series in logged.series}
    dropped = logged.without_stamp
    for source in dict.fromkeys(series.channel.source for series in logged.series):
        before = [len(one.time) for one in logged.series if one.channel.source == source]
        after = [len(one.time) for one in run.series if one.channel.source == source]
        dropped += max(before) - min(after)
    return {
        "log": str(run.path),
        "read": logged.rows,
        "dropped": dropped,
        "resampled": sum(len(span.at) for span in spans if span.resampled & measured),
        "kept": sum(len(span.at) for span in spans),
        "trajectories": len(spans),
    }


def _unique_name(run: LogRun, taken: dict[str, Any]) -> str:
    """The name of a run, or what tells it apart from others of that name."""
    if run.name not in taken:
        return run.name
    if str(run.path) not in taken:
        return str(run.path)
    return f"{run.path}: {run.name} ({len(taken)})"


def _positions(run: LogRun) -> list[str]:
    """The joints whose positions a run has."""
    return [one.channel.name for one in run.series if one.channel.field == "qpos"]


def _observations(run: LogRun, span: GridSpan, mapping: LogMapping, robot: ModelJoints) -> Array:
    """The observations (n, p) of a span."""
    names = _positions(run)
    positions = _sample_states("qpos", names, run, span, robot)
    velocities = _sample_states("qvel", names, run, span, robot)
    states = join_observations(robot, names, positions, velocities)
    return np.hstack([states, *_sample_sensors(run, span, mapping, robot)])


def _sample_sensors(
    run: LogRun, span: GridSpan, mapping: LogMapping, robot: ModelJoints
) -> list[Array]:
    """What the sensors show (n, k) in a span."""
    found = []
    for name in _sensor_names(mapping, robot):
        series = run.of("sensordata", name)
        if series is not None:
            whole = slice(0, 4) if robot.sensors[name].is_rotation else None
            found.append(sample_state(series, span, whole))
    return found


def _sensor_names(mapping: LogMapping, robot: ModelJoints) -> list[str]:
    """The sensors that are mapped, in the model's order."""
    mapped = {channel.name for channel in mapping.of("sensordata")}
    return [name for name in robot.sensors if name in mapped]


def _sample_states(
    quantity: str, names: list[str], run: LogRun, span: GridSpan, robot: ModelJoints
) -> list[Array]:
    """The positions or velocities (n, k) of joints in a span."""
    states = []
    for name in names:
        series = run.of(quantity, name)
        if series is not None:
            rotation = robot.joints[name].quaternion() if quantity == "qpos" else None
            states.append(sample_state(series, span, rotation))
    return states


def _action_items(mapping: LogMapping, robot: ModelJoints) -> tuple[list[str], list[str]]:
    """The items of an action, and the actuators in their order.

    These are all actuators, at zero, where no command is mapped.
    """
    names = {channel.name for channel in mapping.channels if channel.field == "ctrl"}
    ordered = [name for name in robot.actuators if name in names or not names]
    if len(ordered) == len(robot.actuators):
        return ["ctrl"], ordered
    return [f"ctrl[{robot.actuators[name].id}]" for name in ordered], ordered


def _commands(
    run: LogRun,
    span: GridSpan,
    step: float,
    mapping: LogMapping,
    actuators: list[str],
    settings: GridSettings,
) -> dict[str, Array]:
    """The actions (n, q) of every candidate in a span."""
    if not mapping.candidates:
        return {"": np.zeros((len(span.at), len(actuators)))}
    actions = {}
    for candidate in mapping.candidates:
        columns = []
        for name in actuators:
            series = run.of("ctrl", name, candidate)
            if series is not None:
                columns.append(sample_command(series, span, step, settings))
        actions[candidate] = np.hstack(columns)
    return actions


def _join_arrays(pieces: list[_Piece], runs: list[str]) -> dict[str, NDArray[Any]]:
    """The arrays of data.npz, with the names of the runs.

    The first candidate's commands are the actions, and those of all stand beside them.
    """
    candidates = list(pieces[0].actions)
    lengths = [len(piece.time) for piece in pieces]
    arrays: dict[str, NDArray[Any]] = {
        "observations": np.concatenate([piece.observations for piece in pieces]),
        "actions": np.concatenate([piece.actions[candidates[0]] for piece in pieces]),
        "terminals": np.concatenate([np.arange(n) == n - 1 for n in lengths]),
        "time": np.concatenate([piece.time for piece in pieces]),
        "group": np.repeat([piece.run for piece in pieces], lengths),
        RUN_NAMES: np.array(runs),
    }
    if len(candidates) > 1:
        for name in candidates:
            arrays[f"actions.{name}"] = np.concatenate([piece.actions[name] for piece in pieces])
    return arrays
