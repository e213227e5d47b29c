"""Signs, units and places of angles and commands that are wrong.

Where the forces of a log can be computed, readings of its columns are compared by what the drives
leave unexplained: `readings`. A reading is a fault only if it explains most of what a model with
free gains, rotors, friction and weights leaves, on data held out. Elsewhere the commands of servos
are held against their joints.
"""

from collections.abc import Iterator, Sequence
from dataclasses import KW_ONLY, dataclass, field, replace
from itertools import chain, combinations

import numpy as np
from numpy.typing import NDArray

from dropo.core.contracts.problem import Problem
from dropo.core.numerics.tails import student_tail
from dropo.core.records.trajectories import Trajectories
from dropo.core.services.errors import BadArgument, Incompatible
from dropo.core.services.validation import Array
from dropo.diagnosis.regression.equation import UniformLog
from dropo.diagnosis.regression.readings import JointFit, Reading, Readings, ReadingSettings, sides
from dropo.diagnosis.regression.result import Evidence, WiringFault
from dropo.diagnosis.search.library import robot_of
from dropo.mjmodel.dynamics.forces import position_servos
from dropo.mjmodel.joints import Joint
from dropo.mjmodel.robot_simulator import RobotSimulator

EITHER = ""
"""Of a fault of which angles and commands explain the same."""
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
class WiringSettings:
    """When angles or commands are not what the model takes them for.

    Attributes
    ----------
    follows : float
        Correlation of positions with commands from which a joint follows one.
    better : float
        By how much the correlation with another command must be larger.
    closely : float
        Correlation from which a joint that moves as far as its servo's command says is wired right.
    factor : float
        A factor above this, or below one over it, is another unit.
    moving : float
        A command that moves less than this fraction of the largest is not looked at.
    lag : float
        Longest time by which a joint follows its command [s].
    lags : int
        Number of such times that are tried.
    unexplained : float
        Root mean square of a joint's unexplained force, as a fraction of its force, from which its
        wiring is doubted.
    strange : float
        The same from which the units of its angle are doubted.
    removes : float
        Fraction of the squared unexplained force of the joints that it names that a reading removes
        at least on data held out.
    explained : float
        Root mean square of the force that it may leave at each of them.
    worse : float
        Root mean square of the force that another joint may leave in any case; it may leave more
        only if it is not more than `equal` times what it left.
    level : float
        The p-value that the gain of each fault has at most.
    each : float
        Fraction of what the joints of one fault leave without it that it removes by itself.
    step : float
        Fraction of what the joints of one more fault leave that it removes at least while others
        are looked for.
    most : int
        Faults that are looked for at most.
    equal : float
        Readings are equally good if one leaves this multiple of the other at most.
    known : float
        Relative distance from a known unit within which a factor is that unit.
    torques : float
        A servo's command that counts so many times as much as its pull back is a force, if the
        motion is explained better without any pull back.
    motors : float
        Factor of a motor's whole force beyond which, or below one over it, its command has another
        unit, and not another gain.
    checked : float
        Fraction of the data that is held out where the problem holds out none.
    readings : ReadingSettings
        How forces are compared.
    """

    follows: float = 0.6
    better: float = 0.3
    closely: float = 0.9
    factor: float = 3.0
    moving: float = 0.02
    lag: float = 0.3
    lags: int = 16
    _: KW_ONLY
    unexplained: float = 0.3
    strange: float = 0.5
    removes: float = 0.75
    explained: float = 0.45
    worse: float = 0.1
    level: float = 0.01
    each: float = 0.5
    step: float = 0.3
    most: int = 12
    equal: float = 1.5
    known: float = 0.2
    torques: float = 10.0
    motors: float = 100.0
    checked: float = 0.2
    readings: ReadingSettings = field(default_factory=ReadingSettings)


SETTINGS = WiringSettings()


