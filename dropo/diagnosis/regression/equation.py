"""The equation of motion along a log, smoothed and thinned: drives = what the motion needs.

Positions and commands pass the same even kernel, so that commands lag exactly as positions do.
Then both sides of the equation pass a second one, so that no row rests on a raw second derivative.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dropo.core.contracts.effect import Model
from dropo.core.contracts.problem import Problem
from dropo.core.numerics.robust_statistics import deviation
from dropo.core.records.trajectories import Ints, Trajectories
from dropo.core.services.errors import BadArgument, Incompatible
from dropo.core.services.validation import Array
from dropo.diagnosis.regression.kernels import REACH, apply_kernel, derivative_kernels, held_kernel
from dropo.diagnosis.search.library import robot_of
from dropo.mjmodel.bodies import moving_bodies
from dropo.mjmodel.body_regressors import inverse_dynamics
from dropo.mjmodel.forces import LinearDrives, linear_drives
from dropo.mjmodel.joints import joints
from dropo.mjmodel.robot_simulator import RobotSimulator
from dropo.simulators.mujoco.layers import change_commands, clamp
from dropo.simulators.mujoco.worker import Worker


@dataclass(frozen=True)
class EquationSettings:
    """How a log becomes rows of the equation of motion.

    Attributes
    ----------
    narrowest, widest : float
        Widths of the first kernel that are taken, in rows.
    noise : float
        The first kernel is widened until the noise of accelerations is this fraction of them.
    second : float
        Width of the second kernel, in widths of the first.
    thin : float
        Distance of the rows that are kept, in widths of the second kernel.
    rows : int
        Rows of the log that are used, at most, in stretches spread over all of it.
    stretch : float
        Shortest stretch, in reaches of both kernels.
    still : float
        A joint rests where it is slower than this fraction of its RMS speed ...
    still_noise : float
        ... or than so many standard deviations of the speed's noise.
    sticks : float
        A row is dropped for a joint that rests for this fraction of the second kernel.
    slow : float
        The speed at which the sign of dry friction fades out, in RMS speeds of a joint.
    delays : float
        Longest delay of commands that is tried, in control steps ...
    longest_delay : float
        ... and in seconds.
    block : float
        Length of the blocks of time that errors are computed from [s], about.
    blocks : int
        Blocks there are at least, where the log is short.
    """

    narrowest: float = 1.2
    widest: float = 4.0
    noise: float = 0.02
    second: float = 1.8
    thin: float = 1.2
    rows: int = 9000
    stretch: float = 2.2
    still: float = 0.05
    still_noise: float = 4.0
    sticks: float = 0.1
    slow: float = 0.02
    delays: float = 10.0
    longest_delay: float = 0.06
    block: float = 1.0
    blocks: int = 20


SETTINGS = EquationSettings()


@dataclass(frozen=True, eq=False)
class Equation:
    """R rows of the equation of motion of nv degrees of freedom, one a control step or more.

    Attributes
    ----------
    drives : (D, R, nv) array
        Forces of the drives for each delay of the commands [N, N m].
    delays : (D,) array
        The delays [s].
    needed : (R, nv) array
        Forces that the motion needs by the model [N, N m].
    position, velocity, acceleration, direction : (R, nv) arrays
        Of each degree of freedom, [rad, m] and their derivatives; the direction of motion is
        between -1 and 1.
    load : (R, nv) array
        The direction of motion times the size of the force that the motion needs without friction.
    by_inertia : (B, R, nv, 10) array
        Derivatives of the forces by each body's inertial numbers.
    by_gravity : (R, nv, 3) array
        Derivatives of the forces by gravity.
    used : (R, nv) array of bool
        Whether the row counts for the joint: it moves, nothing touches.
    block : (R,) int array
        The block of time that a row belongs to.
    driven : (nv,) array of bool
        Whether an actuator acts there.
    width : float
        Of the first kernel [s].
    """

    drives: Array
    delays: Array
    needed: Array
    position: Array
    velocity: Array
    acceleration: Array
    direction: Array
    load: Array
    by_inertia: Array
    by_gravity: Array
    used: NDArray[np.bool_]
    block: Ints
    driven: NDArray[np.bool_]
    width: float

    def __len__(self) -> int:
        return len(self.block)


def refuse_unsuitable(simulator: RobotSimulator) -> None:
    """Refuse robots whose equation of motion cannot be written from joint angles and commands.

    Parameters
    ----------
    simulator : RobotSimulator
        The robot.

    Raises
    ------
    Incompatible
        If a joint is neither a hinge nor a slide or its position is not observed, if the model has
        equality constraints, or if an actuator's force is not known.
    """
    model = simulator.model
    found = joints(model)
    if len(found) < model.nv:
        raise Incompatible(
            "A regression over inverse dynamics needs hinges and slides from a fixed base; this "
            "model has a floating one or another joint, where contacts act that no log holds."
        )
    if not len(_drives_at_rest(simulator).dofs):
        raise Incompatible(
            "A regression over inverse dynamics needs a drive whose force is known: without one, "
            "all forces and masses could be larger by one factor."
        )
    if model.neq:
        raise Incompatible("A regression over inverse dynamics knows no equality constraints.")
    observed = {column.place for column in simulator.layout.columns if column.field == "qpos"}
    for joint in found:
        if joint.qpos not in observed:
            raise Incompatible(
                f"A regression over inverse dynamics needs the position of every joint; that of "
                f"{joint.name!r} is not observed."
            )


def equation_of(
    problem: Problem,
    trajectories: Trajectories,
    settings: EquationSettings = SETTINGS,
    *,
    width: float | None = None,
) -> Equation:
    """Write the equation of motion along measured trajectories.

    Parameters
    ----------
    problem : Problem
        Its robot.
    trajectories : Trajectories
        What was measured.
    settings : EquationSettings
        How.
    width : float, optional
        Of the first kernel [s]; by default as narrow as the positions' noise allows.

    Returns
    -------
    Equation

    Raises
    ------
    Incompatible
        If the robot is not suitable (`refuse_unsuitable`).
    BadArgument
        If no trajectory is long enough, or nothing moves.
    """
    simulator = robot_of(problem)
    refuse_unsuitable(simulator)
    log = Log(simulator, trajectories)
    if width is None:
        width = _first_width(log, settings)
    second = settings.second * width
    reach = int(np.ceil(REACH * (width + second) / log.step)) + 1
    stretches = _stretches(log, reach, settings)
    if not stretches:
        raise BadArgument(
            f"No trajectory is longer than {3 * reach * log.step:.2g} s, which a regression over "
            "inverse dynamics needs for smoothing."
        )
    speed = np.sqrt(np.mean([np.mean(v**2, axis=0) for v in log.speeds(width)], axis=0))
    parts: list[dict[str, Any]] = []
    count = sum(stop - start for _, start, stop in stretches)
    length = min(settings.block, count * log.step / settings.blocks)
    first_block = 0
    model = model_of(simulator)
    delays = _delays(simulator, settings)
    for stretch in stretches:
        part = _stretch_equation(model, log, stretch, delays, width, second, speed, settings, reach)
        block = np.floor(part.pop("time") / length).astype(np.int64)
        part["block"] = first_block + np.unique(block, return_inverse=True)[1]
        first_block = int(part["block"].max()) + 1 if len(block) else first_block
        parts.append(part)
    joined: dict[str, Any] = {}
    for name in parts[0]:
        axis = 1 if name in ("drives", "by_inertia") else 0
        joined[name] = np.concatenate([part[name] for part in parts], axis=axis)
    driven = np.zeros(simulator.model.nv, dtype=bool)
    driven[_drives_at_rest(simulator).dofs] = True
    return Equation(**joined, delays=delays, driven=driven, width=width)


def model_of(simulator: RobotSimulator) -> Model:
    """Return the model of a robot with its fixed effects written into it."""
    worker = Worker(simulator.model, ())
    worker.set(np.zeros(0), [one for one in simulator.fixed if not one[0].general])
    return worker.model


def _drives_at_rest(simulator: RobotSimulator) -> LinearDrives:
    """The drives of the model at one state, for the places where they act."""
    model = simulator.model
    return linear_drives(model, np.zeros((1, model.nq)), np.zeros((1, model.nv)))


class Log:
    """Positions and commands of each run, on a uniform grid; refused without every position."""

    def __init__(self, simulator: RobotSimulator, trajectories: Trajectories):
        self.step = simulator.control_step
        model = simulator.model
        place = {
            column.place: i
            for i, column in enumerate(simulator.layout.columns)
            if column.field == "qpos"
        }
        missing = sorted(set(range(model.nq)) - set(place))
        if missing:
            raise Incompatible(
                f"qpos[{missing[0]}] is not observed. A regression over inverse dynamics needs "
                "every position."
            )
        columns = [place[i] for i in range(model.nq)]
        self.positions: list[Array] = []
        self.commands: list[Array] = []
        fixed = [
            (instance, magnitudes)
            for instance, magnitudes in simulator.fixed
            if instance.command is not None or instance.actuation is not None
        ]
        for start, stop in trajectories.spans:
            rows = trajectories.observations[start:stop]
            last = trajectories.next_observations[stop - 1 : stop]
            self.positions.append(np.concatenate([rows, last])[:, columns])
            commands = np.zeros((stop - start + 1, model.nu))
            commands[:-1, simulator.controls] = trajectories.actions[start:stop]
            commands[-1] = commands[-2]
            commands = clamp(commands, model)
            if fixed:
                fine = change_commands(commands, model, simulator.frame_skip, fixed)
                commands = fine.reshape(len(commands), simulator.frame_skip, model.nu).mean(axis=1)
            self.commands.append(commands)

    @cached_property
    def noise(self) -> Array:
        """(nv,) standard deviation of the positions' noise, from their third differences."""
        thirds = [np.diff(rows, 3, axis=0) for rows in self.positions if len(rows) > 3]
        return np.asarray(deviation(np.concatenate(thirds)) / np.sqrt(20.0))

    def speeds(self, width: float) -> list[Array]:
        """The smoothed velocities of each run."""
        kernel = derivative_kernels(width, self.step)[1]
        return [apply_kernel(kernel, rows) for rows in self.positions]


