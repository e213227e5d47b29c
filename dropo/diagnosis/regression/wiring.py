"""Signs, units and places of angles and commands that are wrong.

Where the forces of a log can be computed, readings of its columns are compared by what the drives
leave unexplained: `readings`. A reading is a fault only if it explains most of what a model with
free gains, rotors, friction and weights leaves, on data held out. What joints of servos follow,
their own commands or others' (`tracking`), comes first; without forces it is all there is.
"""

from collections.abc import Iterator, Sequence
from dataclasses import KW_ONLY, dataclass, field, replace
from itertools import chain, combinations

import numpy as np

from dropo.core.contracts.problem import Problem
from dropo.core.numerics.tails import student_tail
from dropo.core.services.errors import BadArgument, Incompatible
from dropo.core.services.validation import Array
from dropo.diagnosis.regression.readings import JointFit, Reading, Readings, ReadingSettings, sides
from dropo.diagnosis.regression.result import Evidence, WiringFault
from dropo.diagnosis.regression.tracking import (
    UNITS,
    Misread,
    Tracking,
    TrackingSettings,
    position_tracking,
    speed_tracking,
)

EITHER = ""
"""Of a fault of which angles and commands explain the same."""


@dataclass(frozen=True)
class WiringSettings(TrackingSettings):
    """When angles or commands are not what the model takes them for.

    Attributes
    ----------
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
    least_angle, least_travel : float
        How far a hinge [rad] and a slide [m] move from end to end in any log: units in which they
        would move less are none.
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
    least_angle: float = 0.05
    least_travel: float = 0.005
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
        try:
            return Wiring(_faults_of(position_tracking(problem, settings)))
        except (Incompatible, BadArgument):
            return Wiring(())
    tracked = [position_tracking(problem, settings), speed_tracking(readings, settings)]
    servos = [one for one in tracked if one is not None]
    following = frozenset[int]().union(*(one.following for one in servos))
    search = _WiringSearch(readings, settings, following)
    misread = [each for one in servos for each in one.misread_closely]
    found = search.of_tracking(misread, explained=True)
    if not found.faults:
        found = search.run()
    if not found.faults:
        found = search.of_tracking([one for one in misread if one.kind == "sign"])
    return found


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

    Attributes
    ----------
    readings : Readings
        What forces are left by how the columns are read.
    settings : WiringSettings
        What counts.
    following : frozenset of int
        The degrees of freedom of servos whose joints follow their own commands closely. Not one of
        both columns alone can be wrong there, however far off the servo's gain is.
    """

    readings: Readings
    settings: WiringSettings
    following: frozenset[int] = frozenset()

    def run(self) -> Wiring:
        """Find the changes that are confirmed on data held out.

        Returns
        -------
        Wiring
        """
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
        faults = self._confirmed_faults(plain, changes)
        changes = [change for change, _ in faults]
        further = [*self._of_motors(changes), *self._of_torques(changes)]
        reading = self._reading([*changes, *further])
        every = [fault for _, fault in faults]
        every += [self._further_fault(change, reading) for change in further]
        return Wiring(tuple(every), reading) if every else Wiring(())

    def _confirmed_faults(
        self, plain: dict[int, JointFit], changes: list[Change]
    ) -> list[tuple[Change, WiringFault]]:
        """The changes that are confirmed together, each of which is certain."""
        while changes and self._confirmed(plain, changes):
            faults = [(change, self._fault(change, changes)) for change in changes]
            certain = [one for one in faults if _certain(one[1], self.settings.level)]
            if len(certain) == len(faults):
                return faults
            changes = [change for change, _ in certain]
        return []

    def of_tracking(self, misread: Sequence[Misread], *, explained: bool = False) -> Wiring:
        """Find the changes that commands tell which joints follow.

        Forces tell whether the angle is wrong or its command, if anything does.

        Parameters
        ----------
        misread : sequence of Misread
            What commands tell.
        explained : bool
            Whether forces must be explained then; else it counts whatever they say.

        Returns
        -------
        Wiring
        """
        changes: list[Change] = []
        for kind, alike in _alike(misread):
            dofs = tuple(joint.qvel for one in alike for joint in one.joints)
            slope = self._slope(kind, alike[0])
            by_angle = Change(kind, "angle", dofs, 1 / slope)
            by_command = Change(kind, "command", dofs, slope)
            left = self._left_with([*changes, by_command])
            better = self.settings.equal * self._left_with([*changes, by_angle]) < left
            change = by_angle if better else by_command
            if not explained or self._explains([*changes, change], dofs):
                changes.append(change)
        if not changes:
            return Wiring(())
        return Wiring(tuple(self._tracked(one, changes) for one in changes), self._reading(changes))

    def _slope(self, kind: str, misread: Misread) -> float:
        """How far a joint moves for its command: 1, or a known unit where that is wrong."""
        if kind != "unit_factor":
            return 1.0
        (joint,) = misread.joints
        # Forces tell it exactly, which come of how far a servo is behind.
        exact = self.readings.command_factor(self.readings.plain, joint.qvel)
        known = exact is not None and np.isfinite(exact)
        return self._known(exact if exact is not None and known else misread.slope, joint.qvel)

    def _explains(self, changes: Sequence[Change], dofs: Sequence[int]) -> bool:
        """Whether changes leave little at some joints."""
        after = self.readings.fits(self._reading(changes))
        return all(_left(after[dof]) < self.settings.explained**2 for dof in dofs if dof in after)

    def _tracked(self, change: Change, changes: Sequence[Change]) -> WiringFault:
        """What commands tell, with the evidence of forces where these speak for it, too."""
        fault = self._fault(change, changes)
        speaks = fault.evidence is not None and fault.evidence.gain > 0 < fault.evidence.removed
        if change.kind == "unit_factor":
            slope = change.factor if change.of == "command" else 1 / change.factor
            why = f"It moves {slope:.3g} times as far as its command says."
        elif change.kind == "sign":
            why = "It moves against its command."
        else:
            why = "Each follows the other's command."
        return replace(
            fault, text=f"{fault.text} {why}", evidence=fault.evidence if speaks else None
        )

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
        """Whether one more change removes enough at the joints that it names.

        Both signs of one joint turn its own forces around, as a load on its other side does: what
        they remove at the other joints counts.
        """
        now = self.readings.fits(self._reading(changes))
        after = self.readings.fits(self._reading([*changes, change]))
        if change.kind == "sign" and change.of == "both":
            others = [dof for dof in now if dof not in change.dofs]
            shares = [_left(after[dof]) / max(_left(now[dof]), 1e-12) for dof in others]
            return bool(shares) and float(np.median(shares)) < 1 - self.settings.each
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
            if factor is None or not self.settings.is_unit(factor):
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
        for dof in every:
            of = "both" if dof in self.following else "angle"
            yield Change("sign", of, (dof,))
        for pair in combinations(bad, 2):
            follow = self.following.intersection(pair)
            if len(follow) != 1:
                yield Change("exchange", "both" if follow else "angle", pair)

    def _of_units(self, reading: Reading, bad: Sequence[int]) -> Iterator[Change]:
        """Changes of angles' units, of all that are of a kind and of single ones.

        None that leaves a joint hardly any motion, as whatever is read so is explained by little.
        """
        actuators = self.readings.actuators_at
        for change in self._of_any_units(reading, bad):
            after = change.applied(reading, actuators)
            moved = set(change.dofs).intersection(self.readings.evaluated)
            if all(self.readings.extent(after, dof) > self._least(dof) for dof in moved):
                yield change

    def _of_any_units(self, reading: Reading, bad: Sequence[int]) -> Iterator[Change]:
        """The same, however small the motion is then."""
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
                    if len(alike) > 1:
                        of_one = (dof for dof in alike if dof in self.following.intersection(bad))
                        yield from (Change("unit_factor", "both", (dof,), factor) for dof in of_one)
        for dof in bad:
            if dof in self.following:
                continue
            factors = UNITS.get(kinds[dof], {})
            if self.readings.is_servo(dof):
                factor = self.readings.follows(reading, dof)
                factors = {self._known(factor, dof): ""} if self.settings.is_unit(factor) else {}
            for factor in factors:
                yield Change("unit_factor", "angle", (dof,), factor)

    def _kind(self, dof: int) -> str:
        """Of the joint of a degree of freedom: "hinge" or "slide"."""
        return next(joint.kind for joint in self.readings.joints if joint.qvel == dof)

    def _least(self, dof: int) -> float:
        """How far that joint moves at least in any log."""
        hinge = self._kind(dof) == "hinge"
        return self.settings.least_angle if hinge else self.settings.least_travel

    def _known(self, factor: float, dof: int) -> float:
        """A factor, or that of the known unit that it is close to."""
        for known in UNITS.get(self._kind(dof), ()):
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
            if dof in self.following:
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
        driven = all(dof in self.readings.actuators_at for dof in change.dofs)
        if driven and change.kind != "torque_command" and change.of != "both":
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
    what = {
        "angle": "angle has",
        "command": "command has",
        "both": "angle and its command have",
        EITHER: "angle, or its command, has",
    }[of]
    keys = {
        "angle": "`qpos` (and `qvel`)",
        "command": "`ctrl`",
        "both": "`qpos` (and `qvel`), and of their actuators under `ctrl`",
        EITHER: "`qpos` (and `qvel`), or of its actuator under `ctrl`",
    }[of]
    entry = f"the entry of {names[0]!r} under {keys} in the mapping of the log"
    if change.kind == "sign":
        return (
            f"The {joint} has the wrong sign: its {what} the opposite sign of the model's.",
            f"give {entry} `sign: -1`, or turn the column's sign in the data.",
        )
    if change.kind == "exchange":
        one, other = names
        moved = {"command": "command", "both": "angle and command"}.get(of, "angle")
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
    has = "have" if of == "both" else "has"
    column = "both are" if of == "both" else f"the {change.of} is"
    return (
        f"The {whose} of the {joint} {has} another unit than the model's: {column} to be "
        f"multiplied by {factor}{is_unit}.",
        f"state the `unit` of {entries}, or {multiplied}.",
    )


