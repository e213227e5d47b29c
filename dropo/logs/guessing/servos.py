"""First gains of drives that a model does not have, from what they did in the log."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls

from dropo.core.services.validation import Array
from dropo.logs.mapping import COMMAND
from dropo.logs.preparing import clean_run
from dropo.logs.recordings import LogRun
from dropo.logs.signals.velocities import estimate_velocities
from dropo.mjmodel.dynamics.drives import command_kind
from dropo.mjmodel.dynamics.forces import force_per_command, inverse_forces
from dropo.mjmodel.files.robots import DriveGuess
from dropo.mjmodel.joints import Joint, ModelJoints, numbers_of, reference_pose


@dataclass(frozen=True)
class DriveSettings:
    """How first gains are estimated.

    Attributes
    ----------
    rows : int
        Rows that they are estimated from at most.
    frequency : float
        Hz of a servo whose gain the log does not show.
    slow : float
        Speeds below this fraction of the largest count as rest for dry friction.
    """

    rows: int = 4000
    frequency: float = 5.0
    slow: float = 0.02


DEFAULTS = DriveSettings()


def estimate_drives(
    runs: Sequence[LogRun],
    robot: ModelJoints,
    drives: Mapping[str, DriveGuess],
    settings: DriveSettings = DEFAULTS,
) -> dict[str, DriveGuess]:
    """Estimate the gains of servos by least squares over inverse dynamics.

    Parameters
    ----------
    runs : sequence of LogRun
        As they were read, of which the first is used.
    robot : ModelJoints
        The robot with an actuator of each driven joint's name.
    drives : mapping
        By joint what is commanded.
    settings : DriveSettings, optional
        How they are estimated.

    Returns
    -------
    dict
        By joint the drive with its gains.

    Notes
    -----
    The force that the motion needs is kp (u - q) - kd v less rotor inertia and friction, all gains
    at least 0: first numbers for a fit, not results.
    """
    run = clean_run(runs[0], robot)
    motion = _ServoMotion(run, robot, settings)
    return {joint: motion.estimate(joint, drive) for joint, drive in drives.items()}


@dataclass(frozen=True)
class CommandSize:
    """What a unit of a motor's command does, where it is no force.

    Attributes
    ----------
    actuator : str
        The motor.
    unit : str
        Of its command: "V", "A" or "".
    force : float
        Of the unit [N m or N].
    damping : float
        Viscous friction beside it, back EMF included [N m s/rad or N s/m].
    factor : float
        The force over that which the model gives to a command of 1.
    """

    actuator: str
    unit: str
    force: float
    damping: float
    factor: float


def command_sizes(
    runs: Sequence[LogRun], robot: ModelJoints, settings: DriveSettings = DEFAULTS
) -> list[CommandSize]:
    """Estimate what commands do that are no forces: volts, amperes, parts of a duty cycle.

    Parameters
    ----------
    runs : sequence of LogRun
        As they were read, of which the first is used.
    robot : ModelJoints
        The robot.
    settings : DriveSettings, optional
        How they are estimated.

    Returns
    -------
    list of CommandSize
        Of each motor with such a command whose joint's position was logged.
    """
    run = clean_run(runs[0], robot)
    motion = _ServoMotion(run, robot, settings)
    found = []
    for series in run.series:
        channel = series.channel
        if channel.field != "ctrl" or channel.units[0] not in ("V", "A", ""):
            continue
        actuator = robot.actuators[channel.name]
        if command_kind(robot.model, actuator.id) == "torque" and actuator.joint is not None:
            size = motion.estimate_size(channel.name, channel.candidate, actuator.joint)
            if size is not None:
                factor = size[0] / force_per_command(robot.model, actuator.id)
                found.append(CommandSize(channel.name, channel.units[0], *size, factor))
    return found


class _ServoMotion:
    """Positions, velocities and accelerations of a run, and the forces that they need."""

    def __init__(self, run: LogRun, robot: ModelJoints, settings: DriveSettings):
        self._run = run
        self._robot = robot
        self._settings = settings
        first = next(one for one in run.series if one.channel.field == "qpos")
        self._time = first.time[: settings.rows]
        n = len(self._time)
        self._positions = np.tile(reference_pose(robot.model), (n, 1))
        self._velocities = np.zeros((n, robot.model.nv))
        for joint in robot.joints.values():
            series = run.of("qpos", joint.name)
            if series is None or joint.kind not in ("hinge", "slide") or n < 20:
                continue
            values = np.interp(self._time, series.time, series.values[:, 0])
            smooth = estimate_velocities(self._time, values[:, None])
            self._positions[:, joint.qpos] = smooth.positions[:, 0]
            self._velocities[:, joint.qvel] = smooth.velocities[:, 0]
        self._accelerations = np.gradient(self._velocities, self._time, axis=0)
        self._forces = inverse_forces(
            robot.model, self._positions, self._velocities, self._accelerations
        )

    def estimate(self, name: str, drive: DriveGuess) -> DriveGuess:
        """The gains of a joint's drive."""
        if drive.kind == "torque":
            return drive
        joint = self._robot.joints[name]
        command = self._command(name, COMMAND)
        velocity = self._velocities[:, joint.qvel]
        position = self._positions[:, joint.qpos]
        inertia = numbers_of(self._robot.model, joint).inertia
        if drive.kind == "position":
            columns = [command - position, -velocity]
        else:
            columns = [command - velocity]
        columns += [-self._accelerations[:, joint.qvel], self._dry_friction(joint)]
        gains, _ = nnls(np.stack(columns, axis=1), self._forces[:, joint.qvel])
        return self._make_drive(drive.kind, gains, inertia)

    def estimate_size(self, name: str, candidate: str, joint: Joint) -> tuple[float, float] | None:
        """The force of a command of 1 and the viscous friction; None where the log shows none."""
        velocity = self._velocities[:, joint.qvel]
        command = self._command(name, candidate)
        if not (np.ptp(velocity) > 0 and np.ptp(command) > 0):
            return None
        columns = [command, -velocity, -self._accelerations[:, joint.qvel]]
        columns.append(self._dry_friction(joint))
        gains, _ = nnls(np.stack(columns, axis=1), self._forces[:, joint.qvel])
        return (float(gains[0]), float(gains[1])) if gains[0] > 0 else None

    def _dry_friction(self, joint: Joint) -> Array:
        """Dry friction of 1 along the motion."""
        velocity = self._velocities[:, joint.qvel]
        slow = self._settings.slow * float(np.abs(velocity).max() + 1e-12)
        return np.asarray(-np.tanh(velocity / slow))

    def _command(self, name: str, candidate: str) -> Array:
        """The command at the positions' instants, held from row to row."""
        series = self._run.of("ctrl", name, candidate)
        if series is None:
            return np.zeros(len(self._time))
        row = np.searchsorted(series.time, self._time + 1e-9, side="right") - 1
        return np.asarray(series.values[np.clip(row, 0, None), 0])

    def _make_drive(self, kind: str, gains: Array, inertia: float) -> DriveGuess:
        """A drive with these gains, or usual ones where the log shows none."""
        usual = inertia * (2 * np.pi * self._settings.frequency) ** 2
        if kind == "velocity":
            damping = float(gains[0]) or usual / (2 * np.pi * self._settings.frequency)
            return DriveGuess(kind, 0.0, _digits(damping))
        stiffness = float(gains[0]) or usual
        whole = inertia + float(gains[2])
        damping = float(gains[1]) or 0.3 * np.sqrt(stiffness * whole)
        return DriveGuess(kind, _digits(stiffness), _digits(damping))


def _digits(value: float) -> float:
    """Three digits of a number."""
    return float(f"{value:.3g}")
