"""Effects of one kind at every joint or drive at once, where whole motions ask for them."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dropo.core.contracts.effect import EffectInstance, instances_of
from dropo.core.records.trajectories import Ints
from dropo.core.services.validation import Array
from dropo.diagnosis.far_off.fit import Fitted, OutputError, OutputErrorSettings
from dropo.diagnosis.far_off.model import FarOffModel, reaching
from dropo.diagnosis.far_off.motions import Motions
from dropo.diagnosis.search.library import declared, robot_of

EVERYWHERE = (None, "hinges", "slides")
"""Targets of effects that act at many places alike."""


@dataclass(frozen=True)
class FamilySettings:
    """Which families are tried, and when one is asked for.

    Attributes
    ----------
    names : tuple of str
        Names of effects, each tried at every place.
    share : float
        Fraction of the cost that a family must take away on data left out ...
    z : float
        ... and in standard errors over the parts of the data.
    folds : int
        Parts of the data, each left out in turn: one block of so many, so that all are alike.
    ridge : float
        Added to the diagonal of products of derivatives of length 1.
    """

    names: tuple[str, ...] = (
        "actuator_gain",
        "actuator_bias",
        "joint_friction",
        "joint_damping",
        "joint_armature",
        "joint_load_friction",
        "actuator_lag",
    )
    share: float = 0.01
    z: float = 2.0
    folds: int = 6
    ridge: float = 1e-4


SETTINGS = FamilySettings()

Family = Sequence[EffectInstance]


def with_families(
    model: FarOffModel,
    motions: Motions,
    settings: FamilySettings = SETTINGS,
    fit: OutputErrorSettings | None = None,
) -> FarOffModel:
    """Add the families that motions ask for, to first order, by data left out in turn.

    Parameters
    ----------
    model : FarOffModel
        Fitted to the motions.
    motions : Motions
        What is compared.
    settings : FamilySettings
        Which families.
    fit : OutputErrorSettings, optional
        How motions are linearized.

    Returns
    -------
    FarOffModel
        The same object where they ask for none. New numbers are 0, or what the same effect had
        everywhere alike, which they replace.
    """
    families = _families(model, settings)
    every = [instance for family in families for instance in family]
    if not every:
        return model
    library = model.library_with(every)
    places = [
        np.concatenate([library.places[instance.label] for instance in family])
        for family in families
    ]
    theta = model.theta_with(sum(len(one) for one in places))
    free = np.concatenate([model.fitted, *places]).astype(np.int64)
    end = OutputError(library, motions, fit or OutputErrorSettings()).linearize(theta, free)
    gains = _Gains(end, _folds(motions, settings.folds), settings.ridge)
    chosen = _chosen(gains, len(model.fitted), places, settings)
    return _joined(model, [families[i] for i in chosen]) if chosen else model


def _chosen(
    gains: "_Gains", own: int, places: Sequence[Ints], settings: FamilySettings
) -> list[int]:
    """The numbers of families that are asked for, the one that gains most first.

    own: how many numbers the model has.
    """
    ends = own + np.cumsum([len(one) for one in places])
    columns = [np.arange(end - len(one), end) for end, one in zip(ends, places, strict=True)]
    taken = np.arange(own)
    before = gains.without_each(taken)
    found: list[int] = []
    left = list(range(len(places)))
    while left:
        tried = [gains.without_each(np.append(taken, columns[i])) for i in left]
        best = int(np.argmax([one.sum() for one in tried]))
        more = tried[best] - before
        z = more.sum() / max(more.std(ddof=1) * np.sqrt(len(more)), 1e-300)
        if more.sum() < settings.share * gains.cost or z < settings.z:
            break
        before = tried[best]
        found.append(left.pop(best))
        taken = np.append(taken, columns[found[-1]])
    return found


class _Gains:
    """What numbers gain to first order on each part of the data, fitted to all other parts.

    Parameters
    ----------
    end : Fitted
        Linearized in all numbers.
    folds : (W,) int array
        The part of the data of each window.
    ridge : float
        As of `FamilySettings`.
    """

    def __init__(self, end: Fitted, folds: Ints, ridge: float) -> None:
        size = np.sqrt(np.maximum((end.rows**2).sum(axis=(1, 2)), 1e-300))
        grams = []
        moments = []
        for fold in np.unique(folds):
            rows = end.rows[:, folds == fold].reshape(len(end.rows), -1) / size[:, None]
            grams.append(rows @ rows.T)
            moments.append(rows @ end.target[folds == fold].ravel())
        self.grams = np.stack(grams)
        self.moments = np.stack(moments)
        self.cost = float(0.5 * (end.target**2).sum())
        self.ridge = ridge

    def without_each(self, chosen: Ints) -> Array:
        """(K,) the gain of some numbers on each part [nats]."""
        every = self.grams.sum(axis=0)
        moments = self.moments.sum(axis=0)
        own = np.ix_(chosen, chosen)
        ridge = self.ridge * np.eye(len(chosen))
        found = []
        for gram, moment in zip(self.grams, self.moments, strict=True):
            step = np.linalg.solve((every - gram)[own] + ridge, (moments - moment)[chosen])
            found.append(step @ moment[chosen] - 0.5 * step @ gram[own] @ step)
        return np.array(found)


def _folds(motions: Motions, count: int) -> Ints:
    """(W,) the part of the data of each window."""
    block = np.unique(motions.windows.block, return_inverse=True)[1]
    return np.asarray(block % count, dtype=np.int64)


def _families(model: FarOffModel, settings: FamilySettings) -> list[list[EffectInstance]]:
    """Effects at every place, but for those that the model has there or declares."""
    simulator = robot_of(model.problem)
    taken = {instance.label for instance, _ in model.numbers}
    found = []
    for name in settings.names:
        family = [
            instance
            for instance in instances_of(simulator.effect_context, name)
            if instance.target not in EVERYWHERE
            and not instance.variant
            and instance.label not in taken
            and not declared(simulator, instance, model.free)
        ]
        if family:
            found.append(family)
    return found


def _joined(model: FarOffModel, families: Sequence[Family]) -> FarOffModel:
    """The model with families of effects, which begin with what the same has everywhere."""
    for family in families:
        sizes = np.zeros(len(family[0].quantities))
        replaced = []
        for instance, own in model.numbers:
            if instance.effect == family[0].effect and instance.target in EVERYWHERE:
                sizes = own
                replaced.append(instance.label)
        numbers = [(reaching(instance, sizes), sizes.copy()) for instance in family]
        model = model.without(replaced).with_numbers(numbers)
    return model
