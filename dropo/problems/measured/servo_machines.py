"""Real machines under position servos, whose first model lacks much at once.

Data: an SO-101 arm, Isaac Sim's SAGE recordings, Apache-2.0, with the model of TheRobotStudio; a
Unitree Go2 on a stand, IIT, Sim2real robot identification, BSD-3.
"""

from dataclasses import replace

import mujoco
import numpy as np

from dropo.core.contracts.problem import Problem
from dropo.core.services.validation import Array
from dropo.mjmodel.fields import FieldParameter
from dropo.mjmodel.names import joint_names
from dropo.problems.measured.recordings import (
    DEFAULT,
    Channels,
    RecordedRuns,
    RecordingSettings,
    find_runs,
    measured,
)
from dropo.simulators.mujoco.simulator import MujocoSimulator

ARM_SKIP = 10  # physics steps of 2 ms: 20 ms, a row of the log
ARM_HORIZON = 25  # control steps: 0.5 s
LEGS_SKIP = 5  # physics steps of 1 ms: 5 ms, a row of the log
LEGS_HORIZON = 40  # control steps: 0.2 s
LEGS_FITTED = 10.5
"""Seconds of the legs' one run that are fitted; the rest is held out."""
LARGEST = {"dof_damping": 2.0, "dof_frictionloss": 1.0, "dof_armature": 0.1}
UNITS = {"dof_damping": "N m s/rad", "dof_frictionloss": "N m", "dof_armature": "kg m^2"}


def so101(threads: int = 0) -> Problem:
    """Damping, dry friction and rotor inertia of an SO-101 arm's six joints.

    35 motions under commanded angles, of which every third is held out. Angles alone were logged
    well; velocities are estimated. The maker's servo gains are far too high: `dropo diagnose so101
    --quick` says by how much.

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
    runs, model = find_runs("so101", "model.xml", "the SO-101 arm")
    spec = mujoco.MjSpec.from_file(str(model))
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    channels = tuple(_angles(run) for run in runs.channels)
    return _problem(
        "so101", spec, RecordedRuns(runs.names, channels), ARM_SKIP, ARM_HORIZON, threads
    )


def go2(threads: int = 0) -> Problem:
    """Damping, dry friction and rotor inertia of a Go2's twelve joints, its trunk on a stand.

    One run of 15.5 s under commanded angles; the last 5 s are held out.
    Velocities are estimated.

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
    runs, model = find_runs("go2", "model.xml", "the Go2 on its stand")
    spec = mujoco.MjSpec.from_file(str(model))
    run = _angles(runs.channels[0])
    first = run["time"] - run["time"][0] < LEGS_FITTED
    parts = tuple({name: values[part] for name, values in run.items()} for part in (first, ~first))
    settings = replace(DEFAULT, held_out_every=2)
    names = ("first", "last")
    return _problem(
        "go2", spec, RecordedRuns(names, parts), LEGS_SKIP, LEGS_HORIZON, threads, settings
    )


def _angles(run: Channels) -> dict[str, Array]:
    """The channels of a run that `measured` reads."""
    return {
        "time": np.asarray(run["time"], dtype=float),
        "qpos": run["qpos_measured"],
        "ctrl": run["ctrl"],
    }


def _problem(
    name: str,
    spec: mujoco.MjSpec,
    runs: RecordedRuns,
    frame_skip: int,
    horizon: int,
    threads: int,
    settings: RecordingSettings = DEFAULT,
) -> Problem:
    """The problem of a machine, with what each of its joints lacks as parameters."""
    parameters = [
        FieldParameter(
            f"{joint}_{field.removeprefix('dof_')}",
            0.0,
            high,
            UNITS[field],
            field=field,
            element=joint,
        )
        for field, high in LARGEST.items()
        for joint in joint_names(spec.compile())
    ]
    simulator = MujocoSimulator(
        spec, parameters, observation=["qpos", "qvel"], frame_skip=frame_skip, threads=threads
    )
    return measured(name, simulator, runs, horizon, "ctrl", settings)
