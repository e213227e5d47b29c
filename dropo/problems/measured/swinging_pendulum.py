"""A real pendulum and double pendulum that swing freely.

Data: Kaheman et al., MultiArm-Pendulum, 2023; MIT licence.
"""

import mujoco

from dropo.core.contracts.problem import Problem
from dropo.mjmodel.fields import FieldParameter
from dropo.problems.measured.recordings import find_runs, measured
from dropo.simulators.mujoco.simulator import MujocoSimulator

STEP = 0.02  # [s] of a control step
HORIZON = 50  # control steps: 1 s, about one swing


def swinging_pendulum(threads: int = 0) -> Problem:
    """Mass and inertia of one arm that swings freely.

    Segments are 1 s long. Only the ratio of the two is identifiable.

    Parameters
    ----------
    threads : int
        Threads of the simulator; 0 for all cores.

    Returns
    -------
    Problem

    Raises
    ------
    BadFile
        If the external data are not found.
    """
    return _swinging("swinging-pendulum", "single", 1, 2, threads)


def swinging_pendulum_double(threads: int = 0) -> Problem:
    """Masses and inertias of two arms that swing freely.

    Parameters
    ----------
    threads : int
        Threads of the simulator; 0 for all cores.

    Returns
    -------
    Problem

    Raises
    ------
    BadFile
        If the external data are not found.
    """
    return _swinging("swinging-pendulum-double", "double", 2, 4, threads)


def _swinging(name: str, kind: str, arms: int, frame_skip: int, threads: int) -> Problem:
    """The problem of one or two arms.

    `frame_skip` is the number of Runge-Kutta steps in a control step; the error of one is below
    1e-5 rad.
    """
    runs, model = find_runs("swinging-pendulum", f"model_{kind}.xml", "the multi-arm pendulum")
    parameters: list[FieldParameter] = []
    for arm in range(1, arms + 1):
        parameters += _mass_and_inertia(f"arm{arm}")
    spec = mujoco.MjSpec.from_file(str(model))
    spec.option.timestep = STEP / frame_skip
    simulator = MujocoSimulator(
        spec, parameters, observation=["qpos", "qvel"], frame_skip=frame_skip, threads=threads
    )
    return measured(name, simulator, runs.named(kind), HORIZON)


def _mass_and_inertia(arm: str) -> tuple[FieldParameter, FieldParameter]:
    """The two parameters of an arm."""
    return (
        FieldParameter(f"{arm}_mass", 0.05, 0.5, "kg", field="body_mass", element=arm),
        FieldParameter(
            f"{arm}_inertia", 1e-5, 5e-3, "kg m^2", field="body_inertia", element=arm, index=1
        ),
    )
