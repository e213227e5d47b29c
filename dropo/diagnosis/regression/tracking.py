"""How joints of servos follow commands, their own or others'.

Positions are held against the commands of position servos, speeds against those of velocity servos:
a sign, an exchange or another unit of one of both columns shows there, whatever the forces are.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dropo.core.contracts.problem import Problem
from dropo.core.services.validation import Array
from dropo.diagnosis.regression.equation import UniformLog
from dropo.diagnosis.regression.readings import Readings
from dropo.diagnosis.search.library import robot_of
from dropo.mjmodel.dynamics.forces import position_servos
from dropo.mjmodel.joints import Joint

UNITS: dict[str, dict[float, str]] = {
    "hinge": {
        np.pi / 180: "degrees to radians",
        180 / np.pi: "radians that were taken for degrees",
        2 * np.pi: "turns to radians",
        0.5 / np.pi: "radians that were taken for turns",
        1e-3: "thousandths",
    },
    "slide": {
        1e-3: "millimetres to metres",
        1e3: "metres that were taken for millimetres",
        1e-2: "centimetres to metres",
        1e2: "metres that were taken for centimetres",
    },
}
"""What an angle or a length is multiplied by where its unit was mistaken, and in words."""


@dataclass(frozen=True)
class TrackingSettings:
    """When a joint follows a command.

    Attributes
    ----------
    follows : float
        Correlation with commands from which a joint follows one.
    better : float
        By how much the correlation with another command must be larger.
    closely : float
        Correlation from which a joint follows closely: one that moves as far as its servo's command
        says is wired right, and one that does not is wired wrong.
    factor : float
        A factor above this, or below one over it, is another unit.
    known : float
        Relative distance from a known unit within which a factor is that unit.
    moving : float
        A command that moves less than this fraction of the largest is not looked at.
    lag : float
        Longest time by which a joint follows its command [s].
    lags : int
        Number of such times that are tried.
    """

    follows: float = 0.6
    better: float = 0.3
    closely: float = 0.9
    factor: float = 3.0
    known: float = 0.2
    moving: float = 0.02
    lag: float = 0.3
    lags: int = 16

    def is_unit(self, factor: float) -> bool:
        """Tell whether a factor is that of another unit.

        Parameters
        ----------
        factor : float
            Above 0, or of the wrong sign.

        Returns
        -------
        bool
        """
        return not 1 / self.factor < factor < self.factor


@dataclass(frozen=True)
class Misread:
    """What is wrong with the columns of joints that follow commands otherwise than they should.

    Attributes
    ----------
    kind : {"sign", "exchange", "unit_factor"}
        What.
    joints : tuple of Joint
        One, or the two that are exchanged.
    slope : float
        How far the joint moves for its command.
    """

    kind: str
    joints: tuple[Joint, ...]
    slope: float = 1.0


@dataclass(frozen=True, eq=False)
class Tracking:
    """The n joints of servos beside all their commands.

    Attributes
    ----------
    joints : sequence of Joint
        In the order of the rows.
    correlation : (n, n) array
        Of each joint with each command, at the lag at which it is largest.
    slopes : (n,) array
        How far each moves for its own command.
    moves : (n,) array of bool
        Which move at all.
    settings : TrackingSettings
        What counts.
    """

    joints: Sequence[Joint]
    correlation: Array
    slopes: Array
    moves: NDArray[np.bool_]
    settings: TrackingSettings

    @property
    def following(self) -> frozenset[int]:
        """The degrees of freedom that follow their own commands closely, and as far."""
        found = set()
        for j in np.flatnonzero(self.moves).tolist():
            own = self.correlation[j, j]
            if own > self.settings.closely and not self.settings.is_unit(self.slopes[j]):
                found.add(self.joints[j].qvel)
        return frozenset(found)

    @property
    def misread_closely(self) -> list[Misread]:
        """What is certain, as a joint follows some command closely; of units the known ones."""
        return [
            one
            for one in self._misread(self.settings.closely)
            if one.kind != "unit_factor" or self._is_known(one.slope, one.joints[0].kind)
        ]

    @property
    def misread(self) -> list[Misread]:
        """What is likely, where nothing but this tells."""
        return self._misread(self.settings.follows)

    def _misread(self, least: float) -> list[Misread]:
        """What is wrong with joints that follow some command by a correlation of so much."""
        exchanged = self._exchanged(least)
        found = [Misread("exchange", (self.joints[i], self.joints[j])) for i, j in exchanged]
        mixed = {i for pair in exchanged for i in pair}
        for j in np.flatnonzero(self.moves).tolist():
            if j in mixed or abs(self.correlation[j, j]) < least:
                continue
            slope = float(self.slopes[j])
            if slope < 0:
                found.append(Misread("sign", (self.joints[j],)))
            elif self.settings.is_unit(slope):
                found.append(Misread("unit_factor", (self.joints[j],), slope))
        return found

    def _exchanged(self, least: float) -> list[tuple[int, int]]:
        """Pairs of joints each of which follows the other's command, and not its own."""
        size = np.where(self.moves, np.abs(self.correlation), 0.0)
        found = []
        for j in np.flatnonzero(self.moves).tolist():
            other = int(np.argmax(size[j]))
            back = int(np.argmax(size[other]))
            beyond = size[j, other] - size[j, j]
            alone = size[j, other] > least and beyond > self.settings.better
            if other > j and back == j and alone:
                found.append((j, other))
        return found

    def _is_known(self, factor: float, kind: str) -> bool:
        """Whether a factor is close to that of a unit of that kind of joint, or one over it."""
        size = abs(np.log(factor))
        near = self.settings.known
        return any(abs(size - abs(np.log(known))) < near for known in UNITS[kind])


