"""Units that the numbers of a log tell: of angles, velocities, commands and time stamps."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dropo.core.numerics.lattice import lattice_step
from dropo.core.services.validation import Array
from dropo.data.checks.columns import unwrap
from dropo.logs.units import SECONDS, UNITS, known_unit, unit_named
from dropo.mjmodel.joints import Joint
from dropo.mjmodel.sensors import G


@dataclass(frozen=True)
class ScaleSettings:
    """What the size of numbers says of their unit.

    Attributes
    ----------
    margin : float
        How far outside a joint's range its angle may be, as a fraction of the range.
    largest_turn : float
        An angle of more than so many rad is in degrees, where the joint has limits of less.
    smallest_degrees : float
        Largest absolute number from which on joints without limits are in degrees.
    fits : float
        A logged velocity fits the slope of the position within this factor.
    tick_bits : tuple of int
        Bits of encoders whose ticks are tried.
    turns : tuple of int
        Counts of a turn that are tried for whole numbers.
    others : tuple of float
        Counts of a turn that an encoder may have as well; 1228.8 are 1024 in 300 degrees.
    servo : int
        Counts of a turn that most servos have.
    follows : float
        Correlation from which a joint follows its commands.
    octave : float
        How near commands must put the counts of a turn to one of `turns`, in powers of two.
    near : float
        How near to one of `others`, where none of `turns` is.
    offered : int
        Counts of a turn that a question offers.
    lattice : float
        How near the step of the numbers must be to that of an encoder, as a fraction.
    spacing : tuple of float
        Steps of a log are between these [s].
    """

    margin: float = 0.25
    largest_turn: float = 3 * math.pi
    smallest_degrees: float = 60.0
    fits: float = 1.4
    tick_bits: tuple[int, ...] = (10, 12, 14, 15, 16, 17, 18, 19, 20)
    turns: tuple[int, ...] = tuple(2**bits for bits in (10, 11, 12, 13, 14, 15, 16, 17, 18, 20))
    others: tuple[float, ...] = (
        *(1000.0, 1228.8, 2000.0, 2400.0, 3600.0, 4000.0, 5000.0, 8000.0, 10000.0, 20000.0),
        *(36000.0, 40000.0),
    )
    servo: int = 4096
    follows: float = 0.8
    octave: float = 0.15
    near: float = 0.05
    offered: int = 4
    lattice: float = 0.01
    spacing: tuple[float, float] = (2.5e-4, 0.25)


DEFAULTS = ScaleSettings()
BEGINS = 1e-3
"""The part of a turn within which a first count is 0."""
_ANGLES = ("rad", "deg", "rev", "tick")
"""Units of angles, and the first word of an encoder's."""


@dataclass(frozen=True)
class Scale:
    """A unit, and why.

    Attributes
    ----------
    unit : str
        One of units.UNITS or units.SECONDS.
    why : str
        The reason, the end of "unit, since ...".
    offset : float
        What is added to the numbers, in their own unit.
    sign : int
        -1 where they count the other way round.
    """

    unit: str
    why: str
    offset: float = 0.0
    sign: int = 1


@dataclass(frozen=True)
class Choice:
    """Units of which the numbers do not tell one, and what they show.

    Attributes
    ----------
    units : tuple of str
        The likeliest first.
    what : str
        What is open, the beginning of a question.
    """

    units: tuple[str, ...]
    what: str


def time_unit(stamps: Array, hint: str | None, settings: ScaleSettings = DEFAULTS) -> Scale:
    """Find the unit of time stamps.

    Parameters
    ----------
    stamps : (n,) array
        Numbers.
    hint : str or None
        The unit that the column's name says.
    settings : ScaleSettings, optional
        What counts.

    Returns
    -------
    Scale
    """
    if hint in SECONDS:
        return Scale(hint, "its name says so")
    step = float(np.median(np.diff(stamps)))
    for unit, factor in SECONDS.items():
        if settings.spacing[0] <= step * factor <= settings.spacing[1]:
            return Scale(unit, f"its rows are {step:.4g} apart, which is {step * factor:.4g} s")
    return Scale("s", f"its rows are {step:.4g} apart")


