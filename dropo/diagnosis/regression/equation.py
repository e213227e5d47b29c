"""The equation of motion along a log, smoothed and thinned: drives = what the motion needs.

Positions and commands pass the same even kernel, so that commands lag exactly as positions do.
Then both sides of the equation pass a second one, so that no row rests on a raw second derivative.
Of machines with a floating base, contact forces are projected out before that.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dropo.core.contracts.effect import Model
from dropo.core.contracts.problem import Problem
from dropo.core.numerics.robust_statistics import deviation
from dropo.core.records.trajectories import Ints, Trajectories
from dropo.core.services.errors import BadArgument, Incompatible
from dropo.core.services.validation import Array
from dropo.diagnosis.regression.kernels import (
    REACH,
    apply_kernel,
    derivative_kernels,
    held_kernel,
    lagging_kernel,
)
from dropo.diagnosis.search.library import robot_of
from dropo.mjmodel.bodies import moving_bodies
from dropo.mjmodel.dynamics.body_regressors import inverse_dynamics
from dropo.mjmodel.dynamics.contact_free import projectors
from dropo.mjmodel.dynamics.forces import LinearDrives, linear_drives
from dropo.mjmodel.followers import Follower, couplings_of
from dropo.mjmodel.joints import Joint, all_joints, dry_frictions, joints, numbers_of
from dropo.mjmodel.options import physics_step
from dropo.mjmodel.robot_simulator import RobotSimulator
from dropo.mjmodel.tendons import FixedTendon, fixed_tendons
from dropo.simulators.mujoco.layers import change_commands, clamp


@dataclass(frozen=True)
class EquationSettings:
    """How a log becomes rows of the equation of motion.

    Attributes
    ----------
    narrowest : float
        Smallest width of the first kernel, in rows.
    widest : float
        Largest width of the first kernel, in rows.
    noise : float
        The first kernel is widened until the noise of accelerations is this fraction of them.
    second : float
        Width of the second kernel, in widths of the first.
    thin : float
        Distance of the rows that are kept, in widths of the second kernel.
    rows : int
        Largest number of rows of the log that are used, in stretches spread over all of it.
    stretch : float
        Length of the shortest stretch, in reaches of both kernels.
    still : float
        A joint rests where it is slower than this fraction of its RMS speed.
    still_noise : float
        A joint also rests where it is slower than this many standard deviations of the speed's
        noise.
    stuck : float
        Speed below which a joint rests in any case [rad/s, m/s].
    sticks : float
        A row is dropped for a joint that rests for this fraction of the second kernel.
    share : float
        Where contact forces are projected out, a row counts for a degree of freedom of whose force
        at least this fraction is left.
    slow : float
        The speed at which the sign of dry friction fades out, in RMS speeds of a joint.
    delays : float
        Longest delay of commands that is tried, in control steps.
    longest_delay : float
        Longest delay of commands that is tried, whatever the control step [s].
    lagging : bool
        Whether delays are time constants of first-order lags, beside the delay that the model's
        simulation has.
    block : float
        About the length of the blocks of time that errors are computed from [s].
    blocks : int
        Smallest number of blocks, where the log is short.
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
    stuck: float = 1e-9
    sticks: float = 0.1
    share: float = 0.05
    slow: float = 0.02
    delays: float = 10.0
    longest_delay: float = 0.06
    lagging: bool = False
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
    lagging : bool
        Whether they are those of lags (`EquationSettings.lagging`).
    needed : (R, nv) array
        Forces that the motion needs by the model [N, N m].
    position, velocity, acceleration, direction : (R, nv) arrays
        Of each degree of freedom, [rad, m] and their derivatives; the direction of motion is
        between -1 and 1.
    tendons : sequence of FixedTendon
        Those of the model, T of them.
    along_tendons : (R, T) array
        The direction of motion along each.
    load : (R, nv) array
        The direction of motion times the size of the force that the motion needs without friction.
    by_inertia : (B, R, nv, 10) array
        Derivatives of the forces by each body's inertial numbers.
    by_gravity : (R, nv, 3) array
        Derivatives of the forces by gravity.
    by_joint : mapping of str to (R, nv, nv) array
        Of a floating base or of coupled joints: the forces, without those of contacts and of
        couplings, that a force at each degree of freedom gives: in proportion to its
        "acceleration", "velocity", "direction", "position" or "drive", or of size "one". Else
        empty.
    floating : bool
        Whether the base is free, and the forces of contacts are projected out.
    used : (R, nv) array of bool
        Whether the row counts for the joint: it moves, nothing touches.
    block : (R,) int array
        The block of time that a row belongs to.
    driven : (nv,) array of bool
        Whether an actuator acts there.
    inertia : (nv,) array
        Of each joint as the model has it [kg, kg m^2]; 0 of a floating base.
    width : float
        Of the first kernel [s].
    """

    drives: Array
    delays: Array
    lagging: bool
    needed: Array
    position: Array
    velocity: Array
    acceleration: Array
    direction: Array
    tendons: Sequence[FixedTendon]
    along_tendons: Array
    load: Array
    by_inertia: Array
    by_gravity: Array
    by_joint: Mapping[str, Array]
    floating: bool
    used: NDArray[np.bool_]
    block: Ints
    driven: NDArray[np.bool_]
    inertia: Array
    width: float

    def __len__(self) -> int:
        return len(self.block)

    def column(self, quantity: str, dof: int) -> Array:
        """Return the forces (R, nv) of a force at one degree of freedom.

        Parameters
        ----------
        quantity : str
            What it is in proportion to: "acceleration", "velocity", "direction" or "position"; or
            "one"; where `by_joint` has it also "drive".
        dof : int
            Where it acts.

        Returns
        -------
        (R, nv) array
            The forces at all degrees of freedom [N, N m for a size of 1].
        """
        if self.by_joint:
            return self.by_joint[quantity][:, :, dof]
        found = np.zeros_like(self.velocity)
        found[:, dof] = 1.0 if quantity == "one" else getattr(self, quantity)[:, dof]
        return found


def refuse_unsuitable(simulator: RobotSimulator) -> None:
    """Refuse robots whose equation of motion cannot be written from joint angles and commands.

    Parameters
    ----------
    simulator : RobotSimulator
        The robot.

    Raises
    ------
    Incompatible
        If a joint is a ball joint or its position is not observed, if the model has equality
        constraints that `coupled_joints` refuses, or if an actuator's force is not known.
    """
    model = simulator.model
    if any(joint.kind == "ball" for joint in all_joints(model)):
        raise Incompatible(
            "A regression over inverse dynamics needs hinges and slides, from a fixed base or from "
            "a free one; this model has a ball joint."
        )
    if not _drives_at_rest(simulator).driven.any():
        raise Incompatible(
            "A regression over inverse dynamics needs a drive whose force is known: without one, "
            "all forces and masses could be larger by one factor."
        )
    following = {follower.name for follower in coupled_joints(simulator)}
    observed = simulator.layout.observed("qpos")
    for joint in all_joints(model):
        if joint.name in following:
            continue
        if not observed.issuperset(range(joint.qpos, joint.qpos + len(joint.units("qpos")))):
            raise Incompatible(
                f"A regression over inverse dynamics needs the position of every joint; that of "
                f"{joint.name!r} is not observed."
            )


def coupled_joints(simulator: RobotSimulator) -> list[Follower]:
    """Find the joints that follow others by equality constraints.

    Parameters
    ----------
    simulator : RobotSimulator
        The robot.

    Returns
    -------
    list of Follower
        Joints without a drive, whose forces act at their leaders.

    Raises
    ------
    Incompatible
        If there are equality constraints of another kind, or the base is free.
    """
    model = simulator.model
    if not model.neq:
        return []
    try:
        found = couplings_of(model, np.flatnonzero(_drives_at_rest(simulator).driven).tolist())
    except Incompatible as error:
        raise Incompatible(
            f"A regression over inverse dynamics needs forces that are known. {error} Diagnose "
            "without --quick, by simulations, which know them."
        ) from None
    if found and is_floating(model):
        raise Incompatible(
            "A regression over inverse dynamics knows coupled joints on fixed bases alone: "
            "diagnose without --quick."
        )
    return found


def independent_joints(simulator: RobotSimulator) -> list[Joint]:
    """List the joints but for those that follow others (`coupled_joints`).

    Parameters
    ----------
    simulator : RobotSimulator
        The robot.

    Returns
    -------
    list of Joint
        What a follower has acts at its leader as if that had it.
    """
    following = {follower.name for follower in coupled_joints(simulator)}
    return [joint for joint in joints(simulator.model) if joint.name not in following]


def is_floating(model: Model) -> bool:
    """Tell whether a model has degrees of freedom that are no joints, as those of a free base.

    Parameters
    ----------
    model : Model
        The model.

    Returns
    -------
    bool
    """
    return len(joints(model)) < model.nv


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
        If the robot is not suitable (`refuse_unsuitable`), or every command is 0.
    BadArgument
        If no trajectory is long enough, or nothing moves.
    """
    simulator = robot_of(problem)
    refuse_unsuitable(simulator)
    log = UniformLog(simulator, trajectories)
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
    every = [part.pop("by_joint") for part in parts]
    joined["by_joint"] = {name: np.concatenate([one[name] for one in every]) for name in every[0]}
    for name in parts[0]:
        axis = 1 if name in ("drives", "by_inertia") else 0
        joined[name] = np.concatenate([part[name] for part in parts], axis=axis)
    driven = _drives_at_rest(simulator).driven
    _refuse_nothing(joined["drives"], joined["used"], driven)
    inertia = np.zeros(model.nv)
    floating = is_floating(model)
    if not floating:
        for joint in joints(model):
            inertia[joint.qvel] = numbers_of(model, joint).inertia
    return Equation(
        **joined,
        tendons=fixed_tendons(model),
        floating=floating,
        delays=delays,
        lagging=settings.lagging,
        driven=driven,
        inertia=inertia,
        width=width,
    )


