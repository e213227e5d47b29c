"""Effects that do not always hold: they set in at a moment of the data, or grow through it."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from dropo.core.contracts.effect import EffectInstance, Quantity
from dropo.core.records.trajectories import Segments
from dropo.core.services.validation import Array

ONSET = Quantity("moment", "1", -0.45, 0.45, (-0.25, 0.25), smooth=False, base=0.5)
"""The time at which an effect sets in, as a fraction of the data, less 0.5."""
EDGE = 0.01
"""An effect that sets in nearer to the bounds of `ONSET` has no data without it, or with it."""
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
"""The hooks that can be limited in time."""
STAGES = 10
"""The number of stages of a ramp, as `parameter_drift` defines it."""


def place_in_data(segments: Segments) -> Array:
    """Locate the start of each segment in the data.

    Parameters
    ----------
    segments : Segments
        N segments.

    Returns
    -------
    (N,) array
        From 0 for the first row of the data up to 1; every trajectory counts for the same fraction
        of the data, whatever its length.
    """
    data = segments.trajectories
    first, last = np.array(data.spans).T
    row = segments.steps[:, 0]
    own = data.trajectory[row]
    within = (row - first[own]) / (last - first)[own]
    return np.asarray((own + within) / len(first))


def set_in(segments: Segments, magnitudes: Array) -> Array:
    """Switch an effect on at a moment of the data: a time profile.

    Parameters
    ----------
    segments : Segments
        N segments.
    magnitudes : (q,) array
        The last one is the moment at which the effect sets in, less 0.5.

    Returns
    -------
    (N,) array
        0 before that moment and 1 from then on.
    """
    return (place_in_data(segments) >= ONSET.base + magnitudes[-1]).astype(float)


def sets_in_at_an_end(instance: EffectInstance, magnitudes: Array) -> bool:
    """Say whether an effect that sets in does so where hardly any data are on one side.

    Such a moment is on its bound: what is always there, or stands for something in a few rows.

    Parameters
    ----------
    instance : EffectInstance
        Any.
    magnitudes : (q,) array
        Its magnitudes.

    Returns
    -------
    bool
        False of an effect that does not set in.
    """
    if instance.time_profile is not set_in:
        return False
    return bool(abs(magnitudes[-1]) > ONSET.high - EDGE)


def ramp(segments: Segments, magnitudes: Array) -> Array:
    """Let an effect grow through the data in ten equal stages: a time profile.

    Parameters
    ----------
    segments : Segments
        N segments.
    magnitudes : (q,) array
        Not used.

    Returns
    -------
    (N,) array
        From 0 in the first tenth of the data to 1 in the last.
    """
    return np.floor(STAGES * place_in_data(segments)) / (STAGES - 1)


@dataclass(frozen=True)
class _WithoutOnset:
    """A hook that is called without the last magnitude, the onset."""

    hook: Callable[..., Any]

    def __call__(self, *arguments: Any) -> Any:
        magnitudes = arguments[-1]
        return self.hook(*arguments[:-1], magnitudes[:-1])


def growing(instance: EffectInstance) -> EffectInstance:
    """Make an effect that grows through the data (see `ramp`).

    Parameters
    ----------
    instance : EffectInstance
        The effect at its full magnitude.

    Returns
    -------
    EffectInstance
        The same change, as an instance of `parameter_drift` with the variant "ramp".
    """
    return replace(
        instance,
        effect="parameter_drift",
        target=instance.label,
        variant="ramp",
        time_profile=ramp,
        trials=tuple(_extreme_trials(instance)),
        alike=(),
    )


def setting_in(instance: EffectInstance) -> EffectInstance:
    """Make an effect that holds from a moment of the data on, which is to be found too.

    Parameters
    ----------
    instance : EffectInstance
        The effect without a moment.

    Returns
    -------
    EffectInstance
        The same change, as an instance of `parameter_drift` with the variant "from"; its last
        quantity is the moment (see `set_in`).
    """
    hooks: dict[str, Any] = {}
    for name in HOOKS:
        hook = getattr(instance, name)
        if hook is not None:
            hooks[name] = _WithoutOnset(hook)
    onsets = (ONSET.probes[0], 0.0, ONSET.probes[1])
    trials = tuple(
        tuple((*trial, onset) for trial in trials)
        for trials in _extreme_trials(instance)
        for onset in onsets
    )
    return replace(
        instance,
        effect="parameter_drift",
        target=instance.label,
        variant="from",
        quantities=(*instance.quantities, ONSET),
        time_profile=set_in,
        trials=trials,
        alike=(),
        **hooks,
    )


def _extreme_trials(instance: EffectInstance) -> list[tuple[tuple[float, ...], ...]]:
    """The first and the last set of trials: the largest probes."""
    if len(instance.trials) == 1:
        return [instance.trials[0]]
    return [instance.trials[0], instance.trials[-1]]
