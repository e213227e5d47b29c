"""Which numbers motions identify only together."""

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
        label = labels[places[first]][0]
        sizes = [_size(labels[places[i]][1], model.theta[places[i]]) for i in members]
        if len(members) < 2 or np.all(spread[members] < settings.share * np.array(sizes)):
            continue
        total = 1 + model.theta[places[first]]
        known = min(1.0, scale * total / spread[first]) if label.startswith(GAIN) else 1.0
        changes = known * correlation[first] * spread
        moved = [_member(*labels[places[i]], model.theta[places[i]], changes[i]) for i in members]
        sentences.append(
            f"These motions tell only together: {', '.join(moved)}. Each may be off by the number "
            f"in brackets, all at once and in proportion; were {label} known, so would be the rest."
        )
    return tuple(sentences)


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


def _member(label: str, unit: str, value: float, change: float) -> str:
    """A number with its change."""
    shown = "" if unit == "1" else f" {unit}"
    return f"{label} {number(value, 3)} ({number(change, 2)}){shown}"
