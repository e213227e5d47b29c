"""How the columns of a log are read, and how well the drives explain the motion so.

A reading says which column is which joint's angle or which actuator's command, with which sign and
in which unit. Under each reading the forces that the motion needs are fitted, joint by joint, by
the drive with a gain of its own, a rotor, friction, a heavier load, and an offset, all of free
size: a model that is merely far off is explained so, and a wrong reading is not.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from dropo.core.contracts.problem import Problem
from dropo.core.records.trajectories import Ints, Trajectories
from dropo.core.services.errors import BadArgument, Incompatible
from dropo.core.services.validation import Array
from dropo.diagnosis.regression.equation import (
    EquationSettings,
    UniformLog,
    coupled_joints,
    is_floating,
    model_of,
    refuse_unsuitable,
)
from dropo.diagnosis.regression.equation import _first_width as first_width
from dropo.diagnosis.regression.equation import _stretches as stretches_of
from dropo.diagnosis.regression.kernels import REACH, apply_kernel, derivative_kernels, held_kernel
from dropo.diagnosis.search.library import robot_of
from dropo.mjmodel.dynamics.body_regressors import inverse_dynamics, rigid_forces
from dropo.mjmodel.dynamics.forces import linear_drives
from dropo.mjmodel.joints import Joint, joints, numbers_of

MOVES = 1e-9
"""A joint whose positions spread by less rests [rad, m]."""
FIRST_MOMENTS = slice(1, 4)
"""Of a body's inertial numbers, those that its weight depends on beside its mass."""
ALONG = 1e-6
"""A pull of which less than this fraction is not along the speed goes with the speed alone."""
Stretch = tuple[int, int, int]
"""A run, its first row, and the row behind the last."""


@dataclass(frozen=True)
class ReadingSettings:
    """How the forces of a log are compared under several readings.

    Attributes
    ----------
    rows : int
        Rows of the fitted data that are used, at most.
    checked_rows : int
        Rows of the data held out that are used, at most.
    delays : tuple of float
        Delays of the commands that are tried [s].
    lightest : float
        The fraction of its weight that the model has too much at most.
    block : float
        Length of the blocks of time that errors are computed from [s].
    moving : float
        A joint is evaluated if its positions spread by more standard deviations of their noise.
    fewest : int
        Rows in which a joint must move, on each side, to be evaluated.
    still : float
        A joint rests where it is slower than this fraction of its RMS speed ...
    still_noise : float
        ... or than so many standard deviations of the speed's noise.
    sticks : float
        A row is dropped for a joint that rests for this fraction of the second kernel.
    slow : float
        The speed at which the sign of dry friction fades out, in RMS speeds of a joint.
    thin : float
        Distance of the rows that are kept, in widths of the second kernel.
    """

    rows: int = 1600
    checked_rows: int = 800
    delays: tuple[float, ...] = (0.0, 0.01, 0.02, 0.03, 0.045, 0.06)
    lightest: float = 0.3
    block: float = 0.5
    moving: float = 5.0
    fewest: int = 24
    still: float = 0.05
    still_noise: float = 4.0
    sticks: float = 0.1
    slow: float = 0.02
    thin: float = 0.6


SETTINGS = ReadingSettings()


@dataclass(frozen=True)
class Reading:
    """Which column is what, with its sign and in which unit.

    Attributes
    ----------
    angles : tuple of int
        For each degree of freedom, the one whose column it is read from ...
    angle_scales : tuple of float
        ... and what that is multiplied by.
    commands : tuple of int
        For each actuator, the one whose column it is read from ...
    command_scales : tuple of float
        ... and what that is multiplied by.
    torques : frozenset of int
        The actuators whose commands are forces, not positions to follow.
    """

    angles: tuple[int, ...]
    angle_scales: tuple[float, ...]
    commands: tuple[int, ...]
    command_scales: tuple[float, ...]
    torques: frozenset[int] = frozenset()

    @property
    def of_angles(self) -> tuple[tuple[int, ...], tuple[float, ...]]:
        """What it says of angles."""
        return self.angles, self.angle_scales


@dataclass(frozen=True, eq=False)
class _SmoothedMotion:
    """R rows of a log under a reading of its angles, smoothed: (R, nv) each.

    The gains (n, nu) of each stretch are not smoothed.
    """

    moving: Array
    holding: Array
    velocity: Array
    acceleration: Array
    direction: Array
    bias: Array
    moves: NDArray[np.bool_]
    gains: tuple[Array, ...]


