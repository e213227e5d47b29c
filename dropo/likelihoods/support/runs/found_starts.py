"""A simulator whose runs begin in the start states that were found."""

import copy
from dataclasses import replace

import numpy as np

from dropo.core.contracts.simulator import Simulator
from dropo.core.records.trajectories import Segments
from dropo.core.services.validation import Array
from dropo.likelihoods.support.runs.linearization import Observed


class FoundStarts(Simulator):
    """Replays pieces of runs from found starts, and gives what was measured alone.

    Parameters
    ----------
    observed : Observed
        The simulator of whole states, and which m of its signals were measured.
    rows : (P,) array of int
        The rows at which the pieces begin.
    starts : (P, s) array
        Offsets of the starts, at `value`.
    by_value : (P, s, d) array
        How they follow the parameters.
    value : (d,) or (P, d) array
        Parameters, those of all pieces or of each.
    """

    def __init__(
        self, observed: Observed, rows: Array, starts: Array, by_value: Array, value: Array
    ):
        inner = observed.simulator
        self.observed = observed
        self.of_row = {int(row): p for p, row in enumerate(rows)}
        self.starts = starts
        self.by_value = by_value
        self.value = value
        self.space = inner.space
        self.signals = tuple(np.array(inner.signals, dtype=object)[observed.measured])
        self.nominal = inner.nominal
        self.steps_per_action = inner.steps_per_action
        self.control_step = inner.control_step

    @property
    def start_size(self) -> int:
        """The number of the simulator's start coordinates."""
        return self.observed.simulator.start_size

    def with_finer_steps(self, times: int) -> "FoundStarts | None":
        """The same starts with so many physics steps in the place of one."""
        inner = self.observed.simulator.with_finer_steps(times)
        if inner is None:
            return None
        finer = copy.copy(self)
        finer.observed = replace(self.observed, simulator=inner)
        finer.steps_per_action = inner.steps_per_action
        finer.steps = 0
        finer.failures = 0
        return finer

    def targets(self, segments: Segments) -> Array:
        """(R, m) the measured signals."""
        return self.observed.simulator.targets(segments)[:, self.observed.measured]

    def _predict(self, values: Array, segments: Segments, offsets: Array | None) -> Array:
        piece = [self.of_row[row] for row in segments.steps[:, 0].tolist()]
        centre = np.broadcast_to(self.value, (len(self.starts), values.shape[1]))[piece]
        away = values[:, None] - centre  # (K, P, d)
        moved = np.einsum("psd,kpd->kps", self.by_value[piece], away)
        whole = np.zeros((len(values), len(segments), self.start_size))
        whole[:, :, self.observed.state] = self.starts[piece] + moved
        if offsets is not None:
            whole += offsets
        predicted = self.observed.simulator.predict(values, segments, offsets=whole)
        return predicted[:, :, self.observed.measured]