def _refuse_nothing(drives: Array, used: NDArray[np.bool_], driven: NDArray[np.bool_]) -> None:
    """Refuse rows (D, R, nv) and (R, nv) in which no drive acts, or none that counts."""
    if not used.any():
        raise BadArgument(
            "No row of the log counts for a regression over inverse dynamics: in all of them "
            "joints rest, are beyond their ranges, or something touches. Check the units of "
            "the positions and the ranges of the model's joints."
        )
    if not drives[:, :, driven].any():
        raise Incompatible(
            "A regression over inverse dynamics needs drives that act: every command is 0, as of "
            "motors that are off. Where they were not, the log's commands are missing."
        )


def model_of(simulator: RobotSimulator) -> Model:
    """Return the model of a robot with its fixed effects written into it.

    Parameters
    ----------
    simulator : RobotSimulator
        The robot.

    Returns
    -------
    Model
        A model with the fixed effects that are numbers of it.
    """
    written = [one for one in simulator.fixed if one[0].model is not None and not one[0].general]
    return simulator.without_parameters().model_of(np.zeros(0), written)


def _drives_at_rest(simulator: RobotSimulator) -> LinearDrives:
    """The drives of the model at one state, for the places where they act."""
    model = simulator.model
    return linear_drives(model, np.zeros((1, model.nq)), np.zeros((1, model.nv)))


