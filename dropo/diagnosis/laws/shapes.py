"""The shapes of which laws are made: terms of a formula, each times a constant."""

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dropo.core.services.validation import Array
from dropo.effects.joints.joint_cogging import COGS


@dataclass(frozen=True)
class LawTerm:
    """A term of a law, without its constant.

    Attributes
    ----------
    text : str
        The formula, with {0}, {1} in the place of its own constants.
    law : str
        What a law of this term is called, such as "quadratic drag".
    own : tuple of (str, float)
        Its own constants: what they are called, and a first size.
    effects : tuple of str
        The effects of the registry that stand for it.
    known : bool
        Whether one of these is looked for too, so that it is no law by itself.
    """

    text: str
    law: str
    own: tuple[tuple[str, float], ...] = ()
    effects: tuple[str, ...] = ()
    known: bool = False

    def written(self, names: Sequence[str]) -> str:
        """Write the term with names of its own constants.

        Parameters
        ----------
        names : sequence of str
            A name for each own constant.

        Returns
        -------
        str
            The formula.
        """
        return self.text.format(*names)

    @property
    def numbers(self) -> str:
        """The term with its own constants' first sizes."""
        return self.text.format(*(repr(size) for _, size in self.own))


@dataclass(frozen=True)
class Ranges:
    """How a joint moves in the data, from which first sizes of constants are taken.

    Attributes
    ----------
    q, v : (k,) arrays
        Quantiles of the position and of the speed.
    motor : bool
        Whether a motor drives it.
    others : tuple of str
        The other slides and hinges whose states are measured.
    seconds : float
        The longest trajectory [s].
    hinge : bool
        Whether it turns.
    effects : collection of str
        The effects that are looked for too.
    """

    q: Array
    v: Array
    motor: bool
    others: tuple[str, ...]
    seconds: float
    hinge: bool
    effects: Collection[str] = ()


@dataclass(frozen=True)
class ShapeSettings:
    """Which shapes are tried.

    Attributes
    ----------
    places : tuple of float
        Quantiles of the position at which stops, slack and detents are tried.
    widths : tuple of float
        Widths of detents, as fractions of the position's range.
    speeds : tuple of float
        Quantiles of the speed that are tried as scales.
    orders : int
        Highest order of the ripples that are tried.
    distances : tuple of float
        Presliding distances, as fractions of the position's range.
    times : tuple of float
        Time constants, as fractions of the longest trajectory.
    """

    places: tuple[float, ...] = (0.1, 0.25, 0.4, 0.5, 0.6, 0.75, 0.9)
    widths: tuple[float, ...] = (0.03, 0.08, 0.2)
    speeds: tuple[float, ...] = (0.15, 0.4, 0.7, 0.9)
    orders: int = 40
    distances: tuple[float, ...] = (0.003, 0.01, 0.03, 0.1)
    times: tuple[float, ...] = (0.05, 0.2, 0.6)


SETTINGS = ShapeSettings()
CONSTANT = ("actuator_bias", "external_force", "gravity_tilt")
"""The effects that a constant force at a joint may be."""


def shapes_at(ranges: Ranges, settings: ShapeSettings = SETTINGS) -> list[LawTerm]:
    """List the shapes for a joint.

    Parameters
    ----------
    ranges : Ranges
        How it moves.
    settings : ShapeSettings
        Which shapes.

    Returns
    -------
    list of LawTerm
        Each differently written.
    """
    found = [
        *_of_speed(ranges, settings),
        *_of_position(ranges, settings),
        *_of_load(ranges),
        *_of_time(ranges, settings),
        *_of_others(ranges),
        *_remembering(ranges, settings),
    ]
    known = [
        replace(shape, known=not set(ranges.effects).isdisjoint(shape.effects)) for shape in found
    ]
    return list({shape.numbers: shape for shape in known}.values())


