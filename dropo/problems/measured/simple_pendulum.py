"""A real pendulum on a quasi-direct drive.

Data: Wiebe et al., torque-limited simple pendulum, JOSS 7, 2022; DFKI; BSD-3.
"""

import mujoco
import numpy as np

from dropo.core.contracts.problem import Problem
from dropo.logs.signals.stamps import increasing
from dropo.logs.signals.velocities import estimate_velocities
from dropo.mjmodel.fields import FieldParameter
from dropo.problems.measured.recordings import Channels, RecordedRuns, find_runs, measured
from dropo.simulators.mujoco.simulator import MujocoSimulator

TIMESTEP = 1e-2
"""[s] of a Runge-Kutta step, whose error is below 1e-3 rad after 500 ms."""
FRAME_SKIP = 2  # Runge-Kutta steps in a control step of 20 ms
HORIZON = 25  # control steps: 500 ms
COMMANDS = {"commanded": "ctrl", "current": "tau"}
"""Input -> its column, torques; the commands of one run lack its feedback."""
PARAMETERS = (
    FieldParameter("mass", 0.2, 1.5, "kg", field="body_mass", element="link"),
    FieldParameter("inertia", 1e-6, 0.05, "kg m^2", field="body_inertia", element="link", index=1),
)


def simple_pendulum(threads: int = 0, input: str = "current") -> Problem:
    """Mass and inertia of a pendulum from runs under different controllers.

    Segments are 500 ms long. In some spans the pendulum is pushed by hand. Positions and velocities
    are smoothed over each whole log, since the drive's own velocities are rough and have outliers.

    Parameters
    ----------
    threads : int
        Threads of the simulator; 0 for all cores.
    input : str
        What is taken as the command: "commanded" or "current", the torque by the motor's current.

    Returns
    -------
    Problem

    Raises
    ------
    BadFile
        If the external data are not found.
    """
    runs, model = find_runs("simple-pendulum", "model.xml", "the DFKI simple pendulum")
    spec = mujoco.MjSpec.from_file(str(model))
    spec.option.timestep = TIMESTEP
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_RK4
    simulator = MujocoSimulator(
        spec, PARAMETERS, observation=["qpos", "qvel"], frame_skip=FRAME_SKIP, threads=threads
    )
    smoothed = RecordedRuns(runs.names, tuple(_smoothed(channels) for channels in runs.channels))
    return measured("simple-pendulum", simulator, smoothed, HORIZON, COMMANDS[input])


def _smoothed(run: Channels) -> Channels:
    keep = increasing(np.asarray(run["time"], dtype=float))
    found = estimate_velocities(run["time"][keep], run["qpos"][keep].reshape(-1, 1))
    commands = {column: run[column][keep] for column in COMMANDS.values()}
    return {
        "time": run["time"][keep],
        **commands,
        "qpos": found.positions,
        "velocity": found.velocities,
    }
