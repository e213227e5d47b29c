"""Whole runs that no fit has seen, replayed from their first row by commands alone."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from dropo.core.contracts.simulator import Simulator
from dropo.core.records.trajectories import Trajectories
from dropo.core.services.tables import Table, number
from dropo.core.services.validation import Array

LOST = 2.0
"""Multiple of a signal's spread that an error counts at most: beyond it the motion is lost."""


@dataclass(frozen=True, eq=False)
class Replay:
    """How far whole runs are off, without any measurement on the way.

    Attributes
    ----------
    seconds : tuple of float
        The runs' lengths [s]; control steps where the simulator does not know their time.
    signals : tuple of str
        The p signals.
    units : tuple of str
        Their units.
    before, after : (n, p) array
        Root mean square errors of each run with the model as it came, and with what was found. An
        error counts as twice the signal's spread at most; so does a simulation that has diverged.
    """

    seconds: tuple[float, ...]
    signals: tuple[str, ...]
    units: tuple[str, ...]
    before: Array
    after: Array

    def overall(self, unit: str) -> tuple[float, float]:
        """Root mean square errors over all runs and all signals of a unit, before and after."""
        own = np.array(self.units) == unit
        weights = np.array(self.seconds)
        return _overall(self.before[:, own], weights), _overall(self.after[:, own], weights)

    def table(self) -> Table:
        """A row for each signal."""
        weights = np.array(self.seconds)
        rows = []
        for i, (signal, unit) in enumerate(zip(self.signals, self.units, strict=True)):
            sides = (self.before[:, [i]], self.after[:, [i]])
            errors = [number(_overall(side, weights), 3) for side in sides]
            rows.append((signal, unit, *errors))
        for unit in dict.fromkeys(self.units):
            rows.append(("all", unit, *(number(error, 3) for error in self.overall(unit))))
        title = f"Whole runs held out ({len(self.seconds)}), by commands alone"
        return Table(title, ("signal", "unit", "as it came", "with what was found"), tuple(rows))

    def to_json(self) -> dict[str, Any]:
        """As diagnosis.json has it."""
        runs = []
        for i, seconds in enumerate(self.seconds):
            nominal = dict(zip(self.signals, self.before[i].tolist(), strict=True))
            extended = dict(zip(self.signals, self.after[i].tolist(), strict=True))
            runs.append({"seconds": seconds, "nominal": nominal, "extended": extended})
        units = {}
        for unit in dict.fromkeys(self.units):
            before, after = self.overall(unit)
            units[unit] = {"nominal": before, "extended": after}
        return {"units": units, "runs": runs}


def replay(simulator: Simulator, data: Trajectories, thetas: Sequence[Array]) -> Replay:
    """Replay whole runs with two models.

    Parameters
    ----------
    simulator : Simulator
        With m parameters.
    data : Trajectories
        The runs.
    thetas : sequence of two (m,) arrays
        The model as it came, and with what was found.

    Returns
    -------
    Replay
    """
    segments = data.segments(reset="start", every_step=True)
    targets = simulator.targets(segments)
    most = LOST * np.std(targets, axis=0)
    errors = np.abs(targets - simulator.predict(np.stack(thetas), segments))
    errors = np.minimum(np.where(np.isfinite(errors), errors, np.inf), most)
    square = np.stack([np.mean(errors[:, a:b] ** 2, axis=1) for a, b in data.spans])
    before, after = np.moveaxis(np.sqrt(square), 1, 0)
    step = simulator.control_step or 1.0
    return Replay(
        seconds=tuple((b - a) * step for a, b in data.spans),
        signals=tuple(signal.name for signal in simulator.signals),
        units=tuple(signal.unit for signal in simulator.signals),
        before=before,
        after=after,
    )


def _overall(errors: Array, weights: Array) -> float:
    """The root mean square of errors (n, k) of runs of these lengths (n,)."""
    return float(np.sqrt(np.average(errors**2, axis=0, weights=weights).mean()))