def _of_speed(ranges: Ranges, settings: ShapeSettings) -> Iterator[LawTerm]:
    """Drags and frictions."""
    yield LawTerm("v", "viscous friction", effects=("joint_damping",))
    yield LawTerm("sign(v)", "dry friction", effects=("joint_friction",))
    yield LawTerm("abs(v) * v", "quadratic drag")
    yield LawTerm("v**3", "cubic drag")
    yield LawTerm("sign(v) * sqrt(abs(v))", "square-root friction")
    yield LawTerm("sign(v) * abs(v)**1.5", "drag with the power 1.5 of speed")
    yield LawTerm("abs(v)", "viscous friction that differs by direction")
    yield LawTerm("v**2", "quadratic drag that differs by direction")
    for speed in _scales(ranges.v, settings.speeds):
        yield LawTerm("tanh(v / {0})", "friction that saturates with speed", (("w", speed),))
        text = "exp(-(v / {0})**2) * sign(v)"
        yield LawTerm(text, "Stribeck", (("w", speed),), ("joint_stribeck",))


def _of_position(ranges: Ranges, settings: ShapeSettings) -> Iterator[LawTerm]:
    """Springs, stops, detents, ripples."""
    yield LawTerm("1", "constant force", effects=CONSTANT)
    yield LawTerm("q", "spring", effects=("joint_stiffness",))
    yield LawTerm("q**2", "spring with a quadratic part")
    yield LawTerm("q**3", "cubic spring")
    yield LawTerm("abs(q) * q", "spring that stiffens")
    yield LawTerm("abs(q)", "spring that differs by side")
    yield LawTerm("q * v", "viscous friction that grows along the way")
    yield LawTerm("q**2 * v", "viscous friction that grows away from the middle")
    yield LawTerm("abs(q) * v", "viscous friction that grows with the distance")
    yield LawTerm("q * sign(v)", "dry friction that grows along the way")
    yield LawTerm("q**2 * sign(v)", "dry friction that grows away from the middle")
    yield LawTerm("abs(q) * sign(v)", "dry friction that grows with the distance")
    span = float(ranges.q[-1] - ranges.q[0])
    for place in _quantiles(ranges.q, settings.places):
        own = ("a", place)
        yield LawTerm("max(q - {0}, 0)", "tether or stop", (own,))
        yield LawTerm("max({0} - q, 0)", "tether or stop", (own,))
        for part in settings.widths:
            sizes = (own, ("w", part * span))
            text = "(q - {0}) * exp(-((q - {0}) / {1})**2)"
            yield LawTerm(text, "detent", sizes)
    for part in settings.places:
        width = float(np.quantile(np.abs(ranges.q), part))
        if width > 0:
            yield LawTerm("dead(q, {0})", "spring with play", (("w", width),))
    kind = "torque ripple" if ranges.hinge else "force ripple"
    if ranges.hinge:
        for order in range(1, settings.orders + 1):
            effects = ("joint_cogging",) if order in COGS else ()
            yield LawTerm(f"sin({order} * q)", kind, effects=effects)
            yield LawTerm(f"cos({order} * q)", kind, effects=effects)
    # Along a slide or behind a gear the length of a ripple may be any.
    for count in range(1, settings.orders + 1):
        own = ("k", float(f"{np.pi * count / max(span, 1e-12):.3g}"))
        yield LawTerm("sin({0} * q)", kind, (own,))
        yield LawTerm("cos({0} * q)", kind, (own,))


