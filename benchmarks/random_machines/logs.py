"""The log of a random machine: a few runs that plain MuJoCo steps, positions by encoders."""

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from design import RandomDesign
from hidden import Machine
from numpy.random import Generator

from dropo.core.records.trajectories import Trajectories
from dropo.core.services.validation import Array
from dropo.studies.first_models.strangers import between_levels, sum_of_sines

CONTROL_STEPS = (0.004, 0.01, 0.02)  # [s]
WAVES = {"sines": 0.6, "steps": 0.2, "ramps": 0.2}
"""How often a machine is moved by sums of sines, by steps, or by ramps."""
FARTHEST = 20.0
"""A machine that comes so far is lost [rad, m]."""
SATURATED = 0.05
"""No machine is logged whose motors are at their limit for more than this part of the time: its
controller chatters.
"""
JITTER = 0.4
"""Noise of an encoder before it is rounded, in its steps."""
LARGEST = 3.0
"""Of a motor's command, as a factor of its whole force."""


@dataclass(frozen=True, eq=False)
class Run:
    """How a machine truly moved in T control steps.

    Attributes
    ----------
    positions, speeds : (T, n) arrays
        Before each step.
    commands : (T, nu) array
        In it.
    """

    positions: Array
    speeds: Array
    commands: Array


@dataclass(frozen=True, eq=False)
class Log:
    """What was measured, and what was true.

    Attributes
    ----------
    trajectories : Trajectories
        Positions before and after each control step by encoders of 12 to 16 bits, and commands.
    control : float
        Control step [s].
    noise : (n,) array
        Standard deviation of the measured positions [rad, m].
    runs : sequence of Run
        Three to six of 5 to 10 s.
    """

    trajectories: Trajectories
    control: float
    noise: Array
    runs: Sequence[Run]


class Lost(Exception):
    """The machine cannot be moved that way."""


def random_log(design: RandomDesign, machine: Machine, rng: Generator) -> Log:
    """Move a machine from rest, and log it.

    Position servos are told the motion that is wanted; motors and velocity servos are told what a
    controller makes of where the machine is.

    Parameters
    ----------
    design : RandomDesign
        The model, whose gravity the motors' controller makes up for.
    machine : Machine
        What moves.
    rng : numpy.random.Generator
        What random numbers come from.

    Returns
    -------
    Log

    Raises
    ------
    Lost
        If it runs away, or its controller chatters.
    """
    control = float(rng.choice(CONTROL_STEPS))
    wave = str(rng.choice(list(WAVES), p=list(WAVES.values())))
    mover = _Mover(design, machine, control)
    tick = np.where(mover.slides, 1e-5, 2 * np.pi / 2 ** int(rng.integers(12, 17)))
    steps = round(rng.uniform(5.0, 10.0) / control)
    runs = int(rng.integers(3, 7))
    size = np.where(mover.slides, 0.06, 0.5)
    own = []
    measured = []
    for _ in range(runs):
        run, last = mover.run(size * _wanted(wave, len(size), steps, control, rng))
        moved = np.concatenate([run.positions, last[None]])
        measured.append(np.round(moved / tick + JITTER * rng.normal(size=moved.shape)) * tick)
        own.append(run)
    commands = np.concatenate([run.commands for run in own])
    saturated = np.mean(np.abs(commands) >= LARGEST)
    if design.drives == "motor" and saturated > SATURATED:
        raise Lost(f"motors are at their limit for {saturated:.0%} of the time")
    ends = np.tile(np.arange(steps) == steps - 1, runs)
    before = np.concatenate([read[:-1] for read in measured])
    after = np.concatenate([read[1:] for read in measured])
    noise = tick * np.sqrt(JITTER**2 + 1 / 12)
    return Log(Trajectories(before, commands, after, ends), control, noise, own)


class _Mover:
    """Steps a machine through wanted motions."""

    def __init__(self, design: RandomDesign, machine: Machine, control: float):
        self.drives = design.drives
        self.forces = design.forces
        self.control = control
        self.model = machine.spec.compile()
        self.data = mujoco.MjData(self.model)
        self.first = design.spec.compile()
        self.first_data = mujoco.MjData(self.first)
        self.every = round(control / self.model.opt.timestep)
        self.late = round(machine.delay / self.model.opt.timestep)
        self.joints = self.model.actuator_trnid[:, 0]
        self.slides = self.model.jnt_type == mujoco.mjtJoint.mjJNT_SLIDE

    def run(self, wanted: Array) -> tuple[Run, Array]:
        """A run of T steps from rest at 0, and the positions (n,) after it."""
        mujoco.mj_resetData(self.model, self.data)
        speeds = np.gradient(wanted, self.control, axis=0)
        waiting = [np.zeros(self.model.nu)] * self.late
        positions = []
        velocities = []
        commands = []
        for position, speed in zip(wanted, speeds, strict=True):
            positions.append(self.data.qpos.copy())
            velocities.append(self.data.qvel.copy())
            command = self._command(position, speed)
            commands.append(command)
            for _ in range(self.every):
                waiting.append(command)
                self.data.ctrl[:] = waiting.pop(0)
                mujoco.mj_step(self.model, self.data)
        last = self.data.qpos.copy()
        run = Run(np.array(positions), np.array(velocities), np.array(commands))
        if not (np.abs([*positions, last]) < FARTHEST).all() or self._is_reset():
            raise Lost("the machine runs away")
        return run, last

    def _is_reset(self) -> bool:
        """Whether MuJoCo began anew where accelerations became too large."""
        return any(
            self.data.warning[kind].number > 0
            for kind in (
                mujoco.mjtWarning.mjWARN_BADQPOS,
                mujoco.mjtWarning.mjWARN_BADQVEL,
                mujoco.mjtWarning.mjWARN_BADQACC,
            )
        )

    def _command(self, position: Array, speed: Array) -> Array:
        """(nu,) what the drives are told where a posture and its speed are wanted."""
        own = self.joints
        if self.drives == "position":
            return position[own]
        missing = position[own] - self.data.qpos[own]
        if self.drives == "velocity":
            return np.clip(speed[own], -2.0, 2.0) + 2.0 * missing
        slow = speed[own] - self.data.qvel[own]
        self.first_data.qpos[:] = self.data.qpos
        mujoco.mj_forward(self.first, self.first_data)
        gravity = self.first_data.qfrc_bias[own] / self.forces[own]
        return np.clip(gravity + 3.0 * missing + 0.3 * slow, -LARGEST, LARGEST)


def _wanted(wave: str, joints: int, steps: int, control: float, rng: Generator) -> Array:
    """(steps, joints) a motion of about 1."""
    time = control * np.arange(steps)
    found = np.zeros((steps, joints))
    for i in range(joints):
        if wave == "sines":
            found[:, i] = sum_of_sines(time, 4, (0.1, 1.2), (0.2, 0.5), rng)
        else:
            found[:, i] = between_levels(time, (0.6, 1.4), rng, held=wave == "steps")
    return found
