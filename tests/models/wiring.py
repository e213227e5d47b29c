"""Logs whose columns are not what the model takes them for, of machines on servos and on motors."""

from dataclasses import replace

import mujoco
import numpy as np

from dropo.core.records.trajectories import Trajectories
from dropo.studies.first_models.machines import (
    CONTROL,
    DESIGNS,
    NOISE,
    SINES,
    TICK,
    Design,
    built,
    first_model,
    problem_of,
    random_machine,
    recorded,
)

DEGREES = 180 / np.pi
MACHINES = {
    **DESIGNS,
    "three links on motors": Design(
        ("hinge z", "hinge y", "hinge y"), (0.1, 0.3, 0.25), (2.0, 0.8, 0.4), (9.0, 9.0, 4.0), False
    ),
    "two links on servos": Design(
        ("hinge y", "hinge y"), (0.35, 0.3), (2.0, 1.2), (120.0, 60.0), along="zz"
    ),
    "cart and pole on motors": Design(
        ("slide x", "hinge y"), (0.2, 0.4), (2.0, 0.5), (20.0, 3.0), False, along=("x", "z")
    ),
}
"""Machines by name, those of the study of first models among them."""


def log_of(name, rng, *, gain=None, seconds=12.0, runs=2, **changed):
    """A machine of random numbers with its first model, whose drives are off by a factor."""
    design = MACHINES[name]
    spec = first_model(design)
    machine = random_machine(design, rng)
    machine = replace(machine, **changed)
    if gain is not None:
        machine = replace(machine, gain=gain - 1.0)
    made = built(spec, machine)
    made.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST  # of stiff drives
    data = recorded(made, design.servos, machine.delay, rng, seconds=seconds, runs=runs)
    return problem_of(name, spec, data)


def read_otherwise(problem, *, angles=None, commands=None):
    """The problem with columns of angles and commands that something was done to."""
    data = problem.trajectories
    angles = angles or (lambda rows: rows)
    commands = commands or (lambda rows: rows)
    return replace(
        problem,
        trajectories=Trajectories(
            angles(data.observations),
            commands(data.actions),
            angles(data.next_observations),
            data.terminals,
        ),
    )


def scaled(place, factor):
    """What multiplies one column."""

    def change(rows):
        rows = rows.copy()
        rows[:, place] *= factor
        return rows

    return change


def exchanged(one, other):
    """What exchanges two columns."""

    def change(rows):
        rows = rows.copy()
        rows[:, [one, other]] = rows[:, [other, one]]
        return rows

    return change


def torques_logged(name, rng, *, seconds=12.0, runs=2):
    """A machine that follows paths by torques of a controller of its own, which are logged as the
    commands of its model's position servos.
    """
    design = MACHINES[name]
    spec = first_model(design)
    made = built(spec, random_machine(design, rng))
    for drive, stiffness in zip(made.actuators, design.gains, strict=True):
        drive.set_to_motor()
        drive.gainprm[0] = 1.0
        drive.biasprm[:] = 0.0
        drive.userdata = np.array([stiffness])
    model = made.compile()
    data = mujoco.MjData(model)
    stiffness = np.array(design.gains)
    substeps = round(CONTROL / model.opt.timestep)
    parts = []
    for _ in range(runs):
        mujoco.mj_resetData(model, data)
        count = round(seconds / CONTROL)
        path = np.zeros((count, model.nu))
        for _ in range(SINES):
            turn = 2 * np.pi * rng.uniform(0.1, 1.5, model.nu) * CONTROL * np.arange(count)[:, None]
            path += 0.25 * rng.uniform(0.3, 1.0, model.nu) * np.sin(turn)
        rows, torques = [data.qpos.copy()], []
        for wanted in path:
            torque = stiffness * (wanted - data.qpos) - 0.08 * stiffness * data.qvel
            torques.append(torque)
            data.ctrl[:] = torque
            mujoco.mj_step(model, data, substeps)
            rows.append(data.qpos.copy())
        read = np.array(rows)
        read = np.round((read + NOISE * rng.normal(size=read.shape)) / TICK) * TICK
        ends = np.arange(count) == count - 1
        parts.append((read[:-1], np.array(torques), read[1:], ends))
    whole = Trajectories(*(np.concatenate(column) for column in zip(*parts, strict=True)))
    return problem_of(name, spec, whole)


def light_wrist(rng):
    """A wrist about an upright axis whose motor works against friction alone, and a model without
    friction.
    """
    spec = mujoco.MjSpec.from_string(
        """
        <mujoco>
          <option timestep="0.001" integrator="implicitfast"/>
          <worldbody>
            <body name="wrist">
              <joint name="wrist" axis="0 0 1"/>
              <geom type="cylinder" size="0.02 0.03" mass="0.05" contype="0" conaffinity="0"/>
            </body>
          </worldbody>
          <actuator><motor name="wrist" joint="wrist"/></actuator>
        </mujoco>
        """
    )
    model = spec.compile()
    model.dof_frictionloss[0] = 1.0
    model.dof_damping[0] = 0.8
    data = mujoco.MjData(model)
    count = 2400
    turns = np.array([0.35, 0.8, 1.3])
    at = CONTROL * np.arange(count)[:, None]
    path = 0.3 * np.sin(2 * np.pi * turns * at + rng.uniform(0, 6, 3)).sum(axis=1)
    rows, torques = [data.qpos.copy()], []
    for wanted in path - path[0]:
        torques.append(30.0 * (wanted - data.qpos))
        data.ctrl[:] = torques[-1]
        mujoco.mj_step(model, data, round(CONTROL / model.opt.timestep))
        rows.append(data.qpos + 2e-5 * rng.normal(size=1))
    read = np.array(rows)
    log = Trajectories(read[:-1], np.array(torques), read[1:], np.arange(count) == count - 1)
    return problem_of("light wrist", spec, log)