@dataclass(frozen=True)
class Change:
    """One thing that is read otherwise.

    Attributes
    ----------
    kind : {"sign", "exchange", "unit_factor", "torque_command"}
        What.
    of : {"angle", "command", "both"}
        Of which columns.
    dofs : tuple of int
        The degrees of freedom of the joints.
    factor : float
        What a unit is multiplied by.
    """

    kind: str
    of: str
    dofs: tuple[int, ...]
    factor: float = 1.0

    def applied(self, reading: Reading, actuators: dict[int, tuple[int, ...]]) -> Reading:
        """Return a reading with this change.

        Parameters
        ----------
        reading : Reading
            Without it.
        actuators : dict of int to tuple of int
            Those at each degree of freedom.

        Returns
        -------
        Reading
        """
        if self.of == "both":
            of_angles = replace(self, of="angle").applied(reading, actuators)
            driven = tuple(dof for dof in self.dofs if dof in actuators)
            return replace(self, of="command", dofs=driven).applied(of_angles, actuators)
        angle = self.of == "angle"
        places = list(self.dofs)
        if not angle:
            places = [i for dof in self.dofs for i in actuators[dof]]
        if self.kind == "torque_command":
            return replace(reading, torques=reading.torques | set(places))
        sources = list(reading.angles if angle else reading.commands)
        scales = list(reading.angle_scales if angle else reading.command_scales)
        if self.kind == "exchange":
            one, other = places
            sources[one], sources[other] = sources[other], sources[one]
            scales[one], scales[other] = scales[other], scales[one]
        else:
            factor = -1.0 if self.kind == "sign" else self.factor
            for place in places:
                scales[place] *= factor
        if angle:
            return replace(reading, angles=tuple(sources), angle_scales=tuple(scales))
        return replace(reading, commands=tuple(sources), command_scales=tuple(scales))


@dataclass(frozen=True, eq=False)
class Wiring:
    """How the columns of a problem's log are to be read.

    Attributes
    ----------
    faults : tuple of WiringFault
        What is wrong; none where the columns are what the problem takes them for.
    reading : Reading or None
        How columns are to be read; None where faults come from no forces, or there are none.
    """

    faults: tuple[WiringFault, ...]
    reading: Reading | None = None


def wiring_of(problem: Problem, settings: WiringSettings = SETTINGS) -> Wiring:
    """Find out how the columns of a problem's log are to be read.

    Parameters
    ----------
    problem : Problem
        A robot, and what was measured.
    settings : WiringSettings
        What counts.

    Returns
    -------
    Wiring
        Without faults where neither forces nor commands of servos can be looked at.
    """
    try:
        readings = Readings(problem, *sides(problem, settings.checked), settings.readings)
    except (Incompatible, BadArgument):
        pass
    else:
        followers = _followers(robot_of(problem), problem.trajectories, settings)
        following = _following(followers, settings) | {
            dof for dof in readings.evaluated if readings.follows_speed(dof) > settings.closely
        }
        opposed = _opposed(followers, settings) + [
            dof for dof in readings.evaluated if readings.follows_speed(dof) < -settings.closely
        ]
        search = _WiringSearch(readings, settings, following, frozenset(opposed))
        found = search.run()
        return found if found.faults else search.of_opposed(opposed)
    try:
        return Wiring(faults_of_followers(robot_of(problem), problem.trajectories, settings))
    except (Incompatible, BadArgument):
        return Wiring(())


def wiring_faults(problem: Problem, settings: WiringSettings = SETTINGS) -> tuple[WiringFault, ...]:
    """Find signs, units and places that are wrong.

    Parameters
    ----------
    problem : Problem
        A robot, and what was measured.
    settings : WiringSettings
        What counts.

    Returns
    -------
    tuple of WiringFault
        None where columns are what the problem takes them for.
    """
    return wiring_of(problem, settings).faults


