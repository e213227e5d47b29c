"""Logs of real machines as problems: runs on the grid of control steps, and every third run kept
from the fit.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.signal import savgol_filter

from dropo.core.contracts.problem import Problem
from dropo.core.records.trajectories import Trajectories
from dropo.core.services.validation import Array
from dropo.logs.grids import ON_GRID, held_means
from dropo.logs.readers.archives import RunsLog
from dropo.logs.signals.resampling import resample
from dropo.logs.signals.stamps import increasing
from dropo.problems.measured.external_data import find_data, missing
from dropo.simulators.mujoco.simulator import MujocoSimulator

HELD_OUT = 3  # every third run is kept from the fit
# of the velocities' smoothing: control steps, and the polynomial (Savitzky and Golay 1964)
WIDTH = 5
ORDER = 3

Channels = Mapping[str, Array]
"""The columns of a run by name, (n,) or (n, k), with its `time` (n,) [s].

`velocity`: of the positions, where it was estimated before.
"""


@dataclass(frozen=True, eq=False)
class Runs:
    """Runs of one machine, by name, in the order of the archive."""

    names: tuple[str, ...]
    channels: tuple[Channels, ...]

    def named(self, beginning: str) -> "Runs":
        """Those whose names begin so."""
        which = [i for i, name in enumerate(self.names) if name.startswith(beginning)]
        return Runs(tuple(self.names[i] for i in which), tuple(self.channels[i] for i in which))


def find_runs(folder: str, model: str, source: str) -> tuple[Runs, Path]:
    """The runs in <folder>/runs.npz among the outside data, and the path of a model beside it."""
    files = [f"{folder}/runs.npz", f"{folder}/{model}"]
    paths = [find_data(name) for name in files]
    if paths[0] is None or paths[1] is None:
        raise missing(files[paths.index(None)], source)
    log = RunsLog(paths[0])
    return Runs(tuple(log.names), tuple(log.runs)), paths[1]


def gridded(run: Channels, step: float, command: str | None) -> tuple[Array, Array, Array]:
    """A run every `step` seconds: time (m,), observations (m, 2 n) and actions (m, q) of which each
    holds until the next row.

    Positions by Akima splines, unless their stamps are on the grid; velocities likewise where the
    run has them, else by a Savitzky-Golay filter over the positions, which is not causal; commands,
    each held until the next, as means over the step. Stamps that do not increase are left out.
    """
    stamps = np.asarray(run["time"], dtype=float)
    keep = increasing(stamps)
    stamps = stamps[keep] - stamps[0]
    time = np.minimum(step * np.arange(int(stamps[-1] / step + ON_GRID) + 1), stamps[-1])
    there = len(time) == len(stamps) and bool(np.abs(time - stamps).max() < ON_GRID * step)

    def on_grid(name: str) -> Array:
        values = _columns(run[name])[keep]
        return values if there else resample(stamps, values, time)

    positions = on_grid("qpos")
    velocities = (
        on_grid("velocity")
        if "velocity" in run
        else savgol_filter(positions, WIDTH, ORDER, deriv=1, delta=step, axis=0)
    )
    actions = (
        np.zeros((len(time), 0))
        if command is None
        else held_means(stamps, _columns(run[command])[keep], time, step)
    )
    return time, np.concatenate([positions, velocities], axis=1), actions


def _columns(values: Array) -> Array:
    return np.asarray(values, dtype=float).reshape(len(values), -1)


def trajectories(runs: Sequence[Channels], step: float, command: str | None = None) -> Trajectories:
    """One trajectory a run, which is its group too."""
    parts = [gridded(run, step, command) for run in runs]
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
    name: str, simulator: MujocoSimulator, runs: Runs, horizon: int, command: str | None = None
) -> Problem:
    """A problem of which every third run judges and the others fit, over horizons of so many
    control steps.
    """
    kept_back = np.arange(len(runs.names)) % HELD_OUT == HELD_OUT - 1
    fitted, held_out = (
        trajectories(
            [run for run, back in zip(runs.channels, kept_back, strict=True) if back == side],
            simulator.control_step,
            command,
        )
        for side in (False, True)
    )
    return Problem(
        name,
        simulator,
        fitted,
        length=horizon,
        held_out=held_out,
        settings={"family": "log_normal"},
    )
