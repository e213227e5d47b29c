"""Effects that do not always hold: they set in at a moment of the data, or grow through it."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from dropo.core.contracts.effect import Atom, Quantity
from dropo.core.records.trajectories import Segments
from dropo.core.services.validation import Array

MOMENT = Quantity("moment", "1", -0.45, 0.45, (-0.25, 0.25), smooth=False, base=0.5)
"""When something sets in: how far into the data, less a half."""
HOOKS = ("model", "command", "actuation", "drive", "force", "wrench", "start", "sense", "late", "declared")
STAGES = 10  # of a ramp


def place_in_data(segments: Segments) -> Array:
    """(N,) how far into its data each segment begins, from 0 up to 1; every trajectory is given the same share of the data."""
    data = segments.trajectories
    first, last = np.array(data.spans).T
    row = segments.steps[:, 0]
    own = data.trajectory[row]
    return np.asarray((own + (row - first[own]) / (last - first)[own]) / len(first))


def set_in(segments: Segments, sizes: Array) -> Array:
    """A gate: nothing before the moment 0.5 + sizes[-1] of the data, everything from there on."""
    return (place_in_data(segments) >= MOMENT.base + sizes[-1]).astype(float)


def ramp(segments: Segments, sizes: Array) -> Array:
    """A gate: from nothing in the data's first tenth to everything in its last, by equal stages."""
    return np.floor(STAGES * place_in_data(segments)) / (STAGES - 1)


@dataclass(frozen=True)
class _Before:
    """A hook that knows nothing of the last quantity."""

    hook: Callable[..., Any]

    def __call__(self, *given: Any) -> Any:
        return self.hook(*given[:-1], given[-1][:-1])


def growing(atom: Atom) -> Atom:
    """The same change, but growing through the data (`ramp`); it goes by the name parameter_drift."""
    return replace(atom, effect="parameter_drift", target=atom.label, variant="ramp", gate=ramp, trials=tuple(_ends(atom)), alike=())


def setting_in(atom: Atom) -> Atom:
    """The same change, but from a moment of the data on (`set_in`), which is to be found too; it goes by the name parameter_drift."""
    hooks: dict[str, Any] = {name: _Before(hook) for name in HOOKS if (hook := getattr(atom, name)) is not None}
    moments = (MOMENT.probes[0], 0.0, MOMENT.probes[1])
    trials = tuple(tuple((*trial, moment) for trial in trials) for trials in _ends(atom) for moment in moments)
    return replace(
        atom, effect="parameter_drift", target=atom.label, variant="from", quantities=(*atom.quantities, MOMENT), gate=set_in,
        trials=trials, alike=(), **hooks,
    )  # fmt: skip


def _ends(atom: Atom) -> list[tuple[tuple[float, ...], ...]]:
    """The first and the last of the trials: the largest probes."""
    return [atom.trials[0], *atom.trials[1:][-1:]]
