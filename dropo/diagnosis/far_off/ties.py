"""Which numbers motions identify only together."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dropo.core.records.trajectories import Ints
from dropo.core.services.tables import number
from dropo.core.services.validation import Array
from dropo.diagnosis.far_off.model import GAIN, FarOffModel


@dataclass(frozen=True)
class TieSettings:
    """When numbers are identifiable only together.

    Attributes
    ----------
    alone : float
        Numbers are tied if their error is this many times what it would be were the others known.
    alike : float
        Their errors must be correlated by at least this.
    share : float
        One of them must be known to no better than this fraction of itself, or of 1 if it is a
        fraction.
    """

    alone: float = 3.0
    alike: float = 0.9
    share: float = 0.1


SETTINGS = TieSettings()


@dataclass(frozen=True)
class Member:
    """A number that is told only together with others.

    Attributes
    ----------
    label : str
        What it is called.
    unit : str
        Its unit.
    value : float
        The number.
    change : float
        By how much it may be off.
    """

    label: str
    unit: str
    value: float
    change: float

    def __str__(self) -> str:
        shown = "" if self.unit == "1" else f" {self.unit}"
        return f"{self.label} {number(self.value, 3)} ({number(self.change, 2)}){shown}"


def ties_of(
    model: FarOffModel,
    covariance: Array,
    free: Ints,
    scale: float,
    settings: TieSettings = SETTINGS,
) -> tuple[str, ...]:
    """Name the numbers that motions tell only together, and how they move together.

    Parameters
    ----------
    model : FarOffModel
        With all numbers.
    covariance : (f, f) array
        Of the fitted numbers; infinite on the diagonal for those that no motion tells, which are
        in no set.
    free : (f,) int array
        Which of all numbers they are.
    scale : float
        Standard deviation of what is known of gains else, as a fraction of them.
    settings : TieSettings
        When.

    Returns
    -------
    tuple of str
        A sentence for each set: each member, and its change where the first one is off by its
        error. A gain comes first.
    """
    identifiable = np.isfinite(np.diag(covariance))
    covariance = covariance[np.ix_(identifiable, identifiable)]
    free = free[identifiable]
    spread = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    correlation = covariance / np.outer(spread, spread)
    alone = 1 / np.sqrt(np.maximum(np.diag(np.linalg.pinv(correlation, hermitian=True)), 1e-300))
    labels = _labels(model)
    places = free.tolist()
    tied = alone * settings.alone < 1
    left = [i for i, place in enumerate(places) if tied[i] and place in labels]
    left.sort(key=lambda i: (not labels[places[i]][0].startswith(GAIN), -float(spread[i])))
    sentences = []
    while left:
        first = left[0]
        members = [i for i in left if abs(correlation[first, i]) > settings.alike]
        left = [i for i in left if i not in members]
        label, _ = labels[places[first]]
        sizes = [_size(labels[places[i]][1], model.theta[places[i]]) for i in members]
        if len(members) < 2 or np.all(spread[members] < settings.share * np.array(sizes)):
            continue
        total = 1 + model.theta[places[first]]
        known = min(1.0, scale * total / spread[first]) if label.startswith(GAIN) else 1.0
        changes = known * correlation[first] * spread
        moved = [
            Member(*labels[places[i]], float(model.theta[places[i]]), float(changes[i]))
            for i in members
        ]
        sentences.append(told_together(moved))
    return tuple(sentences)


def told_together(members: Sequence[Member]) -> str:
    """Say that numbers are told only together.

    Parameters
    ----------
    members : sequence of Member
        The numbers; the first one is what would have to be known.

    Returns
    -------
    str
        A sentence.
    """
    moved = ", ".join(map(str, members))
    return (
        f"These motions tell only together: {moved}. Each may be off by the number in brackets, "
        f"all at once and in proportion; were {members[0].label} known, so would be the rest."
    )


def _labels(model: FarOffModel) -> dict[int, tuple[str, str]]:
    """By the index of a number, what it is called and its unit."""
    found = {}
    for instance, _ in model.numbers:
        indices = model.library.indices_of[instance.label].tolist()
        for index, quantity in zip(indices, instance.quantities, strict=True):
            several = f" {quantity.name}" if len(indices) > 1 else ""
            found[index] = instance.label + several, quantity.unit
    return found


def _size(unit: str, value: float) -> float:
    """What a number's error is compared with."""
    return 1.0 if unit == "1" else abs(value)