@dataclass(frozen=True)
class JointFit:
    """How well a joint's forces are explained.

    Attributes
    ----------
    left : float
        The squared force that is left on data held out, as a fraction of the larger of what the
        motion needs and what the drive gives there.
    by_block : (B,) array
        The same in each block held out; NaN where the joint rests.
    drive : float
        The force of one unit of the drive, as fitted.
    """

    left: float
    by_block: Array
    drive: float


@dataclass(eq=False)
class Readings:
    """The forces along a log under several readings of its columns.

    Attributes
    ----------
    problem : Problem
        Whose robot and data they are.
    fitted, checked : Trajectories
        The data that are fitted, and those held out.
    settings : ReadingSettings
        How they are compared.

    Raises
    ------
    Incompatible
        If the robot does not suit a regression, or its base is free.
    BadArgument
        If no trajectory is long enough.
    """

    problem: Problem
    fitted: Trajectories
    checked: Trajectories
    settings: ReadingSettings = SETTINGS
    _motions: dict[object, _SmoothedMotion] = field(default_factory=dict)
    _fits: dict[object, JointFit] = field(default_factory=dict)
    _smooth: dict[object, Array] = field(default_factory=dict)
    _given: dict[object, Array] = field(default_factory=dict)

    def __post_init__(self) -> None:
        simulator = robot_of(self.problem)
        refuse_unsuitable(simulator)
        if is_floating(simulator.model):
            raise Incompatible("Readings of columns are compared on fixed bases alone.")
        if coupled_joints(simulator):
            raise Incompatible("Readings of columns are compared where no joint follows another.")
        self.model = model_of(simulator)
        self.joints: list[Joint] = joints(self.model)
        fitted, checked = UniformLog(simulator, self.fitted), UniformLog(simulator, self.checked)
        equation = EquationSettings()
        self.width = first_width(fitted, equation)
        self.second = equation.second * self.width
        self.reach = int(np.ceil(REACH * (self.width + self.second) / fitted.step)) + 1
        self.every = max(1, round(self.settings.thin * self.second / fitted.step))
        of_fitted = self._stretches(fitted, self.settings.rows)
        if not of_fitted:
            raise BadArgument("No trajectory is long enough for smoothing.")
        of_checked = self._stretches(checked, self.settings.checked_rows)
        self.parts = [(fitted, one) for one in of_fitted] + [(checked, one) for one in of_checked]
        # Each row's block of time, and whether it is held out: where too
        # little is, every other block of what is fitted.
        rows = [len(self._kept(stretch)) for _, stretch in self.parts]
        time = self.every * fitted.step / self.settings.block
        pieces = [np.floor(np.arange(count) * time) for count in rows]
        last = np.cumsum([piece[-1] + 1 for piece in pieces])
        self.block = np.concatenate(
            [piece + end for piece, end in zip(pieces, [0, *last[:-1]], strict=True)]
        ).astype(np.int64)
        self.held = np.repeat(np.arange(len(rows)) >= len(of_fitted), rows)
        if not of_checked:
            self.held = self.block % 2 == 1

    @property
    def plain(self) -> Reading:
        """The columns as the problem takes them."""
        nv, nu = int(self.model.nv), int(self.model.nu)
        return Reading(tuple(range(nv)), (1.0,) * nv, tuple(range(nu)), (1.0,) * nu)

    @cached_property
    def actuators_at(self) -> dict[int, tuple[int, ...]]:
        """The actuators at each degree of freedom where they act alone."""
        rest = np.zeros((1, self.model.nv))
        return linear_drives(self.model, rest, rest).lone

    @cached_property
    def evaluated(self) -> tuple[int, ...]:
        """The driven degrees of freedom that move and are commanded in the data."""
        moves = self._motion(self.plain).moves
        fewest = self.settings.fewest
        log = self.parts[0][0]
        commands = np.concatenate(log.logged)
        spread = np.concatenate([rows - rows.mean(axis=0) for rows in log.positions]).std(axis=0)
        least = np.maximum(self.settings.moving * log.noise, MOVES)
        found = []
        for dof, drives in sorted(self.actuators_at.items()):
            rows = min(int(moves[self.held == side, dof].sum()) for side in (False, True))
            if not spread[dof] > least[dof]:
                continue
            if rows >= fewest and np.any(np.ptp(commands[:, list(drives)], axis=0) > 0):
                found.append(dof)
        return tuple(found)

    def fits(self, reading: Reading) -> dict[int, JointFit]:
        """Fit the forces of every evaluated joint.

        Parameters
        ----------
        reading : Reading
            How columns are read.

        Returns
        -------
        dict of int to JointFit
            By degree of freedom.
        """
        return {dof: self._fit(reading, dof) for dof in self.evaluated}

    @property
    def tried(self) -> int:
        """How many fits of a joint were made."""
        return len(self._fits)

    def is_servo(self, dof: int) -> bool:
        """Say whether a drive pulls it back whatever the drive's command.

        Parameters
        ----------
        dof : int
            A degree of freedom.

        Returns
        -------
        bool
        """
        return bool(np.any(self._motion(self.plain).bias[:, dof]))

    def left_loaded(self, dof: int) -> float:
        """Return what is left of a joint's forces where its body is heavier at any side.

        Parameters
        ----------
        dof : int
            The degree of freedom.

        Returns
        -------
        float
            The squared force that is left of the rows held out, as a fraction, as in `JointFit`.
        """
        body = self._joint(dof).body
        kernels = derivative_kernels(self.width, self.parts[0][0].step)
        made = []
        for log, stretch in self.parts:
            run, start, stop = stretch
            position, velocity, _ = log.motion(kernels, log.positions[run][start:stop])
            still = np.zeros_like(velocity)
            (load,) = inverse_dynamics(self.model, position, still, still, [body]).by_inertia
            made.append(self._thinned(stretch, load[:, dof, FIRST_MOMENTS]))
        loads = np.concatenate(made)
        beside = [*loads.T, *-loads.T]
        motion = self._motion(self.plain)
        return self._at_best_delay(self.plain, motion, dof, motion.bias[:, dof], beside).left

    def told_and_pull(self, dof: int) -> tuple[Array, Array] | None:
        """Return the two parts of the force of a drive that is told speeds.

        Parameters
        ----------
        dof : int
            A degree of freedom.

        Returns
        -------
        tuple of two (R,) arrays, or None
            What its command asks for, and what it pulls back, both of which are as the speed where
            the joint follows. None where it takes no speeds, or either does not change.
        """
        motion = self._motion(self.plain)
        if not self._brakes(motion, dof):
            return None
        told = self._drive(self.plain, motion, dof, 0.0, within=False)
        pull = -motion.bias[:, dof]
        return (told, pull) if np.ptp(told) > 0 and np.ptp(pull) > 0 else None

    def _brakes(self, motion: _SmoothedMotion, dof: int) -> bool:
        """Whether a drive pulls against the speed alone, as viscous friction does."""
        back, speed = motion.bias[:, dof], motion.velocity[:, dof]
        beside = back - back @ speed / max(float(speed @ speed), 1e-300) * speed
        size = float(np.linalg.norm(back))
        return size > 0 and float(np.linalg.norm(beside)) <= ALONG * size

    def command_factor(self, reading: Reading, dof: int) -> float | None:
        """Fit the unit of a servo's command beside its pull back.

        Parameters
        ----------
        reading : Reading
            How columns are read.
        dof : int
            The degree of freedom that it drives.

        Returns
        -------
        float or None
            What the command is to be multiplied by; infinite where the motion knows no pull back.
            None where there is no servo, or nothing follows the command.
        """
        motion = self._motion(reading)
        # Of viscous friction, and so of a pull against the speed alone, any size is fitted.
        if not np.any(motion.bias[:, dof]) or self._brakes(motion, dof):
            return None
        found = []
        for delay in self.settings.delays:
            drive = self._drive(reading, motion, dof, delay, within=False)
            left, sizes = self._solved(motion, dof, [drive, motion.bias[:, dof]])
            found.append((left, sizes[0], sizes[1]))
        _, along, back = min(found)
        if not along > 0:
            return None
        return float(along / back) if back > 0 else np.inf

    def left_as_stated(self, dof: int) -> float:
        """Return what the model leaves of a joint's forces as it came, nothing fitted.

        Parameters
        ----------
        dof : int
            The degree of freedom.

        Returns
        -------
        float
            The squared force that is left of the rows held out, as a fraction, as in `JointFit`.
        """
        motion = self._motion(self.plain)
        drive, needed = self._stated(motion, dof)
        return self._left(motion, dof, drive, needed, needed - drive)

    def left_with_friction(self, dof: int, rotor: float) -> float:
        """Return what is left where the drive is as stated, and the model lacks friction and rotor.

        Parameters
        ----------
        dof : int
            The degree of freedom.
        rotor : float
            Inertia of the rotor at most, in that of the joint.

        Returns
        -------
        float
            As of `left_as_stated`, with dry and viscous friction, a rotor and an offset fitted.
        """
        from scipy.optimize import lsq_linear  # slow to import

        motion = self._motion(self.plain)
        drive, needed = self._stated(motion, dof)
        columns = [
            motion.acceleration[:, dof],
            motion.direction[:, dof],
            motion.velocity[:, dof],
            np.ones(len(drive)),
        ]
        table = np.stack(columns, axis=1)
        inertia = numbers_of(self.model, self._joint(dof)).inertia
        low = [0.0, 0.0, 0.0, -np.inf]
        high = [rotor * inertia, np.inf, np.inf, np.inf]
        fitted = ~self.held & motion.moves[:, dof]
        sizes = lsq_linear(table[fitted], (drive - needed)[fitted], (low, high)).x
        return self._left(motion, dof, drive, needed, needed + table @ sizes - drive)

    def _left(
        self, motion: _SmoothedMotion, dof: int, drive: Array, needed: Array, left: Array
    ) -> float:
        """What is left (R,) of a joint's forces in rows held out, squared, as a fraction."""
        rows = self.held & motion.moves[:, dof]
        scale = max(float(np.mean(needed[rows] ** 2)), float(np.mean(drive[rows] ** 2)), 1e-300)
        return float(np.mean(left[rows] ** 2)) / scale

    def _joint(self, dof: int) -> Joint:
        """The joint of a degree of freedom."""
        return next(one for one in joints(self.model) if one.qvel == dof)

    def _stated(self, motion: _SmoothedMotion, dof: int) -> tuple[Array, Array]:
        """(R,) the force of a joint's drive, and what the motion needs, by the model as it came."""
        drive = self._drive(self.plain, motion, dof, 0.0) + motion.bias[:, dof]
        known = numbers_of(self.model, self._joint(dof))
        needed = (motion.moving + motion.holding)[:, dof]
        needed = needed + known.armature * motion.acceleration[:, dof]
        needed += known.damping * motion.velocity[:, dof]
        needed += known.friction * motion.direction[:, dof]
        return drive, needed

    def follows(self, reading: Reading, dof: int) -> float:
        """Return how much farther a servo's command goes than its joint, by their spreads.

        Parameters
        ----------
        reading : Reading
            How columns are read.
        dof : int
            The degree of freedom.
        """
        log = self.parts[0][0]
        (i, *_) = self.actuators_at[dof]
        command = np.concatenate(log.logged)[:, reading.commands[i]] * reading.command_scales[i]
        return float(command.std() / max(self._angle(reading, dof).std(), 1e-300))

    def extent(self, reading: Reading, dof: int) -> float:
        """Return how far a joint moves in all.

        Parameters
        ----------
        reading : Reading
            How columns are read.
        dof : int
            The degree of freedom.

        Returns
        -------
        float
            From one end to the other [rad, m].
        """
        return float(np.ptp(self._angle(reading, dof)))

    def _angle(self, reading: Reading, dof: int) -> Array:
        """(T,) the positions of a joint in all rows of the log."""
        logged = np.concatenate(self.parts[0][0].positions)
        return np.asarray(logged[:, reading.angles[dof]] * reading.angle_scales[dof])

    def _fit(self, reading: Reading, dof: int) -> JointFit:
        """The fit of one joint at the delay that explains most."""
        drives = self.actuators_at[dof]
        own = tuple(
            (i, reading.commands[i], reading.command_scales[i], i in reading.torques)
            for i in drives
        )
        key = (reading.of_angles, dof, own)
        if key not in self._fits:
            motion = self._motion(reading)
            back = motion.bias[:, dof]
            if reading.torques.intersection(drives):
                back = np.zeros_like(back)
            self._fits[key] = self._at_best_delay(reading, motion, dof, back)
        return self._fits[key]

    def _at_best_delay(
        self,
        reading: Reading,
        motion: _SmoothedMotion,
        dof: int,
        back: Array,
        beside: Sequence[Array] = (),
    ) -> JointFit:
        """The fit at the delay that explains most; back: a drive's pull; beside: more columns."""
        tried = []
        for delay in self.settings.delays:
            drive = self._drive(reading, motion, dof, delay) + back
            tried.append((*self._solved(motion, dof, [drive, *beside]), drive))
        _, sizes, drive = min(tried, key=lambda one: one[0])
        return self._held_out(motion, dof, sizes, drive, beside)

    def _held_out(
        self,
        motion: _SmoothedMotion,
        dof: int,
        sizes: Array,
        drive: Array,
        beside: Sequence[Array],
    ) -> JointFit:
        """How well numbers that were fitted explain the rows held out; beside: more columns."""
        rows = self.held & motion.moves[:, dof]
        columns, target = self._columns(motion, dof, [drive, *beside])
        error = (target - columns @ sizes)[rows] ** 2
        needed = (motion.moving + motion.holding)[rows, dof]
        given = float(sizes[0]) * drive[rows]
        scale = max(float(np.mean(needed**2)), float(np.mean(given**2)), 1e-300)
        blocks = np.unique(self.block[self.held])
        place = np.searchsorted(blocks, self.block[rows])
        count = np.bincount(place, minlength=len(blocks))
        of_block = np.bincount(place, weights=error, minlength=len(blocks)) / np.maximum(count, 1)
        of_block = np.where(count > 0, of_block / scale, np.nan)
        return JointFit(float(error.mean()) / scale, of_block, float(sizes[0]))

    def _solved(
        self, motion: _SmoothedMotion, dof: int, drives: Sequence[Array]
    ) -> tuple[float, Array]:
        """The squared force that is left of the fitted rows, as a fraction, and the sizes."""
        from scipy.optimize import nnls  # slow to import

        rows = ~self.held & motion.moves[:, dof]
        columns, target = self._columns(motion, dof, drives)
        columns, target = columns[rows], target[rows]
        scale = np.sqrt(np.mean(columns**2, axis=0))
        scale = np.where(scale > 0, scale, 1.0)
        q, r = np.linalg.qr(columns / scale)
        along = q.T @ target
        sizes, residual = nnls(r, along)
        square = residual**2 + target @ target - along @ along
        return float(square) / max(float(target @ target), 1e-300), np.asarray(sizes) / scale

    def _columns(
        self, motion: _SmoothedMotion, dof: int, drives: Sequence[Array]
    ) -> tuple[Array, Array]:
        """The columns of numbers that are 0 or above, those of drives first, and what they explain.

        Beside the drives: a rotor, a heavier load, dry friction; and of either sign damping and an
        offset.
        """
        holding = motion.holding[:, dof]
        velocity = motion.velocity[:, dof]
        one = np.ones_like(velocity)
        columns = [
            *drives,
            -motion.acceleration[:, dof],
            -holding,
            -motion.direction[:, dof],
            velocity,
            -velocity,
            one,
            -one,
        ]
        target = motion.moving[:, dof] + (1 - self.settings.lightest) * holding
        return np.stack(columns, axis=1), target

    def _drive(
        self,
        reading: Reading,
        motion: _SmoothedMotion,
        dof: int,
        delay: float,
        *,
        within: bool = True,
    ) -> Array:
        """(R,) the forces of a joint's drives by commands that come late.

        within: whether commands are held within their ranges.
        """
        total = np.zeros(len(self.block))
        for i in self.actuators_at[dof]:
            key: object = (i, reading.commands[i], reading.command_scales[i], delay, within)
            if self._gains_vary:
                key = (key, reading.of_angles)
            if key not in self._smooth:
                made = []
                for (log, stretch), gains in zip(self.parts, motion.gains, strict=True):
                    late = self._late(log, stretch, reading, i, delay, within=within)
                    made.append(self._thinned(stretch, (gains[:, i] * late)[:, None])[:, 0])
                self._smooth[key] = np.concatenate(made)
            total += self._smooth[key]
        return total

    @cached_property
    def _gains_vary(self) -> bool:
        """Whether what a command gives depends on the state."""
        gains = np.concatenate(self._motion(self.plain).gains)
        return bool(np.any(np.ptp(gains, axis=0) > 1e-9 * np.abs(gains).max(axis=0)))

    def _late(
        self,
        log: UniformLog,
        stretch: Stretch,
        reading: Reading,
        i: int,
        delay: float,
        *,
        within: bool,
    ) -> Array:
        """(n,) the smoothed command of an actuator in a stretch."""
        run, start, stop = stretch
        kernel = held_kernel(self.width, log.step, delay)
        command = self._command(log, run, reading, i, within=within)
        return apply_kernel(kernel, command[start:stop, None])[:, 0]

    def _command(
        self, log: UniformLog, run: int, reading: Reading, i: int, *, within: bool
    ) -> Array:
        """(n,) the command of an actuator in a run."""
        key = (log, run, i, reading.commands[i], reading.command_scales[i], within)
        if key not in self._given:
            logged = log.logged[run]
            commands = logged.copy()
            commands[:, i] = reading.command_scales[i] * logged[:, reading.commands[i]]
            if within:
                commands = log.given(commands)
            self._given[key] = commands[:, i].copy()
        return self._given[key]

    def _motion(self, reading: Reading) -> _SmoothedMotion:
        """The rows under a reading of the angles."""
        key = reading.of_angles
        if key not in self._motions:
            made = [self._part(log, stretch, reading) for log, stretch in self.parts]
            names = made[0][0]
            whole = {name: np.concatenate([part[name] for part, _ in made]) for name in names}
            moves = whole.pop("still") < self.settings.sticks
            gains = tuple(one for _, one in made)
            self._motions[key] = _SmoothedMotion(**whole, moves=moves, gains=gains)
        return self._motions[key]

    def _part(
        self, log: UniformLog, stretch: Stretch, reading: Reading
    ) -> tuple[dict[str, Array], Array]:
        """The arrays of one stretch, and the gains of its drives."""
        run, start, stop = stretch
        angles = log.positions[run][start:stop][:, reading.angles] * reading.angle_scales
        kernels = derivative_kernels(self.width, log.step)
        position, velocity, acceleration = log.motion(kernels, angles)
        moving, holding = rigid_forces(self.model, position, velocity, acceleration)
        speed = np.sqrt(np.mean(velocity**2, axis=0))
        sign = np.tanh(velocity / np.maximum(self.settings.slow * speed, 1e-300))
        noise = log.noise[list(reading.angles)] * np.abs(reading.angle_scales)
        noise = self.settings.still_noise * noise * np.sqrt(np.sum(kernels[1] ** 2))
        still = np.abs(velocity) < np.maximum(self.settings.still * speed, noise)
        drives = linear_drives(self.model, position, velocity)
        found = {
            "moving": moving,
            "holding": holding,
            "velocity": velocity,
            "acceleration": acceleration,
            "direction": apply_kernel(kernels[0], sign),
            "bias": drives.bias,
            "still": still.astype(float),
        }
        return {name: self._thinned(stretch, rows) for name, rows in found.items()}, drives.gains

    def _kept(self, stretch: Stretch) -> Ints:
        """The rows of a stretch that are kept, counted from its first."""
        _, start, stop = stretch
        return np.arange(self.reach, stop - start - self.reach, self.every)

    def _thinned(self, stretch: Stretch, rows: Array) -> Array:
        """Rows (n, k) of a stretch after the second kernel, those that are kept."""
        return apply_kernel(self._second_kernel, rows)[self._kept(stretch)]

    @cached_property
    def _second_kernel(self) -> Array:
        """The weights of the second smoothing."""
        return derivative_kernels(self.second, self.parts[0][0].step)[0]

    def _stretches(self, log: UniformLog, rows: int) -> list[Stretch]:
        """The stretches of a side that are used, so many rows in all."""
        equation = EquationSettings(rows=rows)
        found = stretches_of(log, self.reach, equation)
        most = max(1, rows // max(1, int(equation.stretch * self.reach)))
        chosen = np.linspace(0, len(found) - 1, min(most, len(found))).astype(int)
        return [found[i] for i in chosen.tolist()]


def sides(problem: Problem, checked: float) -> tuple[Trajectories, Trajectories]:
    """Divide a problem's data into those that are fitted and those held out.

    Parameters
    ----------
    problem : Problem
        Any. The data that it holds out itself are held out.
    checked : float
        Else this fraction of the runs, or of the end of each where there are few.

    Returns
    -------
    fitted, held_out : Trajectories
    """
    data = problem.trajectories
    if problem.held_out is not None:
        return data, problem.held_out
    every = round(1 / checked)
    is_held_out = np.zeros(len(data), dtype=bool)
    for number, (start, stop) in enumerate(data.spans):
        if len(data.spans) < every:
            is_held_out[stop - round(checked * (stop - start)) : stop] = True
        elif number % every == every - 1:
            is_held_out[start:stop] = True
    return data.rows(np.flatnonzero(~is_held_out)), data.rows(np.flatnonzero(is_held_out))
