"""Whole runs that no fit has seen, replayed from their first row by commands alone."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from dropo.core.contracts.simulator import Simulator
from dropo.core.records.trajectories import Trajectories
from dropo.core.services.tables import Table, number
from dropo.core.services.validation import Array
from dropo.diagnosis.findings.accuracy.horizons import LOST


@dataclass(frozen=True)
class ReplaySettings:
    """When a replayed run is named.

    Attributes
    ----------
    odd : float
        Multiple of a signal's usual error from which a run is named.
    fewest_runs : int
        Number of runs from which there is a usual error.
    """

    odd: float = 5.0
    fewest_runs: int = 5


SETTINGS = ReplaySettings()


@dataclass(frozen=True)
class OddReplay:
    """A run in which one signal is off by far more than in the others.

    Attributes
    ----------
    run : int
        Which of the runs held out, from 0.
    signal, unit : str
        Which signal.
    error : float
        Its root mean square error with what was found.
    usual : float
        The median of the runs' errors.
    """

    run: int
    signal: str
    unit: str
    error: float
    usual: float

    def __str__(self) -> str:
        return (
            f"In run {self.run + 1} of those held out {self.signal} is off by"
            f" {number(self.error, 3)} {self.unit}, usually by {number(self.usual, 3)}: something"
            " happened there, or only there."
        )


@dataclass(frozen=True, eq=False)
class WholeRunReplay:
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
    settings : ReplaySettings
        When a run is named.
    """

    seconds: tuple[float, ...]
    signals: tuple[str, ...]
    units: tuple[str, ...]
    before: Array
    after: Array
    settings: ReplaySettings = SETTINGS

    def overall(self, unit: str) -> tuple[float, float]:
        """Compute root mean square errors over all runs and all signals of a unit.

        Parameters
        ----------
        unit : str
            One of `units`.

        Returns
        -------
        before, after : float
            In that unit.
        """
        own = np.array(self.units) == unit
        weights = np.array(self.seconds)
        before = overall_error(self.before[:, own], weights)
        after = overall_error(self.after[:, own], weights)
        return before, after

    def odd(self) -> list[OddReplay]:
        """List runs in which a signal is off by far more than in most.

        Returns
        -------
        list of OddReplay
            None where runs are too few to have a usual error.
        """
        if len(self.after) < self.settings.fewest_runs:
            return []
        usual = np.median(self.after, axis=0)
        places = np.argwhere(self.after > self.settings.odd * usual)
        return [
            OddReplay(
                run=run,
                signal=self.signals[i],
                unit=self.units[i],
                error=float(self.after[run, i]),
                usual=float(usual[i]),
            )
            for run, i in places.tolist()
        ]

    def usual(self, unit: str) -> float:
        """Compute the error with what was found, each signal without its odd runs.

        Parameters
        ----------
        unit : str
            One of `units`.

        Returns
        -------
        float
            In that unit.
        """
        weights = np.repeat(np.array(self.seconds)[:, None], len(self.signals), axis=1)
        for one in self.odd():
            weights[one.run, self.signals.index(one.signal)] = 0.0
        own = np.array(self.units) == unit
        return overall_error(self.after[:, own], weights[:, own])

    def table(self) -> Table:
        """Make a table of the errors.

        Returns
        -------
        Table
            A row for each signal, then one for each unit.
        """
        weights = np.array(self.seconds)
        rows = []
        for i, (signal, unit) in enumerate(zip(self.signals, self.units, strict=True)):
            sides = (self.before[:, [i]], self.after[:, [i]])
            errors = [number(overall_error(side, weights), 3) for side in sides]
            rows.append((signal, unit, *errors))
        for unit in dict.fromkeys(self.units):
            rows.append(("all", unit, *(number(error, 3) for error in self.overall(unit))))
        for unit in dict.fromkeys(one.unit for one in self.odd()):
            rows.append(("all but odd runs", unit, "", number(self.usual(unit), 3)))
        title = f"Whole runs held out ({len(self.seconds)}), by commands alone"
        return Table(title, ("signal", "unit", "as it came", "with what was found"), tuple(rows))

    def to_json(self) -> dict[str, Any]:
        """As diagnosis.json has it.

        Returns
        -------
        dict
            As diagnosis.json has it.
        """
        runs = []
        for i, seconds in enumerate(self.seconds):
            nominal = dict(zip(self.signals, self.before[i].tolist(), strict=True))
            extended = dict(zip(self.signals, self.after[i].tolist(), strict=True))
            runs.append({"seconds": seconds, "nominal": nominal, "extended": extended})
        units = {}
        for unit in dict.fromkeys(self.units):
            before, after = self.overall(unit)
            units[unit] = {"nominal": before, "extended": after}
        return {"units": units, "runs": runs, "odd": [asdict(one) for one in self.odd()]}


def replay(
    simulator: Simulator,
    data: Trajectories,
    thetas: Sequence[Array],
    settings: ReplaySettings = SETTINGS,
) -> WholeRunReplay:
    """Replay whole runs with two models.

    Parameters
    ----------
    simulator : Simulator
        With m parameters.
    data : Trajectories
        The runs.
    thetas : sequence of two (m,) arrays
        The model as it came, and with what was found.
    settings : ReplaySettings
        When a run is named.

    Returns
    -------
    WholeRunReplay
    """
    segments = data.segments(reset="start", every_step=True)
    targets = simulator.targets(segments)
    maximum = LOST * np.std(targets, axis=0)
    errors = np.abs(targets - simulator.predict(np.stack(thetas), segments))
    errors = np.minimum(np.where(np.isfinite(errors), errors, np.inf), maximum)
    square = np.stack([np.mean(errors[:, a:b] ** 2, axis=1) for a, b in data.spans])
    before, after = np.moveaxis(np.sqrt(square), 1, 0)
    step = simulator.control_step or 1.0
    return WholeRunReplay(
        seconds=tuple((b - a) * step for a, b in data.spans),
        signals=tuple(signal.name for signal in simulator.signals),
        units=tuple(signal.unit for signal in simulator.signals),
        before=before,
        after=after,
        settings=settings,
    )


def overall_error(errors: Array, weights: Array) -> float:
    """Compute the root mean square error over runs and signals.

    Parameters
    ----------
    errors : (n, k) array
        Of each run and signal, as root mean squares.
    weights : (n,) or (n, k) array
        Lengths of the runs.

    Returns
    -------
    float
    """
    return float(np.sqrt(np.average(errors**2, axis=0, weights=weights).mean()))
