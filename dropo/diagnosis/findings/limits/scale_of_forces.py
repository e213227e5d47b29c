"""The scale of all forces of a drive, where the data do not tell it.

A drive's gain is told by what else acts: masses that are known, or their weight. Where rotor
inertia, friction and the gain are all unknown, motions tell only their ratios, and a search finds
one set of many that do the same.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dropo.core.contracts.effect import EffectInstance
from dropo.core.services.validation import Array
from dropo.diagnosis.far_off.model import GAIN
from dropo.diagnosis.far_off.ties import Member, told_together
from dropo.diagnosis.search.linearization import Library
from dropo.diagnosis.search.trials import State

NOTHING = 0.01
"""Fraction of a number by which it must change to be among those that are told together."""
RANK = 1e-8
"""Relative size of a direction in which numbers do nothing."""
MASS = "body_mass"
"""A mass is known as the model has it, which the scale of forces depends on."""
OF_FORCES = (GAIN, "joint_armature", "joint_damping", "joint_friction")
"""The effects that are in proportion to that scale."""


@dataclass(frozen=True)
class ForceScaleSettings:
    """When the scale of forces is not told.

    Attributes
    ----------
    known : float
        Standard deviation of what is known of a drive's gain without data, as a fraction of it.
    told : float
        Where the gain is off by that much and the other numbers make up for it, residuals must
        change by at least so many standard deviations, or it is not told ...
    seen : float
        ... if they change by at least so many where the others do not.
    close : float
        Fraction of the usual widths of differences.
    """

    known: float = 0.2
    told: float = 2.0
    seen: float = 10.0
    close: float = 0.1


SETTINGS = ForceScaleSettings()


@dataclass(frozen=True, eq=False)
class UntoldScale:
    """Numbers that are told only together.

    Attributes
    ----------
    gain : str
        The label of the gain that is on the scale.
    other : EffectInstance
        The effect that is not in the model, and does what numbers of it do together.
    size : float
        How large it may be, in its unit: one standard deviation of what is known of the gain.
    changes : (f,) array
        What the fitted numbers change by where it is that large.
    """

    gain: str
    other: EffectInstance
    size: float
    changes: Array


def untold_scales(
    library: Library, last: State, settings: ForceScaleSettings = SETTINGS
) -> tuple[UntoldScale, ...]:
    """Find the drives whose scale of forces the data do not tell.

    Where declared parameters would have to change too, the model's gain is what they are fitted to.

    Parameters
    ----------
    library : Library
        The simulator with every effect.
    last : State
        A model, fitted to the end.
    settings : ForceScaleSettings
        When it is not told.

    Returns
    -------
    tuple of UntoldScale
        One for each gain at most.
    """
    own = [one for one in last.accepted if one.effect in (*OF_FORCES, MASS)]
    others = [one for one in library.instances if one.effect in OF_FORCES and one not in own]
    if len(own) < 2 or not others:
        return ()
    train = last.train
    places = np.concatenate([library.indices_of[one.label] for one in others])
    numbers = np.concatenate([last.free, places])
    jacobian = library.jacobian(last.theta, numbers, train.windows, settings.close)
    rows = train.flat(jacobian)
    lengths = np.maximum(np.linalg.norm(rows, axis=1), 1e-300)
    unit = rows / lengths[:, None]
    count = len(last.free)
    shares = np.linalg.lstsq(unit[:count].T, unit[count:].T, rcond=RANK)[0]
    left = np.linalg.norm(unit[count:] - shares.T @ unit[:count], axis=1) * lengths[count:]
    best: dict[str, tuple[float, UntoldScale]] = {}
    for i, other in enumerate(others):
        changes = -shares[:, i] * lengths[count + i] / lengths[:count]
        gain, size = _gain_and_size(library, last, other, changes, settings)
        told = size * float(left[i])
        if not told < settings.told or told >= best.get(gain, (np.inf,))[0]:
            continue
        moved = np.abs(size * changes) > NOTHING * np.abs(last.theta[last.free])
        if size * lengths[count + i] < settings.seen or moved[last.free < library.declared].any():
            continue
        best[gain] = told, UntoldScale(gain, other, size, size * changes)
    return tuple(one for _, one in best.values())


def with_known_scale(
    library: Library, last: State, scale: UntoldScale, settings: ForceScaleSettings = SETTINGS
) -> tuple[EffectInstance, Array] | None:
    """Return what a model is whose masses and gain are as they came, and which does the same.

    Parameters
    ----------
    library : Library
        The simulator with every effect.
    last : State
        A model.
    scale : UntoldScale
        Of the model.
    settings : ForceScaleSettings
        What is known of gains.

    Returns
    -------
    known : EffectInstance
        The model's mass or gain in whose place the other effect comes.
    theta : (m,) array
        Where that model is, to first order. None where there is no such mass, where the gain is not
        further off than gains usually are, or the other effect would have to be below its bounds.
    """
    (other,) = library.indices_of[scale.other.label]
    space = library.simulator.space
    for known in last.accepted:
        if known.effect != MASS and known.label != scale.gain:
            continue
        (index,) = library.indices_of[known.label]
        off = float(last.theta[index])
        (change,) = scale.changes[last.free == index]
        if not change or (known.effect == GAIN and abs(off) <= settings.known):
            continue
        magnitude = -off / change * scale.size
        if not space.low[other] < magnitude <= space.high[other]:
            continue
        theta = last.theta.copy()
        theta[last.free] += -off / change * scale.changes
        theta[index] = 0.0
        theta[other] = magnitude
        return known, space.clip(theta)
    return None


def in_words(library: Library, last: State, scales: Sequence[UntoldScale]) -> tuple[str, ...]:
    """Say which numbers are told only together.

    Parameters
    ----------
    library : Library
        The simulator with every effect.
    last : State
        The model.
    scales : sequence of UntoldScale
        Of the model.

    Returns
    -------
    tuple of str
        A sentence each.
    """
    sentences = []
    for scale in scales:
        members = [Member(scale.other.label, scale.other.quantities[0].unit, 0.0, scale.size)]
        for instance in last.accepted:
            if instance.effect not in (*OF_FORCES, MASS):
                continue
            index = library.indices_of[instance.label][0]
            (change,) = scale.changes[last.free == index]
            value = float(last.theta[index])
            if abs(change) > NOTHING * abs(value):
                unit = instance.quantities[0].unit
                members.append(Member(instance.label, unit, value, float(change)))
        if scale.other.effect != GAIN:
            members.sort(key=lambda one: one.label != scale.gain)
        sentences.append(told_together(members))
    return tuple(sentences)


def _gain_and_size(
    library: Library,
    last: State,
    other: EffectInstance,
    changes: Array,
    settings: ForceScaleSettings,
) -> tuple[str, float]:
    """The gain that changes with another effect, and how large that may be; infinite without."""
    if other.effect == GAIN:
        return other.label, settings.known
    gain, size = "", np.inf
    for instance in last.accepted:
        if instance.effect != GAIN:
            continue
        index = library.indices_of[instance.label][0]
        (change,) = np.abs(changes[last.free == index])
        limit = settings.known * (1 + last.theta[index]) / max(float(change), 1e-300)
        if limit < size:
            gain, size = instance.label, float(limit)
    return gain, size