def _alike(misread: Sequence[Misread]) -> list[tuple[str, list[Misread]]]:
    """What is wrong by kind, joints of one kind together where they have the same unit."""
    units: dict[tuple[str, int], list[Misread]] = {}
    found: list[tuple[str, list[Misread]]] = []
    for one in misread:
        if one.kind != "unit_factor":
            found.append((one.kind, [one]))
            continue
        key = (one.joints[0].kind, round(np.log(one.slope)))
        if key not in units:
            units[key] = []
            found.append((one.kind, units[key]))
        units[key].append(one)
    return found


def _faults_of(tracking: Tracking | None) -> tuple[WiringFault, ...]:
    """What commands of position servos tell where forces are not known."""
    found = []
    for one in () if tracking is None else tracking.misread:
        names = [joint.name for joint in one.joints]
        text = {
            "exchange": f"The joints {' and '.join(map(repr, names))} are exchanged: each follows "
            "the other's command.",
            "sign": f"The joint {names[0]!r} has the wrong sign: it moves against its command.",
            "unit_factor": f"The joint {names[0]!r} moves {one.slope:.3g} times as far as its "
            "command says: units differ by that factor, or the command is no position.",
        }[one.kind]
        found.append(WiringFault(one.kind, ", ".join(names), text))
    return tuple(found)