class UniformLog:
    """Positions and commands of each run, on a uniform grid.

    Parameters
    ----------
    simulator : RobotSimulator
        The robot, with n joints' positions (nq,) among its observations, but for those that follow
        others.
    trajectories : Trajectories
        What was measured.

    Attributes
    ----------
    step : float
        The control step [s].
    joints : sequence of Joint
        All joints, free ones too.
    nv : int
        Number of degrees of freedom.
    followers : list of Follower
        The joints that follow others.
    positions : list of (T, nq) array
        Of each run [rad, m]; the signs of quaternions do not change from row to row.
    commands : list of (T, nu) array
        Of each run, within the actuators' limits, as fixed effects change them.

    Raises
    ------
    Incompatible
        If a position is not observed.
    """

    def __init__(self, simulator: RobotSimulator, trajectories: Trajectories):
        self.step = simulator.control_step
        model = simulator.model
        self.joints = all_joints(model)
        self.nv = int(model.nv)
        place = {
            column.place: i
            for i, column in enumerate(simulator.layout.columns)
            if column.field == "qpos"
        }
        self.followers = coupled_joints(simulator)
        following = [one for one in self.followers if one.places[0] not in place]
        missing = sorted(set(range(model.nq)) - set(place) - {one.places[0] for one in following})
        if missing:
            raise Incompatible(
                f"qpos[{missing[0]}] is not observed. A regression over inverse dynamics needs "
                "every position."
            )
        leaders = {one.places[0]: one.places[1] for one in following}
        columns = [place[leaders.get(i, i)] for i in range(model.nq)]
        self.positions: list[Array] = []
        self.logged: list[Array] = []
        self._simulator = simulator
        for start, stop in trajectories.spans:
            rows = trajectories.observations[start:stop]
            last = trajectories.next_observations[stop - 1 : stop]
            positions = np.concatenate([rows, last])[:, columns]
            for one in following:
                own, leader = one.places
                positions[:, own] = one.position(positions[:, leader])
            self.positions.append(self._continued(positions))
            commands = np.zeros((stop - start + 1, model.nu))
            commands[:-1, simulator.controls] = trajectories.actions[start:stop]
            commands[-1] = commands[-2]
            self.logged.append(commands)
        self.commands = [self.given(commands) for commands in self.logged]

    def given(self, commands: Array) -> Array:
        """Return what the model makes of commands.

        Parameters
        ----------
        commands : (n, nu) array
            As logged.

        Returns
        -------
        (n, nu) array
            Within their ranges, with the model's own effects on commands.
        """
        simulator, model = self._simulator, self._simulator.model
        fixed = [
            (instance, magnitudes)
            for instance, magnitudes in simulator.fixed
            if instance.command is not None or instance.actuation is not None
        ]
        commands = clamp(commands, model)
        if fixed:
            fine = change_commands(commands, model, simulator.frame_skip, fixed)
            commands = fine.reshape(len(commands), simulator.frame_skip, model.nu).mean(axis=1)
        return commands

    def _continued(self, rows: Array) -> Array:
        """Positions (n, nq) whose quaternions do not change their sign from row to row."""
        for joint in self.joints:
            turn = joint.quaternion()
            if turn is not None:
                own = rows[:, joint.qpos + turn.start : joint.qpos + turn.stop]
                flips = np.sum(own[1:] * own[:-1], axis=1) < 0
                own[1:] *= np.where(np.cumsum(flips) % 2, -1.0, 1.0)[:, None]
        return rows

    @cached_property
    def noise(self) -> Array:
        """(nv,) standard deviation of the positions' noise, from their third differences."""
        thirds = [np.diff(rows, 3, axis=0) for rows in self.positions if len(rows) > 3]
        own = deviation(np.concatenate(thirds)) / np.sqrt(20.0)
        found = np.empty(self.nv)
        for joint in self.joints:
            places, turn = _places(joint)
            found[places.velocity] = own[places.position]
            if turn is not None:
                found[turn.velocity] = 2 * np.sqrt(np.mean(own[turn.position] ** 2))
        return found

    def motion(self, kernels: Array, rows: Array) -> tuple[Array, Array, Array]:
        """Smooth a run's positions, and differentiate them.

        Parameters
        ----------
        kernels : (3, k) array
            Kernels of the value and of its first and second derivatives [1, 1/s, 1/s^2].
        rows : (n, nq) array
            Positions of a run [rad, m].

        Returns
        -------
        position : (n, nq) array
            Smoothed positions, with quaternions of length 1.
        velocity, acceleration : (n, nv) array
            Their derivatives; of a free base the angular ones are in the body's frame.
        """
        value, slope, curve = (apply_kernel(kernel, rows) for kernel in kernels)
        velocity = np.empty((len(rows), self.nv))
        acceleration = np.empty_like(velocity)
        for joint in self.joints:
            places, turn = _places(joint)
            velocity[:, places.velocity] = slope[:, places.position]
            acceleration[:, places.velocity] = curve[:, places.position]
            if turn is not None:
                quaternion = value[:, turn.position]
                size = np.sum(quaternion**2, axis=1, keepdims=True)
                for out, change in ((velocity, slope), (acceleration, curve)):
                    out[:, turn.velocity] = _turned(quaternion, change[:, turn.position]) / size
                value[:, turn.position] = quaternion / np.sqrt(size)
        return value, velocity, acceleration

    def speeds(self, width: float) -> list[Array]:
        """Smooth the velocities of each run.

        Parameters
        ----------
        width : float
            Width of the kernel [s].

        Returns
        -------
        list of (n, nv) array
            Velocities [rad/s, m/s].
        """
        kernels = derivative_kernels(width, self.step)
        return [self.motion(kernels, rows)[1] for rows in self.positions]