def position_tracking(problem: Problem, settings: TrackingSettings) -> Tracking | None:
    """Hold the joints of position servos against their commands.

    Parameters
    ----------
    problem : Problem
        A robot, and what was measured.
    settings : TrackingSettings
        What counts.

    Returns
    -------
    Tracking or None
        None where there is no position servo.
    """
    simulator = robot_of(problem)
    servos = position_servos(simulator.model)
    if not servos:
        return None
    log = UniformLog(simulator, problem.trajectories)
    joint_columns = [joint.qpos for joint, _ in servos]
    servo_columns = [servo for _, servo in servos]
    positions = [rows[:, joint_columns] for rows in log.positions]
    commands = [rows[:, servo_columns] for rows in log.commands]
    sizes = np.concatenate(_centred(commands)).std(axis=0)
    spread = np.concatenate(_centred(positions)).std(axis=0)
    moves = (sizes > settings.moving * sizes.max()) & (spread > 1e-9 * max(spread.max(), 1e-300))
    longest = min(settings.lag / log.step, max(map(len, positions)) / 4)
    lags = np.linspace(0.0, longest, settings.lags)
    every = [_correlation(positions, commands, int(lag)) for lag in np.unique(lags.round())]
    best = np.argmax(np.abs(every), axis=0)
    correlation = np.take_along_axis(np.array(every), best[None], axis=0)[0]
    slopes = np.diag(correlation) * spread / np.where(moves, sizes, np.inf)
    return Tracking([joint for joint, _ in servos], correlation, slopes, moves, settings)


def speed_tracking(readings: Readings, settings: TrackingSettings) -> Tracking | None:
    """Hold the speeds of joints against the commands of drives that pull against the speed alone.

    Parameters
    ----------
    readings : Readings
        The forces of a log.
    settings : TrackingSettings
        What counts.

    Returns
    -------
    Tracking or None
        None where there is no such drive.
    """
    forces = {dof: readings.told_and_pull(dof) for dof in readings.evaluated}
    found = {dof: own for dof, own in forces.items() if own is not None}
    if not found:
        return None
    told = np.stack([own[0] for own in found.values()], axis=1)
    pull = np.stack([own[1] for own in found.values()], axis=1)
    spread = pull.std(axis=0)
    sizes = told.std(axis=0)
    correlation = _correlation([pull], [told], 0)
    slopes = np.diag(correlation) * spread / sizes
    joints = [next(one for one in readings.joints if one.qvel == dof) for dof in found]
    return Tracking(joints, correlation, slopes, np.ones(len(joints), dtype=bool), settings)


def _centred(runs: list[Array]) -> list[Array]:
    """Each run less its own mean."""
    return [rows - rows.mean(axis=0) for rows in runs]


def _correlation(positions: list[Array], commands: list[Array], lag: int) -> Array:
    """(n, n) correlation of each position with each command of so many rows before."""
    long_enough = [i for i, rows in enumerate(positions) if len(rows) > lag + 1]
    later = np.concatenate(_centred([positions[i][lag:] for i in long_enough]))
    before = np.concatenate(_centred([commands[i][: len(commands[i]) - lag] for i in long_enough]))
    size = np.outer(later.std(axis=0), before.std(axis=0)) * len(later)
    return np.asarray(later.T @ before / np.maximum(size, 1e-300))
