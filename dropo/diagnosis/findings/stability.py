"""Whether a cause is named in windows of other lengths, and in each half of the data alone."""

from collections.abc import Callable, Collection
from dataclasses import dataclass

import numpy as np

from dropo.core.contracts.effect import EffectInstance
from dropo.core.records.trajectories import Ints
from dropo.core.services.errors import BadArgument
from dropo.diagnosis.parts import Alternative, Stability
from dropo.diagnosis.search.linearization import LinearizedWindows, linearize
from dropo.diagnosis.search.review import Review
from dropo.diagnosis.search.selection import Selection
from dropo.diagnosis.search.windows import Windows

Cut = Callable[[int], Windows]
"""Windows to fit of so many control steps; raises BadArgument where the data are too few."""


@dataclass(frozen=True)
class StabilitySettings:
    """How a cause is tried again.

    Attributes
    ----------
    lengths : tuple of float
        Other lengths of windows, in that of the diagnosis.
    alternatives : int
        Other effects, those that promised most, beside which it is screened.
    stride : int
        One window of so many is taken of the other lengths.
    nearly : float
        It is named where it promises at least this fraction of what any other effect does.
    """

    lengths: tuple[float, ...] = (0.5, 2.0)
    alternatives: int = 7
    stride: int = 4
    nearly: float = 0.9


SETTINGS = StabilitySettings()


def stability(
    selection: Selection,
    cut: Cut,
    instance: EffectInstance,
    found: Review,
    alike: Collection[Alternative] = (),
    settings: StabilitySettings = SETTINGS,
) -> Stability | None:
    """Screen an accepted effect again, on windows of other lengths and on halves of the data.

    The model has everything else that was found, and its noise. Effects that the data cannot tell
    from it count as it.

    Parameters
    ----------
    selection : Selection
        The search that accepted it.
    cut : callable
        Cuts windows of another length.
    instance : EffectInstance
        The effect.
    found : Review
        What became of it when it was evaluated again.
    alike : collection of Alternative
        The effects that cannot be distinguished from it.
    settings : StabilitySettings
        How it is tried again.

    Returns
    -------
    Stability or None
        None where no batch of candidates had it.
    """
    if found.origin is None:
        return None
    without = found.without
    present = {other.label for other in without.accepted}
    same = {(other.effect, other.target, other.variant) for other in alike}
    alternatives = []
    for candidate in found.origin.screened:
        other = candidate.instance
        # The target of an effect with a time profile is the label of the one without.
        is_itself = instance.label in (other.label, other.target)
        is_alike = (other.effect, other.target, other.variant) in same
        if not (is_itself or is_alike or other.label in present):
            alternatives.append(other)
    tried = [instance, *alternatives[: settings.alternatives]]

    def named(windows: LinearizedWindows, *parts: Ints) -> list[bool]:
        """Whether, in each part of the windows, nothing but its likes promises more."""
        answers = []
        for candidates in selection.screening.by_part(windows, without.free, tried, parts):
            gains = {candidate.instance.label: candidate.gain for candidate in candidates}
            own = gains.pop(instance.label, 0.0)
            answers.append(own > 0 and own >= settings.nearly * max(gains.values(), default=0.0))
        return answers

    train = without.train
    length = train.windows.length
    count = np.arange(len(train.windows))
    own_length, first, second = named(train, count, *np.array_split(count, 2))
    by_length = {length: own_length}
    for factor in settings.lengths:
        steps = max(1, round(factor * length))
        try:
            windows = cut(steps)
        except BadArgument:
            continue
        windows = windows.take(np.arange(0, len(windows), settings.stride))
        noise = train.whiten.noise
        linearized = linearize(selection.library, windows, train.theta, noise)
        (by_length[steps],) = named(linearized, np.arange(len(windows)))
    return Stability(dict(sorted(by_length.items())), (first, second))