@dataclass(frozen=True, eq=False)
class _WiringSearch:
    """A search for the changes that explain the forces, one after another.

    following: the degrees of freedom of servos whose joints follow their own commands closely. Not
    one of both columns alone can be wrong there, however far off the servo's gain is. opposed:
    those of joints that move against them as closely, which a logged torque would not make them do.
    """

    readings: Readings
    settings: WiringSettings
    following: frozenset[int] = frozenset()
    opposed: frozenset[int] = frozenset()

    def run(self) -> Wiring:
        """The changes that are confirmed on data held out."""
        plain = self.readings.fits(self.readings.plain)
        changes: list[Change] = []
        left = _total(plain)
        while len(changes) < self.settings.most:
            best = self._best(changes)
            if best is None or best[0] >= left or not self._helps(changes, best[1]):
                break
            left, change = best
            changes.append(change)
        changes = self._needed(changes)
        if changes and not self._confirmed(plain, changes):
            changes = []
        further = [*self._of_motors(changes), *self._of_torques(changes)]
        reading = self._reading([*changes, *further])
        faults = [self._fault(change, changes) for change in changes]
        if not all(_certain(fault, self.settings.level) for fault in faults):
            return Wiring(())
        faults += [self._further_fault(change, reading) for change in further]
        if not faults:
            return Wiring(())
        return Wiring(tuple(faults), reading)

    def of_opposed(self, dofs: Sequence[int]) -> Wiring:
        """The signs of joints that move against their own servos' commands, whatever forces say."""
        if not dofs:
            return Wiring(())
        changes = [Change("sign", "angle", (dof,)) for dof in dofs]
        faults = tuple(self._fault(change, changes) for change in changes)
        return Wiring(faults, self._reading(changes))

    def _reading(self, changes: Sequence[Change]) -> Reading:
        """How columns are read with some changes."""
        reading = self.readings.plain
        for change in changes:
            reading = change.applied(reading, self.readings.actuators_at)
        return reading

    def _left_with(self, changes: Sequence[Change]) -> float:
        """What all joints leave with some changes."""
        return _total(self.readings.fits(self._reading(changes)))

    def _helps(self, changes: list[Change], change: Change) -> bool:
        """Whether one more change removes enough at the joints that it names."""
        now = self.readings.fits(self._reading(changes))
        after = self.readings.fits(self._reading([*changes, change]))
        own = [dof for dof in change.dofs if dof in now]
        left = sum(_left(after[dof]) for dof in own)
        return left < (1 - self.settings.step) * sum(_left(now[dof]) for dof in own)

    def _best(self, changes: list[Change]) -> tuple[float, Change] | None:
        """The change that explains most beside others, and what is left with it."""
        reading = self._reading(changes)
        now = self.readings.fits(reading)
        bad = [dof for dof, fit in now.items() if _left(fit) > self.settings.unexplained**2]
        if not bad:
            return None
        found: list[tuple[float, Change]] = []
        # Both signs of one joint turn its own forces around, as a load on its other side does.
        turned = {change.dofs for change in changes if change.kind == "sign"}
        # An exchange of angles is half explained by one of commands: the two are compared.
        wires = chain(self._of_commands(reading, bad), self._of_angles(reading, bad, list(now)))
        for stage in (wires, self._of_units(reading, bad)):
            for change in stage:
                if change.kind == "sign" and change.dofs in turned:
                    continue
                found.append((self._left_with([*changes, change]), change))
            if found and min(one[0] for one in found) < (1 - self.settings.removes) * _total(now):
                break
        return min(found, key=lambda one: one[0], default=None)

    def _of_commands(self, reading: Reading, bad: Sequence[int]) -> Iterator[Change]:
        """Changes of commands, which cost little to try."""
        actuators = self.readings.actuators_at
        bad = [dof for dof in bad if dof not in self.following]
        for dof in bad:
            yield Change("sign", "command", (dof,))
            factor = self.readings.command_factor(reading, dof)
            if factor is None or not self._is_unit(factor):
                continue
            torque = Change("torque_command", "command", (dof,))
            if not np.isfinite(factor):
                yield torque
                continue
            unit = Change("unit_factor", "command", (dof,), self._known(factor, dof))
            as_torque, as_unit = (
                _left(self.readings.fits(one.applied(reading, actuators))[dof])
                for one in (torque, unit)
            )
            yield torque if as_torque < self.settings.equal * as_unit else unit
        for pair in combinations(bad, 2):
            if all(len(actuators[dof]) == 1 for dof in pair):
                yield Change("exchange", "command", pair)

    def _of_angles(
        self, reading: Reading, bad: Sequence[int], every: Sequence[int]
    ) -> Iterator[Change]:
        """Changes of angles: of joints' signs, and exchanges.

        A joint that turns the wrong way may be explained itself, and not those that carry it, whose
        inertia it changes: the signs of all are tried.
        """
        bad = [dof for dof in bad if dof not in self.following]
        for dof in every:
            if dof not in self.following:
                yield Change("sign", "angle", (dof,))
        for pair in combinations(bad, 2):
            yield Change("exchange", "angle", pair)

    def _of_units(self, reading: Reading, bad: Sequence[int]) -> Iterator[Change]:
        """Changes of angles' units, of all that are of a kind and of single ones."""
        fits = self.readings.fits(reading)
        strange = self.settings.strange**2
        # Motion that is called tiny has no gravity that changes, and so none that is off.
        bad = [
            dof
            for dof in bad
            if _left(fits[dof]) > strange and self.readings.left_loaded(dof) > strange
        ]
        kinds = {joint.qvel: joint.kind for joint in self.readings.joints}
        for kind, units in UNITS.items():
            alike = tuple(dof for dof, own in kinds.items() if own == kind)
            if not set(alike) & set(bad):
                continue
            servos = any(self.readings.is_servo(dof) for dof in alike)
            for factor in units:
                if len(alike) > 1 and not self.following.intersection(alike):
                    yield Change("unit_factor", "angle", alike, factor)
                if servos:
                    yield Change("unit_factor", "both", alike, factor)
        for dof in bad:
            if dof in self.following:
                continue
            factors = UNITS.get(kinds[dof], {})
            if self.readings.is_servo(dof):
                factor = self.readings.follows(reading, dof)
                factors = {self._known(factor, dof): ""} if self._is_unit(factor) else {}
            for factor in factors:
                yield Change("unit_factor", "angle", (dof,), factor)

    def _is_unit(self, factor: float) -> bool:
        """Whether a factor is that of another unit."""
        return not 1 / self.settings.factor < factor < self.settings.factor

    def _known(self, factor: float, dof: int) -> float:
        """A factor, or that of the known unit that it is close to."""
        (kind,) = [joint.kind for joint in self.readings.joints if joint.qvel == dof]
        for known in UNITS.get(kind, ()):
            if abs(np.log(factor / known)) < self.settings.known:
                return known
        return factor

    def _of_motors(self, changes: Sequence[Change]) -> list[Change]:
        """The units of motors' commands: their force is off by more than a gain would be, and not
        used up by friction and a rotor that the model lacks.
        """
        reading = self._reading(changes)
        limit = self.settings.motors
        found = []
        for dof, fit in self.readings.fits(reading).items():
            known = fit.left < self.settings.explained**2 and fit.drive > 0
            if self.readings.is_servo(dof) or not known or 1 / limit < fit.drive < limit:
                continue
            if self.readings.left_as_stated(dof) <= self.settings.unexplained**2:
                continue
            if self.readings.left_with_friction(dof, limit) > self.settings.explained**2:
                found.append(Change("unit_factor", "command", (dof,), fit.drive))
        return found

    def _of_torques(self, changes: Sequence[Change]) -> list[Change]:
        """The servos whose commands are forces, but which a tiny gain explains nearly as well."""
        reading = self._reading(changes)
        settings = self.settings
        found = []
        for dof, fit in self.readings.fits(reading).items():
            factor = self.readings.command_factor(reading, dof)
            if factor is None or factor < settings.torques:
                continue
            if dof in self.following | self.opposed:
                continue
            change = Change("torque_command", "command", (dof,))
            other = change.applied(reading, self.readings.actuators_at)
            left = _left(self.readings.fits(other)[dof])
            explains = left < settings.explained**2 and left < fit.left
            if explains and self.readings.left_as_stated(dof) > settings.unexplained**2:
                found.append(change)
        return found

    def _needed(self, changes: list[Change]) -> list[Change]:
        """Those of the changes without which the joints that they name leave much more."""
        kept = list(changes)
        for change in changes:
            others = [one for one in kept if one is not change]
            now = self.readings.fits(self._reading(kept))
            without = self.readings.fits(self._reading(others))
            own = [dof for dof in change.dofs if dof in now]
            left = sum(_left(now[dof]) for dof in own)
            if left > (1 - self.settings.each) * sum(_left(without[dof]) for dof in own):
                kept = others
        return kept

    def _confirmed(self, before: dict[int, JointFit], changes: Sequence[Change]) -> bool:
        """Whether changes explain, on data held out, most of what was not."""
        settings = self.settings
        after = self.readings.fits(self._reading(changes))
        named = {dof for change in changes for dof in change.dofs} & set(before)
        if not named:
            return False
        was = sum(_left(before[dof]) for dof in named)
        now = sum(_left(after[dof]) for dof in named)
        good = all(_left(after[dof]) < settings.explained**2 for dof in named)
        # The right reading of some columns explains no other joint worse.
        for dof in set(before) - named:
            allowed = max(settings.equal * _left(before[dof]), settings.worse**2)
            good = good and _left(after[dof]) <= allowed
        return good and now < (1 - settings.removes) * was

    def _fault(self, change: Change, changes: Sequence[Change]) -> WiringFault:
        """A change in words, with its evidence."""
        others = [one for one in changes if one is not change]
        after = self.readings.fits(self._reading(changes))
        without = self.readings.fits(self._reading(others))
        own = [dof for dof in change.dofs if dof in after]
        before_left = float(np.mean([_left(without[dof]) for dof in own]))
        after_left = float(np.mean([_left(after[dof]) for dof in own]))
        gains = np.nansum([_gains(without[dof], after[dof]) for dof in own], axis=0)
        evidence = self._evidence(before_left, after_left, gains)
        of = change.of
        if change.kind != "torque_command" and change.of != "both":
            other = "command" if of == "angle" else "angle"
            inverse = 1 / change.factor
            twin = [*others, replace(change, of=other, factor=inverse)]
            now, then = self._left_with(changes), self._left_with(twin)
            of = EITHER if then < self.settings.equal * now else of
        return self._in_words(change, of, evidence)

    def _further_fault(self, change: Change, reading: Reading) -> WiringFault:
        """What is seen in the size of a gain, in words, with its evidence beside the model."""
        (dof,) = change.dofs
        after = self.readings.fits(reading)[dof]
        before = min(self.readings.left_as_stated(dof), 1.0)
        own = after.by_block[np.isfinite(after.by_block)]
        gains = 0.5 * np.log(before / np.maximum(own, 1e-12))
        return self._in_words(change, change.of, self._evidence(before, after.left, gains))

    def _evidence(self, before: float, after: float, gains: Array) -> Evidence:
        """What is gained on data held out; before, after: the squared force that is left."""
        error = float(gains.std(ddof=1) / np.sqrt(len(gains))) if len(gains) > 1 else np.inf
        z = float(gains.mean() / max(error, 1e-300))
        p_value = self.readings.tried * float(student_tail(z, max(len(gains) - 1, 1)))
        return Evidence(
            removed=1 - after / before,
            gain=float(gains.mean()),
            gain_se=error,
            before=float(np.sqrt(before)),
            after=float(np.sqrt(after)),
            p_value=max(min(1.0, p_value), float(np.finfo(float).tiny)),
        )

    def _in_words(self, change: Change, of: str, evidence: Evidence) -> WiringFault:
        """A change as a fault."""
        names = [joint.name for joint in self.readings.joints if joint.qvel in change.dofs]
        kinds = [joint.kind for joint in self.readings.joints if joint.qvel in change.dofs]
        unit = UNITS[kinds[0]].get(change.factor, "")
        text, to_change = _sentences(change, of, names, unit)
        factor = change.factor if change.kind == "unit_factor" else None
        target = ", ".join(names)
        return WiringFault(change.kind, target, text, of, factor, to_change, evidence)