def _delays(simulator: RobotSimulator, settings: EquationSettings) -> Array:
    """(D,) the delays of commands that are tried [s].

    A simulation acts half a physics step early, as if commands came before they do.
    """
    step = simulator.control_step
    longest = min(settings.delays * step, settings.longest_delay)
    return np.linspace(-float(simulator.model.opt.timestep), longest, 25)


def _first_width(log: Log, settings: EquationSettings) -> float:
    """The width of the first kernel [s] at which accelerations stand out from noise."""
    noise = log.noise
    width = settings.narrowest * log.step
    # Both kernels must fit into the longest run several times.
    longest = max(map(len, log.positions))
    fits = longest / (REACH * settings.stretch * (1 + settings.second)) / 3
    widest = max(settings.narrowest, min(settings.widest, fits))
    while width < widest * log.step:
        kernel = derivative_kernels(width, log.step)[2]
        found = [apply_kernel(kernel, rows) for rows in log.positions]
        size = np.sqrt(np.mean(np.concatenate(found) ** 2, axis=0))
        by_noise = noise * np.sqrt(np.sum(kernel**2)) / np.sqrt(2 * settings.second)
        if np.median(by_noise / np.maximum(size, 1e-300)) < settings.noise:
            break
        width *= 1.2
    return width


def _stretches(log: Log, reach: int, settings: EquationSettings) -> list[tuple[int, int, int]]:
    """(run, first row, row behind the last) of the stretches that are used."""
    shortest = int(settings.stretch * reach)
    whole = [(run, len(rows)) for run, rows in enumerate(log.positions) if len(rows) >= shortest]
    total = sum(length for _, length in whole)
    fraction = min(1.0, settings.rows / max(total, 1))
    found = []
    for run, length in whole:
        share = max(shortest, int(fraction * length))
        pieces = max(1, min(share // (2 * shortest), 4)) if fraction < 1 else 1
        size = max(shortest, share // pieces)
        for start in np.linspace(0, length - size, pieces).astype(int).tolist():
            found.append((run, start, start + size))
    return found


def _stretch_equation(
    model: Model,
    log: Log,
    stretch: tuple[int, int, int],
    delays: Array,
    width: float,
    second: float,
    speed: Array,
    settings: EquationSettings,
    reach: int,
) -> dict[str, Any]:
    """The arrays of one stretch, without rows whose kernels reach beyond it."""
    run, start, stop = stretch
    rows = log.positions[run][start:stop]
    kernels = derivative_kernels(width, log.step)
    position, velocity, acceleration = (apply_kernel(kernel, rows) for kernel in kernels)
    bodies = [body for body, _ in moving_bodies(model)]
    motion = inverse_dynamics(model, position, velocity, acceleration, bodies)
    drives = linear_drives(model, position, velocity)
    commands = log.commands[run][start:stop]
    forces = []
    for delay in delays.tolist():
        late = apply_kernel(held_kernel(width, log.step, delay), commands)
        forces.append(drives.forces(late))
    noise = log.noise * np.sqrt(np.sum(kernels[1] ** 2))
    still_speed = np.maximum(settings.still * speed, settings.still_noise * noise)
    still = np.abs(velocity) < still_speed
    # Dry friction acted before the first kernel: it passes that kernel as all other forces did.
    sign = np.tanh(velocity / np.maximum(settings.slow * speed, 1e-300))
    direction = apply_kernel(kernels[0], sign)
    load = apply_kernel(kernels[0], np.abs(motion.forces) * sign)

    smooth = derivative_kernels(second, log.step)[0]
    every = max(1, round(settings.thin * second / log.step))
    kept = np.arange(reach, len(rows) - reach, every)

    def thinned(values: Array) -> Array:
        return apply_kernel(smooth, values.reshape(len(values), -1))[kept].reshape(
            (len(kept), *values.shape[1:])
        )

    touches = thinned((~motion.free).astype(float)[:, None])
    used = (thinned(still.astype(float)) < settings.sticks) & (touches < 1e-6)
    by_inertia = [thinned(one) for one in motion.by_inertia]
    shape = (0, len(kept), model.nv, 10)
    needed = motion.forces + np.asarray(model.dof_frictionloss) * direction
    return {
        "drives": np.stack([thinned(force) for force in forces]),
        "needed": thinned(needed),
        "position": thinned(position),
        "velocity": thinned(velocity),
        "acceleration": thinned(acceleration),
        "direction": thinned(direction),
        "load": thinned(load),
        "by_inertia": np.stack(by_inertia) if by_inertia else np.zeros(shape),
        "by_gravity": thinned(motion.by_gravity),
        "used": used,
        "time": kept * log.step,
    }