@dataclass(frozen=True)
class _CoordinateSlices:
    """Where numbers are among positions and velocities."""

    position: slice
    velocity: slice


def _places(joint: Joint) -> tuple[_CoordinateSlices, _CoordinateSlices | None]:
    """Where a joint's straight motions or angles are, and of a free one its rotation."""
    p, v = joint.qpos, joint.qvel
    if joint.quaternion() is None:
        return _CoordinateSlices(slice(p, p + 1), slice(v, v + 1)), None
    return _CoordinateSlices(slice(p, p + 3), slice(v, v + 3)), _CoordinateSlices(
        slice(p + 3, p + 7), slice(v + 3, v + 6)
    )


def _turned(quaternion: Array, change: Array) -> Array:
    """(n, 3) 2 Im(conj(q) q'), of the first derivative of q the angular velocity in the body's
    frame, and of the second, as |q'| is real, the angular acceleration.
    """
    real, imaginary = quaternion[:, :1], quaternion[:, 1:]
    cross = np.cross(imaginary, change[:, 1:])
    return np.asarray(2 * (real * change[:, 1:] - change[:, :1] * imaginary - cross))


def _delays(simulator: RobotSimulator, settings: EquationSettings) -> Array:
    """(D,) the delays of commands that are tried [s].

    A simulation acts half a physics step early, as if commands came before they do.
    """
    step = simulator.control_step
    longest = min(settings.delays * step, settings.longest_delay)
    return np.linspace(-physics_step(simulator.model), longest, 25)