def _certain(fault: WiringFault, level: float) -> bool:
    """Whether a fault's gain on data held out is no chance."""
    return fault.evidence is not None and fault.evidence.p_value < level


def _left(fit: JointFit) -> float:
    """What a joint leaves, all of it at most."""
    return min(fit.left, 1.0)


def _total(fits: dict[int, JointFit]) -> float:
    """What all joints leave."""
    return sum(map(_left, fits.values()))


def _gains(before: JointFit, after: JointFit) -> Array:
    """(B,) what each block gains [nats a row]."""
    one = np.minimum(before.by_block, 1.0)
    return np.asarray(0.5 * np.log(np.maximum(one, 1e-12) / np.maximum(after.by_block, 1e-12)))


def _sentences(change: Change, of: str, names: Sequence[str], unit: str) -> tuple[str, str]:
    """What is wrong, and what to change in the mapping or the problem file."""
    joint = f"joint {names[0]!r}"
    if len(names) > 1:
        joint = f"joints {', '.join(map(repr, names))}"
    what = {"angle": "angle", "command": "command", EITHER: "angle, or its command,"}.get(of, "")
    keys = {
        "angle": "`qpos` (and `qvel`)",
        "command": "`ctrl`",
        "both": "`qpos` (and `qvel`), and of their actuators under `ctrl`",
        EITHER: "`qpos` (and `qvel`), or of its actuator under `ctrl`",
    }[of]
    entry = f"the entry of {names[0]!r} under {keys} in the mapping of the log"
    if change.kind == "sign":
        return (
            f"The {joint} has the wrong sign: its {what} has the opposite sign of the model's.",
            f"give {entry} `sign: -1`, or turn the column's sign in the data.",
        )
    if change.kind == "exchange":
        one, other = names
        moved = "command" if of == "command" else "angle"
        return (
            f"The joints {one!r} and {other!r} are exchanged: each has the other's {moved}.",
            f"exchange the columns of {one!r} and {other!r} under {keys} in the mapping of the "
            "log, or in the data.",
        )
    if change.kind == "torque_command":
        return (
            f"The command of the {joint} is a force, not a position: the model's servo takes "
            "torques for angles to follow.",
            f"log the servo's setpoint of {names[0]!r} under `ctrl`, or give the model a motor in "
            "the place of its position servo.",
        )
    is_unit = f" ({unit})" if unit else ""
    whose = {
        "angle": "angle",
        "command": "command",
        "both": "angle and command",
        EITHER: "angle or command",
    }[of]
    factor = f"{change.factor:.3g}"
    entries = entry if len(names) == 1 else f"the entries of the {joint} under {keys}"
    multiplied = f"multiply the column by {factor}"
    if of == EITHER:
        multiplied = f"multiply the {change.of}'s column by {factor}"
    if of == "both":
        multiplied = f"multiply the columns by {factor}"
    column = "both are" if of == "both" else f"the {change.of} is"
    return (
        f"The {whose} of the {joint} has another unit than the model's: {column} to be "
        f"multiplied by {factor}{is_unit}.",
        f"state the `unit` of {entries}, or {multiplied}.",
    )


