"""A real pendulum on a quasi-direct drive (Wiebe et al. 2022, JOSS 7, torque-limited simple
pendulum; DFKI; BSD-3).
"""

import mujoco
import numpy as np

from dropo.core.contracts.problem import Problem
from dropo.logs.signals.stamps import increasing
from dropo.logs.signals.velocities import estimate_velocities
from dropo.mjmodel.fields import FieldParameter
from dropo.problems.measured.recordings import Channels, Runs, find_runs, measured
from dropo.simulators.mujoco.simulator import MujocoSimulator

# [s] of a Runge-Kutta step, wrong by less than 1e-3 rad after 500 ms; in a control step of 20 ms:
# two
TIMESTEP = 1e-2
FRAME_SKIP = 2
HORIZON = 25  # control steps: 500 ms
COMMANDS = {
    "commanded": "ctrl",
    "current": "tau",
}  # torques; the commands of one run lack its feedback
PARAMETERS = (
    FieldParameter("mass", 0.2, 1.5, "kg", field="body_mass", element="link"),
    FieldParameter("inertia", 1e-6, 0.05, "kg m^2", field="body_inertia", element="link", index=1),
)


def simple_pendulum(threads: int = 0, input: str = "current") -> Problem:
    """Mass and inertia of a pendulum from runs under different controllers, over horizons of 500
    ms. In some spans it is pushed.

    Positions and velocities by a smoother over each whole log: the drive's own velocities are
    rough, and at times wild.
    """
    runs, model = find_runs("simple-pendulum", "model.xml", "the DFKI simple pendulum")
    spec = mujoco.MjSpec.from_file(str(model))
    spec.option.timestep = TIMESTEP
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_RK4
    simulator = MujocoSimulator(
        spec, PARAMETERS, observation=["qpos", "qvel"], frame_skip=FRAME_SKIP, threads=threads
    )
    return measured(
        "simple-pendulum",
        simulator,
        Runs(runs.names, tuple(map(_smoothed, runs.channels))),
        HORIZON,
        COMMANDS[input],
    )


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