def own_delay(delays: Array) -> float:
    """Return the delay that the model's simulation has: it acts half a physics step early.

    Parameters
    ----------
    delays : (D,) array
        Those of an equation [s].

    Returns
    -------
    float
        [s].
    """
    return float(delays[0]) / 2


def _late_kernel(width: float, step: float, lagging: bool, own: float, delay: float) -> Array:
    """The weights of commands that are late, or lag by what a delay is more than the model's."""
    if lagging and delay > own:
        return lagging_kernel(width, step, own, delay - own)
    return held_kernel(width, step, delay)


def _first_width(log: UniformLog, settings: EquationSettings) -> float:
    """The width of the first kernel [s] at which accelerations stand out from noise."""
    noise = log.noise
    width = settings.narrowest * log.step
    # Both kernels must fit into the longest run several times.
    longest = max(map(len, log.positions))
    fits = longest / (REACH * settings.stretch * (1 + settings.second)) / 3
    widest = max(settings.narrowest, min(settings.widest, fits))
    while width < widest * log.step:
        kernels = derivative_kernels(width, log.step)
        kernel = kernels[2]
        found = [log.motion(kernels, rows)[2] for rows in log.positions]
        size = np.sqrt(np.mean(np.concatenate(found) ** 2, axis=0))
        by_noise = noise * np.sqrt(np.sum(kernel**2)) / np.sqrt(2 * settings.second)
        if np.median(by_noise / np.maximum(size, 1e-300)) < settings.noise:
            break
        width *= 1.2
    return width


