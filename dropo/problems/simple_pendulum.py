"""A real pendulum on a quasi-direct drive (Wiebe et al. 2022, JOSS 7, torque-limited simple pendulum; DFKI; BSD-3)."""

import mujoco

from dropo.core.problem import Problem
from dropo.problems.measured import find_runs, measured
from dropo.simulators.fields import FieldParameter
from dropo.simulators.mujoco import MujocoSimulator

TIMESTEP, FRAME_SKIP = 2e-3, 10  # [s] of a physics step; physics steps in a control step: 20 ms, the slowest log's own
HORIZON = 25  # control steps: 500 ms
COMMAND = "tau"  # torque by the measured current: the commands of one run lack its feedback
PARAMETERS = (
    FieldParameter("mass", 0.2, 1.5, "kg", field="body_mass", element="link"),
    FieldParameter("inertia", 1e-6, 0.05, "kg m^2", field="body_inertia", element="link", index=1),
)


def simple_pendulum(threads: int = 0) -> Problem:
    """Mass and inertia of a pendulum from runs under different controllers, over horizons of 500 ms. In some spans it is pushed."""
    runs, model = find_runs("simple-pendulum", "model.xml", "the DFKI simple pendulum")
    spec = mujoco.MjSpec.from_file(str(model))
    spec.option.timestep = TIMESTEP
    simulator = MujocoSimulator(spec, PARAMETERS, observation=["qpos", "qvel"], frame_skip=FRAME_SKIP, threads=threads)
    return measured("simple-pendulum", simulator, runs, HORIZON, COMMAND)
