"""A real double pendulum on two drives.

Data: Wiebe et al., the dual-purpose acrobot and pendubot, IEEE RA-L 9, 2024; DFKI; BSD-3.
"""

from pathlib import Path

import mujoco

from dropo.core.contracts.problem import Problem
from dropo.mjmodel.fields import FieldParameter
from dropo.problems.measured.recordings import find_runs, measured
from dropo.simulators.mujoco.simulator import MujocoSimulator

FRAME_SKIP = 5  # physics steps of 2 ms: 10 ms, several rows of the log
HORIZON = 10  # control steps: 100 ms
COMMANDS = {"commanded": "ctrl", "current": "tau"}
"""Input -> its column, torques; the one from the current explains the runs worse."""
LENGTHS = {"A0": (0.3, 0.2), "C0": (0.2, 0.3)}  # [m] of the two links, by design
HIGHEST_INERTIA = 5e-3
"""[kg m^2] about the centre of mass; an even rod of a link's length and mass has 4.5e-3."""


def _inertia(body: str) -> FieldParameter:
    """The inertia of a link about its joint's axis as a parameter."""
    return FieldParameter(
        f"{body}_inertia",
        1e-4,
        HIGHEST_INERTIA,
        "kg m^2",
        field="body_inertia",
        element=body,
        index=1,
    )


PARAMETERS = (
    FieldParameter("upper_mass", 0.2, 2.0, "kg", field="body_mass", element="upper"),
    FieldParameter("lower_mass", 0.2, 2.0, "kg", field="body_mass", element="lower"),
    _inertia("upper"),
    _inertia("lower"),
)


def double_pendulum(threads: int = 0, input: str = "commanded") -> Problem:
    """Masses and inertias of both links of design A0 (0.3 m and 0.2 m).

    The runs are excitation and swing-ups; segments are 100 ms long.

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
    return _design("double-pendulum", "A0", threads, input)


def double_pendulum_c0(threads: int = 0, input: str = "commanded") -> Problem:
    """Masses and inertias of both links of design C0 (0.2 m and 0.3 m), as `double_pendulum`.

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
    return _design("double-pendulum-c0", "C0", threads, input)


def _design(name: str, design: str, threads: int, input: str) -> Problem:
    """The problem of one design."""
    runs, model = find_runs("double-pendulum", "model.xml", "the DFKI double pendulum")
    spec = double_pendulum_spec(model, LENGTHS[design])
    simulator = MujocoSimulator(
        spec, PARAMETERS, observation=["qpos", "qvel"], frame_skip=FRAME_SKIP, threads=threads
    )
    return measured(name, simulator, runs.named(design), HORIZON, COMMANDS[input])


def double_pendulum_spec(path: Path, lengths: tuple[float, float]) -> mujoco.MjSpec:
    """The model with links of other lengths.

    Parameters
    ----------
    path : Path
        Path of the MJCF file.
    lengths : (float, float)
        Lengths of the upper and the lower link [m]; a link's centre of mass is at its end.

    Returns
    -------
    mujoco.MjSpec
    """
    spec = mujoco.MjSpec.from_file(str(path))
    for name, length in zip(("upper", "lower"), lengths, strict=True):
        body = spec.body(name)
        body.ipos = [0, 0, -length]
        body.geoms[0].fromto = [0, 0, 0, 0, 0, -length]
    spec.body("lower").pos = [0, 0, -lengths[0]]
    return spec