def angle_unit(
    values: Sequence[Array],
    joints: Sequence[Joint],
    hints: Sequence[str | None],
    followed: Sequence[tuple[Array, Array]] = (),
    settings: ScaleSettings = DEFAULTS,
) -> Scale | Choice:
    """Find the unit that all angles of a log share.

    Parameters
    ----------
    values : sequence of (n,) arrays
        The numbers of each joint.
    joints : sequence of Joint
        Hinges.
    hints : sequence of str or None
        The units that the columns' names say.
    followed : sequence of pairs of (n,) arrays
        Columns that may be commands of these joints, and the numbers of the joints beside them.
    settings : ScaleSettings, optional
        What counts.

    Returns
    -------
    Scale or Choice
        A choice where numbers may as well be rad as degrees, or of encoders of several sizes.
    """
    hint = next((one for one in hints if (one or "").partition("/")[0] in _ANGLES), None)
    if hint is not None and hint.startswith("tick/"):
        return _counts(values, float(hint.removeprefix("tick/")), "it was given")
    if hint == "tick" and not _are_whole(values):
        hint = None
    if hint == "tick" or (hint is None and _are_ticks(values, joints, settings)):
        return _ticks(values, joints, hint, followed, settings)
    if hint is not None:
        return Scale(hint, "their names say so")
    largest = max(float(np.abs(one).max()) for one in values)
    outside = [
        (float(np.abs(one).max()), joint)
        for one, joint in zip(values, joints, strict=True)
        if not _fits(one, joint, 1.0, settings)
    ]
    if outside and all(
        _fits(one, joint, math.pi / 180, settings)
        for one, joint in zip(values, joints, strict=True)
    ):
        size, joint = max(outside, key=lambda pair: pair[0])
        low, high = joint.range or (0.0, 0.0)
        return Scale(
            "deg",
            f"{joint.name} reaches {size:.4g}, and its range is [{low:.4g}, {high:.4g}] rad",
        )
    step = _common_step(values)
    if step is not None and _is_part_of(step, 360.0, settings):
        return Scale("deg", f"they move in steps of 360/{round(360 / step)}")
    if largest <= settings.largest_turn:
        return Scale("rad", f"the largest is {largest:.4g}")
    if largest >= settings.smallest_degrees and any(joint.range is None for joint in joints):
        return Scale("deg", f"the largest is {largest:.4g}")
    if all(joint.range is not None for joint in joints) and not outside:
        return Scale("rad", "they are within the joints' ranges")
    return Choice(("rad", "deg"), f"Angles reach {largest:.4g}")


def answered_unit(values: Sequence[Array], unit: str) -> Scale:
    """Take the unit of angles that was the answer to a question.

    Parameters
    ----------
    values : sequence of (n,) arrays
        The numbers of each joint.
    unit : str
        One of the choice's.

    Returns
    -------
    Scale
    """
    why = "that was the answer"
    if unit.startswith("tick/"):
        return _counts(values, float(unit.removeprefix("tick/")), why)
    return Scale(unit, why)


def _fits(values: Array, joint: Joint, factor: float, settings: ScaleSettings) -> bool:
    """Whether numbers times a factor are within a joint's range, or nearly."""
    if joint.range is None:
        return True
    low, high = joint.range
    slack = settings.margin * (high - low)
    return bool(factor * values.min() >= low - slack and factor * values.max() <= high + slack)


def _common_step(values: Sequence[Array]) -> float | None:
    """The median step of the lattices on which numbers lie."""
    steps = [step for one in values if (step := lattice_step(one)) is not None]
    return float(np.median(steps)) if steps else None


def _is_part_of(step: float, whole: float, settings: ScaleSettings) -> bool:
    """Whether a step is that of an encoder whose whole turn is so much."""
    parts = whole / step
    return any(abs(parts / 2**bits - 1) < settings.lattice for bits in settings.tick_bits)


def _are_whole(values: Sequence[Array]) -> bool:
    """Whether all numbers are whole."""
    return all(bool((one == np.rint(one)).all()) for one in values)


