"""Real tosses of an acrylic cube onto a board, tracked at 148 Hz (Pfrommer, Halm, Posa 2020,
ContactNets; BSD-3).
"""

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np

from dropo.core.contracts.problem import Problem
from dropo.logs.signals.resampling import resample
from dropo.mjmodel.fields import FieldParameter
from dropo.mjmodel.joints import model_joints
from dropo.problems.measured.recordings import Channels, Runs, find_runs, measured
from dropo.simulators.mujoco.simulator import MujocoSimulator

HORIZON = 15  # control steps of 1/148 s: 101 ms
FIRST = 90  # tosses fitted, of the 267 that are not held out, unless more transitions are asked for
WINDOWS = 144  # of a diagnosis: what follows an impact differs much from window to window
SETTINGS = {
    "family": "log_normal",
    "parameters": (),
    "windows": WINDOWS,
}  # a diagnosis is to find the contact's numbers itself
PARAMETERS = (
    FieldParameter("sliding_friction", 0.05, 1.0, field="geom_friction", element="box", index=0),
    FieldParameter("contact_time", 0.005, 0.08, "s", field="geom_solref", element="box", index=0),
    FieldParameter("contact_damping", 0.1, 2.0, field="geom_solref", element="box", index=1),
)


def cube_toss(threads: int = 0) -> Problem:
    """Sliding friction, contact time constant and damping ratio of a real cube on a board, over
    horizons of 101 ms.
    """
    runs, model = find_runs("cube-toss", "model.xml", "the ContactNets cube tosses")
    simulator = MujocoSimulator(
        cube_spec(model), PARAMETERS, observation=["qpos", "qvel"], frame_skip=4, threads=threads
    )
    lag = model_joints(simulator.model).velocity_lag
    tosses = Runs(runs.names, tuple(toss(run, lag) for run in runs.channels))
    whole = measured("cube-toss", simulator, tosses, HORIZON)
    first = whole.trajectories.select(np.arange(FIRST))
    return replace(whole, trajectories=first, everything=whole.trajectories, settings=SETTINGS)


def cube_spec(path: Path) -> mujoco.MjSpec:
    """The cube's numbers rule its contact with the board: MuJoCo would take the larger friction of
    the two.
    """
    spec = mujoco.MjSpec.from_file(str(path))
    spec.geom("box").priority = 1
    return spec


def toss(run: Channels, lag: float) -> Channels:
    """A toss whose velocities (of the free joint, 6) are `lag` [s] behind its positions (7), as the
    model's own are.

    The log's are differences of the positions: each is the velocity in the middle of the step
    before its row, 3.4 ms late, by which a cube in free fall would be 33 mm/s too slow. The last
    row, behind which there is none, is left out.
    """
    time = np.asarray(run["time"], dtype=float)
    positions, velocities = (np.asarray(run[name], dtype=float) for name in ("qpos", "qvel"))
    positions[:, 3:] /= np.linalg.norm(positions[:, 3:], axis=1, keepdims=True)  # stored as float32
    middle = time - float(np.median(np.diff(time))) / 2
    return {
        "time": time[:-1],
        "qpos": positions[:-1],
        "velocity": resample(middle, velocities, time[:-1] - lag, method="linear"),
    }
