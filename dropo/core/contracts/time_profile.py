"""Effects that do not always hold: they set in at a moment of the data, or grow through it."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from dropo.core.contracts.effect import EffectInstance, Quantity
from dropo.core.records.trajectories import Segments
from dropo.core.services.validation import Array

MOMENT = Quantity("moment", "1", -0.45, 0.45, (-0.25, 0.25), smooth=False, base=0.5)
"""When something sets in: how far into the data, less a half."""
HOOKS = (
    "model",
    "command",
    "actuation",
    "command_feedback",
    "force",
    "wrench",
    "start",
    "measurement",
    "sensor_delay",
    "declared",
)
STAGES = 10  # of a ramp


def place_in_data(segments: Segments) -> Array:
    """(N,) how far into its data each segment begins, from 0 up to 1; every trajectory is given the
    same share of the data.
    """
    data = segments.trajectories
    first, last = np.array(data.spans).T
    row = segments.steps[:, 0]
    own = data.trajectory[row]
    return np.asarray((own + (row - first[own]) / (last - first)[own]) / len(first))


def set_in(segments: Segments, magnitudes: Array) -> Array:
    """A gate: nothing before the moment 0.5 + sizes[-1] of the data, everything from there on."""
    return (place_in_data(segments) >= MOMENT.base + magnitudes[-1]).astype(float)


def ramp(segments: Segments, magnitudes: Array) -> Array:
    """A gate: from nothing in the data's first tenth to everything in its last, by equal stages."""
    return np.floor(STAGES * place_in_data(segments)) / (STAGES - 1)


@dataclass(frozen=True)
class _Before:
    """A hook that knows nothing of the last quantity."""

    hook: Callable[..., Any]

    def __call__(self, *given: Any) -> Any:
        return self.hook(*given[:-1], given[-1][:-1])


def growing(instance: EffectInstance) -> EffectInstance:
    """The same change, but growing through the data (`ramp`); it goes by the name parameter_drift."""
    return replace(
        instance,
        effect="parameter_drift",
        target=instance.label,
        variant="ramp",
        time_profile=ramp,
        trials=tuple(_ends(instance)),
        alike=(),
    )


def setting_in(instance: EffectInstance) -> EffectInstance:
    """The same change, but from a moment of the data on (`set_in`), which is to be found too; it
    goes by the name parameter_drift.
    """
    hooks: dict[str, Any] = {
        name: _Before(hook) for name in HOOKS if (hook := getattr(instance, name)) is not None
    }
    moments = (MOMENT.probes[0], 0.0, MOMENT.probes[1])
    trials = tuple(
        tuple((*trial, moment) for trial in trials)
        for trials in _ends(instance)
        for moment in moments
    )
    return replace(
        instance,
        effect="parameter_drift",
        target=instance.label,
        variant="from",
        quantities=(*instance.quantities, MOMENT),
        time_profile=set_in,
        trials=trials,
        alike=(),
        **hooks,
    )


def _ends(instance: EffectInstance) -> list[tuple[tuple[float, ...], ...]]:
    """The first and the last of the trials: the largest probes."""
    return [instance.trials[0], *instance.trials[1:][-1:]]