def _are_ticks(values: Sequence[Array], joints: Sequence[Joint], settings: ScaleSettings) -> bool:
    """Whether numbers are whole and beyond two turns of degrees, or the joints' ranges of them."""
    if not _are_whole(values):
        return False
    pairs = list(zip(values, joints, strict=True))
    outside = all(
        joint.range is not None and not _fits(one, joint, math.pi / 180, settings)
        for one, joint in pairs
    )
    return outside or max(float(np.abs(one).max()) for one in values) > 720


def _ticks(
    values: Sequence[Array],
    joints: Sequence[Joint],
    hint: str | None,
    followed: Sequence[tuple[Array, Array]],
    settings: ScaleSettings,
) -> Scale | Choice:
    """Counts of an encoder, whose size the commands tell, or which a servo's holds.

    Where neither is so, counts of 8192 and of 10000 a turn look alike: a choice.
    """
    high = max(float(np.abs(one).max()) for one in values)
    why = "their names say ticks" if hint else "all are whole numbers"
    about = _turn_by_commands(followed, settings)
    if about is not None:
        turn = _usual_turn(about, settings)
        if turn is not None:
            return _counts(
                values, turn, f"{why}, and joints follow their commands by {turn:g} a turn"
            )
        nearest = sorted((*settings.turns, *settings.others), key=lambda one: abs(one - about))
        units = tuple(f"tick/{one:.10g}" for one in nearest[: settings.offered])
        return Choice(units, f"An encoder counts about {about:.4g} a turn, by the joints' commands")
    servo = settings.servo
    above = min(float(one.min()) for one in values) >= 0
    if above and servo / 4 <= high < servo and _fit_in_turn(values, joints, servo, settings):
        return _counts(values, servo, f"{why} below {servo}, a servo's turn")
    holding = sorted(one for one in (*settings.turns, *settings.others) if one > high)
    fitting = [one for one in holding if _fit_in_turn(values, joints, one, settings)]
    units = tuple(f"tick/{one:.10g}" for one in (fitting or holding)[: settings.offered])
    what = (
        f"An encoder's counts reach {high:.0f}, and nothing tells how many a turn has (`tick/N` "
        "with any N)"
    )
    return Choice(units or (f"tick/{2**20}",), what)


def _counts(values: Sequence[Array], turn: float, why: str) -> Scale:
    """Counts of an encoder, from its middle where all are above 0.

    One that counts from where it is switched on begins at 0.
    """
    above = min(float(one.min()) for one in values) >= 0
    from_start = all(abs(float(one[0])) <= BEGINS * turn for one in values)
    offset = -turn / 2 if above and not from_start else 0.0
    middle = f", 0 at its middle, {turn / 2:g}" if offset else ""
    return Scale(f"tick/{turn:.10g}", why + middle, offset)


def _fit_in_turn(
    values: Sequence[Array], joints: Sequence[Joint], turn: float, settings: ScaleSettings
) -> bool:
    """Whether all joints stay in their ranges where a turn has so many counts."""
    middle = turn / 2 if min(float(one.min()) for one in values) >= 0 else 0.0
    pairs = zip(values, joints, strict=True)
    return all(_fits(v - middle, j, 2 * math.pi / turn, settings) for v, j in pairs)


def _usual_turn(about: float, settings: ScaleSettings) -> float | None:
    """The usual counts of a turn that are near a number; None where none are."""
    nearest = min(settings.turns, key=lambda one: abs(math.log2(about / one)))
    if abs(math.log2(about / nearest)) < settings.octave:
        return nearest
    other = min(settings.others, key=lambda one: abs(math.log2(about / one)))
    return other if abs(about / other - 1) < settings.near else None


def _turn_by_commands(
    followed: Sequence[tuple[Array, Array]], settings: ScaleSettings
) -> float | None:
    """Counts of a turn by which joints follow commands in rad or degrees; None if none tells."""
    found = []
    for commands, counts in followed:
        if _are_whole([commands]) or not np.ptp(commands) > 0 or not np.ptp(counts) > 0:
            continue
        if abs(float(np.corrcoef(commands, counts)[0, 1])) < settings.follows:
            continue
        full = 2 * math.pi if np.abs(commands).max() <= settings.largest_turn else 360.0
        found.append(full * float(counts.std() / commands.std()))
    return float(np.median(found)) if found else None