def faults_of_followers(
    simulator: RobotSimulator, trajectories: Trajectories, settings: WiringSettings = SETTINGS
) -> tuple[WiringFault, ...]:
    """Compare the joints of position servos with their commands.

    Parameters
    ----------
    simulator : RobotSimulator
        The robot.
    trajectories : Trajectories
        What was measured.
    settings : WiringSettings
        What counts.

    Returns
    -------
    tuple of WiringFault
        None where each joint follows its own command.
    """
    followers = _followers(simulator, trajectories, settings)
    if followers is None:
        return ()
    names = [joint.name for joint in followers.joints]
    correlation = followers.correlation
    moves = followers.moves
    slopes = followers.slopes
    found: list[WiringFault] = []
    exchanged: set[int] = set()
    for j in np.flatnonzero(moves).tolist():
        other = int(np.argmax(np.where(moves, np.abs(correlation[j]), 0.0)))
        beyond = abs(correlation[j, other]) - abs(correlation[j, j])
        back = int(np.argmax(np.where(moves, np.abs(correlation[other]), 0.0)))
        strong = abs(correlation[j, other]) > settings.follows
        if other > j and back == j and strong and beyond > settings.better:
            exchanged |= {j, other}
            text = (
                f"The joints {names[j]!r} and {names[other]!r} are exchanged: each follows the "
                "other's command."
            )
            found.append(WiringFault("exchange", f"{names[j]}, {names[other]}", text))
    for j in np.flatnonzero(moves).tolist():
        if j in exchanged or abs(correlation[j, j]) < settings.follows:
            continue
        slope = float(slopes[j])
        if slope < 0:
            text = f"The joint {names[j]!r} has the wrong sign: it moves against its command."
            found.append(WiringFault("sign", names[j], text))
        elif not 1 / settings.factor < slope < settings.factor:
            text = (
                f"The joint {names[j]!r} moves {slope:.3g} times as far as its command says: units "
                "differ by that factor, or the command is no position."
            )
            found.append(WiringFault("unit_factor", names[j], text))
    return tuple(found)


