"""Real tosses of an acrylic cube onto a board, tracked at 148 Hz.

Data: Pfrommer, Halm, Posa, "ContactNets", 2020; BSD-3.
"""

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np

from dropo.core.contracts.problem import Problem
from dropo.logs.signals.resampling import resample
from dropo.mjmodel.fields import FieldParameter
from dropo.mjmodel.joints import model_joints
from dropo.problems.measured.recordings import Channels, RecordedRuns, find_runs, measured
from dropo.simulators.mujoco.simulator import MujocoSimulator

HORIZON = 15  # control steps of 1/148 s: 101 ms
FIRST = 90
"""Tosses fitted of the 267 that are not held out, unless more transitions are asked for."""
WINDOWS = 144
"""Windows of a diagnosis; many, since motion after an impact differs much between windows."""
SETTINGS = {"family": "log_normal", "parameters": (), "windows": WINDOWS}
"""Settings of a fit and of a diagnosis, which is to find the contact's numbers itself."""
PARAMETERS = (
    FieldParameter("sliding_friction", 0.05, 1.0, field="geom_friction", element="box", index=0),
    FieldParameter("contact_time", 0.005, 0.08, "s", field="geom_solref", element="box", index=0),
    FieldParameter("contact_damping", 0.1, 2.0, field="geom_solref", element="box", index=1),
)


def cube_toss(threads: int = 0) -> Problem:
    """Sliding friction, contact time constant and damping ratio of a real cube on a board.

    Segments are 101 ms long.

    Parameters
    ----------
    threads : int
        Threads of the simulator; 0 for all cores.

    Returns
    -------
    Problem
        With the first tosses; all of them are `everything`.

    Raises
    ------
    BadFile
        If the external data are not found.
    """
    runs, model = find_runs("cube-toss", "model.xml", "the ContactNets cube tosses")
    simulator = MujocoSimulator(
        cube_spec(model), PARAMETERS, observation=["qpos", "qvel"], frame_skip=4, threads=threads
    )
    lag = model_joints(simulator.model).velocity_lag
    tosses = RecordedRuns(runs.names, tuple(toss(channels, lag) for channels in runs.channels))
    whole = measured("cube-toss", simulator, tosses, HORIZON)
    first = whole.trajectories.select(np.arange(FIRST))
    return replace(whole, trajectories=first, everything=whole.trajectories, settings=SETTINGS)


def cube_spec(path: Path) -> mujoco.MjSpec:
    """The model, in which the cube's numbers alone define its contact with the board.

    MuJoCo would else take the larger friction of the two.

    Parameters
    ----------
    path : Path
        Path of the MJCF file.

    Returns
    -------
    mujoco.MjSpec
    """
    spec = mujoco.MjSpec.from_file(str(path))
    spec.geom("box").priority = 1
    return spec


def toss(run: Channels, lag: float) -> Channels:
    """A toss whose velocities lag behind its positions as the model's own do.

    Parameters
    ----------
    run : mapping
        `time` (n,) [s], `qpos` (n, 7) and `qvel` (n, 6) of the cube's free joint.
    lag : float
        Delay of the model's velocities behind its positions [s].

    Returns
    -------
    mapping
        `time`, `qpos` and `velocity` of all rows but the last, which has none behind it.

    Notes
    -----
    The log's velocities are differences of the positions: each is the velocity in the middle of the
    step before its row, 3.4 ms late, so that a cube in free fall would be 33 mm/s too slow.
    """
    time = np.asarray(run["time"], dtype=float)
    positions = np.array(run["qpos"], dtype=float)
    velocities = np.asarray(run["qvel"], dtype=float)
    # Quaternions are stored as float32, so they are not of unit length.
    positions[:, 3:] /= np.linalg.norm(positions[:, 3:], axis=1, keepdims=True)
    middle = time - float(np.median(np.diff(time))) / 2
    return {
        "time": time[:-1],
        "qpos": positions[:-1],
        "velocity": resample(middle, velocities, time[:-1] - lag, method="linear"),
    }