def _stretches(
    log: UniformLog, reach: int, settings: EquationSettings
) -> list[tuple[int, int, int]]:
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
    log: UniformLog,
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
    position, velocity, acceleration = log.motion(kernels, rows)
    bodies = [body for body, _ in moving_bodies(model)]
    motion = inverse_dynamics(model, position, velocity, acceleration, bodies)
    commands = log.commands[run][start:stop]
    drives = linear_drives(model, position, velocity)
    kernel = partial(_late_kernel, width, log.step, settings.lagging, own_delay(delays))
    forces = [drives.forces(apply_kernel(kernel(delay), commands)) for delay in delays.tolist()]
    still = _is_still(log, velocity, kernels[1], speed, settings)
    # Dry friction acted before the first kernel: it passes that kernel as all other forces did.
    sign = _signs(velocity, settings.slow * speed)
    direction = apply_kernel(kernels[0], sign)
    along, rubbing = _tendons(model, velocity, kernels[0], settings)
    rubbing += dry_frictions(model) * direction

    smooth = derivative_kernels(second, log.step)[0]
    every = max(1, round(settings.thin * second / log.step))
    kept = np.arange(reach, len(rows) - reach, every)

    def thinned(values: Array) -> Array:
        return apply_kernel(smooth, values.reshape(len(values), -1))[kept].reshape(
            (len(kept), *values.shape[1:])
        )

    needed = motion.forces
    by_inertia = motion.by_inertia
    by_gravity = motion.by_gravity
    at_dofs = _at_dofs(log, position)
    by_joint: dict[str, Array] = {}
    free = _free_of_constraints(model, log.followers, position, velocity, still, REACH * width)
    if free is not None:
        own = {
            "acceleration": acceleration,
            "velocity": velocity,
            "direction": direction,
            "position": at_dofs,
            "one": np.ones_like(velocity),
            "drive": forces[int(np.abs(delays).argmin())],
        }
        by_joint = {name: thinned(free * values[:, None]) for name, values in own.items()}
        forces = [_projected(free, force) for force in forces]
        needed = _projected(free, needed)
        rubbing = _projected(free, rubbing)
        by_inertia = np.stack([free @ one for one in by_inertia])
        by_gravity = free @ by_gravity
    if free is not None and is_floating(model):
        used = thinned(np.diagonal(free, axis1=1, axis2=2)) > settings.share
    else:
        touches = thinned((~motion.free).astype(float)[:, None])
        used = (thinned(still.astype(float)) < settings.sticks) & (touches < 1e-6)
        used[:, [follower.dofs[0] for follower in log.followers]] = False
    load = apply_kernel(kernels[0], np.abs(needed) * sign)
    shape = (0, len(kept), model.nv, 10)
    thin_inertia = [thinned(one) for one in by_inertia]
    return {
        "drives": np.stack([thinned(force) for force in forces]),
        "needed": thinned(needed + rubbing),
        "position": thinned(at_dofs),
        "velocity": thinned(velocity),
        "acceleration": thinned(acceleration),
        "direction": thinned(direction),
        "along_tendons": thinned(along),
        "load": thinned(load),
        "by_inertia": np.stack(thin_inertia) if thin_inertia else np.zeros(shape),
        "by_gravity": thinned(by_gravity),
        "by_joint": by_joint,
        "used": used,
        "time": kept * log.step,
    }


def _signs(speeds: Array, slow: Array) -> Array:
    """(n, k) the signs of speeds, which fade out where these are slow (k,)."""
    return np.asarray(np.tanh(speeds / np.maximum(slow, 1e-300)))


def _is_still(
    log: UniformLog, velocity: Array, kernel: Array, speed: Array, settings: EquationSettings
) -> NDArray[np.bool_]:
    """(n, nv) whether a joint rests, by velocities that a kernel makes; speed: (nv,) its usual."""
    noise = log.noise * np.sqrt(np.sum(kernel**2))
    least = np.maximum(settings.still * speed, settings.still_noise * noise)
    return np.asarray(np.abs(velocity) < np.maximum(least, settings.stuck))  # stuck: never moves


def _tendons(
    model: Model, velocity: Array, kernel: Array, settings: EquationSettings
) -> tuple[Array, Array]:
    """The direction of motion (n, T) along fixed tendons, and the forces (n, nv) of their own dry
    friction.
    """
    lines = fixed_tendons(model)
    moments = np.array([line.moments for line in lines]).reshape(len(lines), model.nv)
    speeds = velocity @ moments.T
    signs = _signs(speeds, settings.slow * np.sqrt(np.mean(speeds**2, axis=0)))
    along = apply_kernel(kernel, signs)
    return along, (along * [line.friction for line in lines]) @ moments


def _at_dofs(log: UniformLog, position: Array) -> Array:
    """(n, nv) the positions of joints at their degrees of freedom, 0 of a free base."""
    found = np.zeros((len(position), log.nv))
    for joint in log.joints:
        if joint.quaternion() is None:
            found[:, joint.qvel] = position[:, joint.qpos]
    return found


def _free_of_constraints(
    model: Model,
    followers: Sequence[Follower],
    position: Array,
    velocity: Array,
    still: NDArray[np.bool_],
    time: float,
) -> Array | None:
    """(n, nv, nv) what takes contacts out of forces, or couplings; None where there are none.

    A coupling's forces do no work: those at a follower act at its leader, by its speed in that of
    the leader.
    """
    if is_floating(model):
        return projectors(model, position, velocity, still, time)
    if not followers:
        return None
    found = np.tile(np.eye(position.shape[1]), (len(position), 1, 1))
    for one in followers:
        own, leader = one.dofs
        found[:, own, own] = 0.0
        found[:, leader, own] = one.slope(position[:, one.places[1]])
    return found


def _projected(free: Array, forces: Array) -> Array:
    """(n, nv) forces without what projections (n, nv, nv) take out."""
    return np.asarray((free @ forces[:, :, None])[:, :, 0])