@dataclass(frozen=True, eq=False)
class _Followers:
    """The n joints of servos beside all their commands.

    correlation: (n, n) of each joint with each command, at the lag at which it is largest; slopes:
    (n,) how far each moves for its own command; moves: (n,) which move at all.
    """

    joints: list[Joint]
    correlation: Array
    slopes: Array
    moves: NDArray[np.bool_]


def _followers(
    simulator: RobotSimulator, trajectories: Trajectories, settings: WiringSettings
) -> _Followers | None:
    """How the joints of servos move with commands; None where there is no servo."""
    servos = position_servos(simulator.model)
    if not servos:
        return None
    log = UniformLog(simulator, trajectories)
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
    return _Followers([joint for joint, _ in servos], correlation, slopes, moves)


def _following(followers: _Followers | None, settings: WiringSettings) -> frozenset[int]:
    """The degrees of freedom that follow their own servo's command closely."""
    if followers is None:
        return frozenset()
    found = set()
    for j in np.flatnonzero(followers.moves).tolist():
        is_alike = 1 / settings.factor < followers.slopes[j] < settings.factor
        if followers.correlation[j, j] > settings.closely and is_alike:
            found.add(followers.joints[j].qvel)
    return frozenset(found)


def _opposed(followers: _Followers | None, settings: WiringSettings) -> list[int]:
    """The degrees of freedom that move against their own servo's command as closely."""
    if followers is None:
        return []
    own = np.diag(followers.correlation)
    opposed = np.flatnonzero(followers.moves & (own < -settings.closely)).tolist()
    return [followers.joints[j].qvel for j in opposed]


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
