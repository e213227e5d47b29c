"""Logs of real machines as problems: runs on a grid of control steps, every third one held out."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.signal import savgol_filter

from dropo.core.contracts.problem import Problem
from dropo.core.records.trajectories import Trajectories
from dropo.core.services.validation import Array
from dropo.logs.grids import DEFAULTS, held_means
from dropo.logs.readers.archives import RunsLog
from dropo.logs.signals.resampling import resample
from dropo.logs.signals.stamps import increasing
from dropo.problems.measured.external_data import find_data, missing
from dropo.simulators.mujoco.simulator import MujocoSimulator

Channels = Mapping[str, Array]
"""The columns of a run by name, (n,) or (n, k), with its `time` (n,) [s].

`velocity` is that of the positions, where it was estimated before.
"""


@dataclass(frozen=True)
class RecordingSettings:
    """How runs become trajectories.

    Attributes
    ----------
    held_out_every : int
        Of so many runs, the last one is held out from the fit.
    filter_width : int
        Width of the filter that estimates velocities, in control steps.
    filter_order : int
        Order of its polynomial (Savitzky and Golay 1964).
    """

    held_out_every: int = 3
    filter_width: int = 5
    filter_order: int = 3


DEFAULT = RecordingSettings()


@dataclass(frozen=True, eq=False)
class RecordedRuns:
    """Runs of one machine, in the order of the archive.

    Attributes
    ----------
    names : tuple of str
        Name of each run.
    channels : tuple of mappings
        Columns of each run, by name.
    """

    names: tuple[str, ...]
    channels: tuple[Channels, ...]

    def named(self, beginning: str) -> "RecordedRuns":
        """Select the runs whose names begin alike.

        Parameters
        ----------
        beginning : str
            What the names begin with.

        Returns
        -------
        RecordedRuns
            In the same order; empty where there are none.
        """
        chosen = [i for i, name in enumerate(self.names) if name.startswith(beginning)]
        return RecordedRuns(
            tuple(self.names[i] for i in chosen), tuple(self.channels[i] for i in chosen)
        )


def find_runs(folder: str, model: str, source: str) -> tuple[RecordedRuns, Path]:
    """Read the runs of a machine among the external data.

    Parameters
    ----------
    folder : str
        Folder of the data, with a file `runs.npz`.
    model : str
        Name of the model's file beside it.
    source : str
        Whose data they are, in words, for a message.

    Returns
    -------
    runs : RecordedRuns
        The runs.
    model : Path
        Path of the model.

    Raises
    ------
    BadFile
        If one of the two files is not found, or the archive can not be read.
    """
    names = [f"{folder}/runs.npz", f"{folder}/{model}"]
    archive = find_data(names[0])
    if archive is None:
        raise missing(names[0], source)
    model_path = find_data(names[1])
    if model_path is None:
        raise missing(names[1], source)
    log = RunsLog(archive)
    return RecordedRuns(tuple(log.names), tuple(log.runs)), model_path


def gridded(
    run: Channels, step: float, command: str | None, settings: RecordingSettings = DEFAULT
) -> tuple[Array, Array, Array]:
    """A run resampled to one row a control step.

    Positions are resampled by Akima splines, unless their stamps are on the grid; so are velocities
    if the run has them, else a Savitzky-Golay filter over the positions estimates them, which is
    not causal. Commands, each held until the next, become means over the step. Rows whose stamps do
    not increase are left out.

    Parameters
    ----------
    run : mapping
        Columns `time`, `qpos`, perhaps `velocity`, and the command.
    step : float
        Duration of a control step [s].
    command : str or None
        Column of the commands; None if nothing is commanded.
    settings : RecordingSettings
        The filter for velocities.

    Returns
    -------
    time : (m,) array
        Seconds from the run's first row.
    observations : (m, 2 n) array
        Positions and velocities.
    actions : (m, q) array
        Commands, each held until the next row.
    """
    stamps = np.asarray(run["time"], dtype=float)
    keep = increasing(stamps)
    stamps = stamps[keep] - stamps[0]
    near = DEFAULTS.on_grid
    time = np.minimum(step * np.arange(int(stamps[-1] / step + near) + 1), stamps[-1])
    is_on_grid = len(time) == len(stamps) and bool(np.abs(time - stamps).max() < near * step)

    def resampled(name: str) -> Array:
        values = _columns(run[name])[keep]
        return values if is_on_grid else resample(stamps, values, time)

    positions = resampled("qpos")
    if "velocity" in run:
        velocities = resampled("velocity")
    else:
        velocities = savgol_filter(
            positions, settings.filter_width, settings.filter_order, deriv=1, delta=step, axis=0
        )
    if command is None:
        actions = np.zeros((len(time), 0))
    else:
        actions = held_means(stamps, _columns(run[command])[keep], time, step)
    return time, np.concatenate([positions, velocities], axis=1), actions


def _columns(values: Array) -> Array:
    """Values (n,) or (n, k) as floats (n, k)."""
    return np.asarray(values, dtype=float).reshape(len(values), -1)


def trajectories(
    runs: Sequence[Channels],
    step: float,
    command: str | None = None,
    settings: RecordingSettings = DEFAULT,
) -> Trajectories:
    """Runs as trajectories, each of which is a group of its own.

    Parameters
    ----------
    runs : sequence of mappings
        Columns of each run, as in `gridded`.
    step : float
        Duration of a control step [s].
    command : str or None
        Column of the commands; None if nothing is commanded.
    settings : RecordingSettings
        The filter for velocities.

    Returns
    -------
    Trajectories
        With the time of every row.
    """
    parts = [gridded(run, step, command, settings) for run in runs]
    lengths = [len(time) - 1 for time, _, _ in parts]
    return Trajectories(
        np.concatenate([rows[:-1] for _, rows, _ in parts]),
        np.concatenate([actions[:-1] for _, _, actions in parts]),
        np.concatenate([rows[1:] for _, rows, _ in parts]),
        np.concatenate([np.arange(n) == n - 1 for n in lengths]),
        group=np.repeat(np.arange(len(parts)), lengths),
        time=np.concatenate([time[:-1] for time, _, _ in parts]),
    )


def measured(
    name: str,
    simulator: MujocoSimulator,
    runs: RecordedRuns,
    horizon: int,
    command: str | None = None,
    settings: RecordingSettings = DEFAULT,
) -> Problem:
    """A problem on runs of a machine; every third run is held out, the others are fitted.

    Parameters
    ----------
    name : str
        Name of the problem.
    simulator : MujocoSimulator
        Observes positions and velocities.
    runs : RecordedRuns
        The runs.
    horizon : int
        Control steps of a segment.
    command : str or None
        Column of the commands; None if nothing is commanded.
    settings : RecordingSettings
        Which runs are held out, and the filter for velocities.

    Returns
    -------
    Problem
        Whose fit takes a log-normal family by default.
    """
    every = settings.held_out_every
    fitted: list[Channels] = []
    held_out: list[Channels] = []
    for i, run in enumerate(runs.channels):
        side = held_out if i % every == every - 1 else fitted
        side.append(run)
    step = simulator.control_step
    return Problem(
        name,
        simulator,
        trajectories(fitted, step, command, settings),
        horizon=horizon,
        held_out=trajectories(held_out, step, command, settings),
        settings={"family": "log_normal"},
    )