def velocity_unit(
    time: Array,
    positions: Array,
    velocities: Array,
    hint: str | None,
    joint: Joint,
    settings: ScaleSettings = DEFAULTS,
) -> Scale | None:
    """Find the unit of a velocity from the slope of its position.

    Parameters
    ----------
    time : (n,) array
        Stamps [s].
    positions : (n,) array
        In SI units.
    velocities : (n,) array
        As they were logged.
    hint : str or None
        The unit that the column's name says.
    joint : Joint
        A slide or hinge.
    settings : ScaleSettings, optional
        What the size of numbers says of their unit.

    Returns
    -------
    Scale or None
        None where it fits no unit.
    """
    base = joint.units("qvel")[0]
    options = {unit: factor for unit, (si, factor) in UNITS.items() if si == base}
    if joint.kind == "hinge":
        positions = unwrap(positions)
    width = max(3, len(time) // 2000)
    slope = (positions[2 * width :] - positions[: -2 * width]) / (
        time[2 * width :] - time[: -2 * width]
    )
    sums = np.cumsum(np.concatenate([[0.0], velocities]))
    mean = (sums[2 * width + 1 :] - sums[: -2 * width - 1])[: len(slope)] / (2 * width + 1)
    moving = np.abs(slope) > 0.2 * np.sqrt(np.mean(slope**2) + 1e-300)
    if moving.sum() < 10 or not np.any(mean[moving]):
        unit = hint if hint in options else base
        return Scale(unit, "it hardly moves")
    power = float(np.sum(mean[moving] ** 2))
    factor = float(np.sum(slope[moving] * mean[moving])) / power
    likeness = factor * math.sqrt(power / float(np.sum(slope[moving] ** 2)))
    if abs(likeness) < 0.5:
        return None
    unit, known = min(options.items(), key=lambda pair: abs(math.log(abs(factor) / pair[1])))
    if abs(math.log(abs(factor) / known)) > math.log(settings.fits):
        return None
    why = f"the positions' slope is {factor:.3g} times its numbers"
    return Scale(unit, why, sign=-1 if factor < 0 else 1)


def command_unit(commands: Array, logged: Array, hint: str | None, position: Scale) -> Scale:
    """Find the unit of commanded positions from the measured ones.

    Parameters
    ----------
    commands, logged : (n,) arrays
        Commands, and measured positions as they were logged; none where no row has both.
    hint : str or None
        The unit that the column's name says.
    position : Scale
        Of the measured positions.

    Returns
    -------
    Scale
        That in which commands move as far as positions; another than the positions' only where
        theirs is off by far more. A joint that follows late is far from its command at each time.
    """
    si, factor = known_unit(position.unit)
    named = unit_named(hint or "")
    if hint is not None and named is not None and named[0] == si:
        return Scale(hint, "its name says so")
    if not len(commands):
        return Scale(position.unit, "no row has both", position.offset)
    best = Scale(position.unit, "the joint follows them", position.offset)
    told, moved = float(commands.std()), float(factor * logged.std())
    if not (told > 0 and moved > 0):
        return best

    def beside(unit: str) -> float:
        return abs(math.log(known_unit(unit)[1] * told / moved))

    nearest = beside(best.unit)
    for unit in {"rad": ("rad", "deg"), "m": ("m", "cm", "mm")}[si]:
        if beside(unit) < 0.5 * nearest:
            best = Scale(unit, "the joint follows them")
            nearest = beside(unit)
    return best


def accelerometer_unit(lengths: Array) -> tuple[str, str]:
    """Guess the unit of an accelerometer, which shows gravity most of the time.

    Parameters
    ----------
    lengths : (n,) array
        Of what it shows.

    Returns
    -------
    unit : str
        "m/s^2", "g" or "mg", by the nearest of their sizes.
    why : str
        The reason.
    """
    typical = float(np.nanmedian(lengths))
    units = {"m/s^2": G, "g": 1.0, "mg": 1e3}
    unit = min(units, key=lambda one: abs(np.log(max(typical, 1e-9) / units[one])))
    return unit, f"it shows {typical:.4g} most of the time, which is gravity"