def _of_load(ranges: Ranges) -> Iterator[LawTerm]:
    """What grows with the motor's force or the load."""
    yield LawTerm("abs(load) * sign(v)", "friction that grows with the load")
    yield LawTerm("abs(load) * v", "viscous friction that grows with the load")
    yield LawTerm("load", "gravity and inertia that are off")
    yield LawTerm("contact", "contact force that is off")
    yield LawTerm("abs(contact) * sign(v)", "friction that grows with the contact force")
    if not ranges.motor:
        return
    yield LawTerm("motor", "gain", effects=("actuator_gain",))
    loaded = "friction that grows with the drive's force"
    yield LawTerm("abs(motor) * sign(v)", loaded, effects=("joint_load_friction",))
    yield LawTerm("abs(motor) * v", "viscous friction that grows with the drive's force")
    falls = "force that falls with speed"
    yield LawTerm("max(motor * v, 0) * sign(v)", falls, effects=("actuator_torque_speed",))
    yield LawTerm("motor * abs(v)", f"{falls}, braking too", effects=("actuator_torque_speed",))
    yield LawTerm("motor * v**2", "force that falls with the square of speed")
    yield LawTerm("abs(motor) * motor", "gain that falls with the force")
    yield LawTerm("motor**3", "gain that falls with the force")
    yield LawTerm("motor**2", "gain that differs by direction")
    yield LawTerm("abs(motor)", "gain that differs by direction")
    yield LawTerm("motor * q", "gain that changes along the way")
    yield LawTerm("motor * q**2", "gain that changes away from the middle")


def _of_time(ranges: Ranges, settings: ShapeSettings) -> Iterator[LawTerm]:
    """What changes in the course of each trajectory."""
    yield LawTerm("t", "force that grows with time")
    yield LawTerm("t * v", "viscous friction that grows with time")
    yield LawTerm("t * sign(v)", "dry friction that grows with time")
    if ranges.motor:
        yield LawTerm("motor * t", "thermal derating")
    for part in settings.times:
        own = (("T", part * ranges.seconds),)
        yield LawTerm("exp(-t / {0}) * v", "viscous friction that warms up", own)
        yield LawTerm("exp(-t / {0}) * sign(v)", "dry friction that warms up", own)
        if ranges.motor:
            yield LawTerm("motor * exp(-t / {0})", "derating over time", own)


def _of_others(ranges: Ranges) -> Iterator[LawTerm]:
    """What other joints do."""
    for other in ranges.others:
        own = other if other.isidentifier() else None
        q, v = (f"q.{own}", f"v.{own}") if own else (f'q["{other}"]', f'v["{other}"]')
        yield LawTerm(f"{v} * v", "coupling by the product of speeds")
        yield LawTerm(f"{v}**2", "coupling by the square of another speed")
        yield LawTerm(f"abs({v}) * {v}", "drag of another joint")
        yield LawTerm(v, "viscous coupling")
        yield LawTerm(f"sign({v})", "dry friction of another joint")
        yield LawTerm(q, "spring between joints")
        yield LawTerm(f"{q}**3", "cubic spring between joints")
        yield LawTerm(f"{q} * q", "spring that another joint changes")
        yield LawTerm(f"{q} * v", "viscous friction that another joint changes")


def _remembering(ranges: Ranges, settings: ShapeSettings) -> Iterator[LawTerm]:
    """What has states of its own."""
    span = float(ranges.q[-1] - ranges.q[0])
    for part in settings.distances:
        own = (("x", part * span),)
        yield LawTerm("dahl({0})", "presliding (Dahl) friction", own)
        yield LawTerm("abs(load) * dahl({0})", "presliding friction that grows with the load", own)
        if ranges.motor:
            text = "abs(motor) * dahl({0})"
            yield LawTerm(text, "presliding friction that grows with the drive's force", own)
    for part in settings.times:
        own = (("T", part * ranges.seconds),)
        if ranges.motor:
            yield LawTerm("motor * lag(motor**2, {0})", "thermal derating by past force", own)
            yield LawTerm("lag(motor, {0})", "force with a lag", own)
        yield LawTerm("lag(v, {0})", "viscoelastic (Maxwell) element", own)


def _quantiles(grid: Array, parts: Sequence[float]) -> list[float]:
    """Values at parts of a sorted grid of quantiles, to three digits."""
    places = np.interp(parts, np.linspace(0, 1, len(grid)), grid)
    return [float(f"{place:.3g}") for place in places]


def _scales(grid: Array, parts: Sequence[float]) -> list[float]:
    """Positive sizes of a quantity at parts of its quantiles."""
    sizes = np.quantile(np.abs(grid), parts)
    return [float(f"{size:.3g}") for size in sizes if size > 0]
