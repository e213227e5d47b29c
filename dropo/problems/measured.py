"""Logs of real machines as problems: runs on the grid of control steps, and every third run kept from the fit."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.signal import savgol_filter

from dropo.core.checks import Array
from dropo.core.data import Trajectories
from dropo.core.problem import Problem
from dropo.data.resampling import resample
from dropo.data.stamps import going_on
from dropo.problems.outside import find_data, missing
from dropo.simulators.mujoco import MujocoSimulator

HELD_OUT = 3  # every third run is kept from the fit
WIDTH, ORDER = 5, 3  # of the velocities' smoothing: control steps, and the polynomial (Savitzky and Golay 1964)

Channels = Mapping[str, Array]
"""The columns of a run by name, (n,) or (n, k), with its `time` (n,) [s]."""


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
    return read_archive(paths[0]), paths[1]


def read_archive(path: Path) -> Runs:
    """An archive with `names` (n,) and, for run i, the arrays "{i:03d}/<channel>"."""
    with np.load(path, allow_pickle=False) as kept:
        arrays: dict[str, Any] = {name: kept[name] for name in kept.files}
    names = tuple(str(name) for name in arrays["names"])
    of = [f"{i:03d}/" for i in range(len(names))]
    runs = [{key.removeprefix(start): value for key, value in arrays.items() if key.startswith(start)} for start in of]
    return Runs(names, tuple(runs))


def gridded(run: Channels, step: float, command: str | None) -> tuple[Array, Array, Array]:
    """A run every `step` seconds: time (m,), observations (m, 2 n) and actions (m, q) of which each holds until the next row.

    Positions by Akima splines; velocities by a Savitzky-Golay filter over them, which is not causal; commands, each held until
    the next, as means over the step. Stamps that do not increase are left out.
    """
    stamps = np.asarray(run["time"], dtype=float)
    keep = going_on(stamps)
    stamps = stamps[keep] - stamps[0]
    time = np.asarray(step * np.arange(int(stamps[-1] / step) + 1), dtype=float)
    positions = resample(stamps, _columns(run["qpos"])[keep], time)
    velocities: Array = savgol_filter(positions, WIDTH, ORDER, deriv=1, delta=step, axis=0)
    actions = np.zeros((len(time), 0)) if command is None else _means(stamps, _columns(run[command])[keep], time, step)
    return time, np.concatenate([positions, velocities], axis=1), actions


def _columns(values: Array) -> Array:
    return np.asarray(values, dtype=float).reshape(len(values), -1)


def _means(stamps: Array, values: Array, time: Array, step: float) -> Array:
    """(m, q) the means over [t, t + step] of values that are held from each stamp to the next."""
    done = np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(values[:-1] * np.diff(stamps)[:, None], axis=0)])
    edges = np.minimum(np.append(time, time[-1] + step), stamps[-1])
    integral = np.stack([np.interp(edges, stamps, column) for column in done.T], axis=1)
    return np.asarray(np.diff(integral, axis=0) / np.maximum(np.diff(edges), 1e-12)[:, None])


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


def measured(name: str, simulator: MujocoSimulator, runs: Runs, horizon: int, command: str | None = None) -> Problem:
    """A problem of which every third run judges and the others fit, over horizons of so many control steps."""
    kept_back = np.arange(len(runs.names)) % HELD_OUT == HELD_OUT - 1
    fitted, held_out = (
        trajectories([run for run, back in zip(runs.channels, kept_back, strict=True) if back == side], simulator.control_step, command)
        for side in (False, True)
    )
    return Problem(name, simulator, fitted, length=horizon, held_out=held_out, settings={"family": "log_normal"})
