"""Data of a motion whose commands were not recorded, with actions that explain it."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from dropo.core.records.trajectories import Signal, Trajectories
from dropo.core.services.errors import BadFile, Incompatible
from dropo.core.services.tables import Report, Table, number
from dropo.core.services.validation import Array, known
from dropo.data.describe import controls, describe
from dropo.problems.file.estimated_velocities import with_velocities
from dropo.problems.file.writer import write_data
from dropo.problems.loading import load_states
from dropo.simulators.mujoco.inferred_actions import by_ideal_controllers, by_inverse_dynamics
from dropo.simulators.mujoco.simulator import MujocoSimulator

METHODS = {"modelled": by_inverse_dynamics, "ideal": by_ideal_controllers}
"""How actions are inferred, by what is taken of the robot's controllers."""


@dataclass(frozen=True, eq=False)
class ActionReplay:
    """Errors of the motion when the actions are replayed from measured states.

    Attributes
    ----------
    horizon : int
        Control steps from each measured state to the state that is compared.
    error : (p,) array
        Root mean square error of every signal, in its unit; NaN if a simulation diverged.
    change : (p,) array
        Root mean square of how far the measured signal itself goes in that time.
    """

    horizon: int
    error: Array
    change: Array


@dataclass(frozen=True, eq=False, repr=False)
class ActionEstimate(Report):
    """The data with inferred actions, and how well these explain the motion.

    Attributes
    ----------
    trajectories : Trajectories
        The data with the columns of the problem's own data, and the actions.
    controllers : str
        "modelled" or "ideal".
    actions : tuple of Signal
        The names of the action columns.
    signals : tuple of Signal
        Names and units of the signals that are compared.
    unexplained : dict of str to tuple
        For each degree of freedom the unit, and the root mean square and the largest size of the
        force that the motion needs and no action gives; empty for ideal controllers.
    replays : tuple of ActionReplay
        The errors of a replay, by horizon.
    """

    trajectories: Trajectories
    controllers: str
    actions: tuple[Signal, ...]
    signals: tuple[Signal, ...]
    unexplained: dict[str, tuple[str, float, float]]
    replays: tuple[ActionReplay, ...]

    def to_json(self) -> dict[str, Any]:
        """Give the numbers of the tables for JSON.

        Returns
        -------
        dict
            The numbers of the tables.
        """
        unexplained = {}
        for name, (unit, rms, largest) in self.unexplained.items():
            unexplained[name] = {"unit": unit, "rms": rms, "largest": largest}
        replay = {}
        for i, signal in enumerate(self.signals):
            replay[signal.name] = {
                "unit": signal.unit,
                "rmse": {str(one.horizon): _finite(one.error[i]) for one in self.replays},
                "change": {str(one.horizon): _finite(one.change[i]) for one in self.replays},
            }
        return {
            "controllers": self.controllers,
            "transitions": len(self.trajectories),
            "actions": self._ranges(),
            "unexplained": unexplained,
            "replay": replay,
        }

    def parts(self) -> list[str | Table]:
        """Give a sentence, and tables of actions, forces that are left over, and replay errors."""
        how = {
            "modelled": "inferred by inverse dynamics",
            "ideal": "taken from the states that were reached, as by ideal controllers",
        }
        count = len(self.trajectories)
        parts: list[str | Table] = [f"Actions of {count} transitions, {how[self.controllers]}."]
        shown = ("min", "mean", "max", "sd")
        ranges = self._ranges()
        rows = [(name, *(number(row[key]) for key in shown)) for name, row in ranges.items()]
        parts.append(Table("", ("action", *shown), tuple(rows)))
        if self.unexplained:
            left = []
            for name, (unit, rms, largest) in self.unexplained.items():
                left.append((name, unit, number(rms, 3), number(largest, 3)))
            title = "Force that the motion needs and no action gives"
            parts.append(Table(title, ("joint", "unit", "rms", "largest"), tuple(left)))
        parts.append(self._replay_table())
        return parts

    def save(self, path: str | Path) -> Path:
        """Write the data into an .npz file that a problem file can name.

        Parameters
        ----------
        path : str or Path
            The file.

        Returns
        -------
        Path
            The same.
        """
        write_data(self.trajectories, Path(path))
        return Path(path)

    def _ranges(self) -> dict[str, dict[str, Any]]:
        """Range, mean and deviation of every action."""
        signals = describe(self.trajectories, controls=self.actions).signals
        return {action.name: signals[action.name] for action in self.actions}

    def _replay_table(self) -> Table:
        """Error and change of every signal, by horizon."""
        header = ["signal", "unit"]
        for one in self.replays:
            steps = "1 step" if one.horizon == 1 else f"{one.horizon} steps"
            header += [f"error, {steps}", "change"]
        rows = []
        for i, signal in enumerate(self.signals):
            cells = [signal.name, signal.unit]
            for one in self.replays:
                cells += [number(one.error[i], 3), number(one.change[i], 3)]
            rows.append(tuple(cells))
        title = "Replay from measured states, root mean square error and the signal's own change"
        return Table(title, tuple(header), tuple(rows))


def infer_actions(
    problem: str | Path,
    controllers: str = "modelled",
    *,
    horizons: Sequence[int] = (1, 10),
    threads: int = 0,
    trusted: bool = True,
) -> ActionEstimate:
    """Compute the actions that explain a measured motion, under the model's nominal parameters.

    Actions in the problem's data do not count, and its data need not hold any. Whole states must
    be observed; velocities of hinges and slides are estimated where they are not.

    Parameters
    ----------
    problem : str or Path
        A problem file or a built-in name.
    controllers : str
        "modelled": the actions under which the model moves as measured, by inverse dynamics.
        "ideal": the actuators are position or velocity controllers whose set point was reached at
        the end of each control step.
    horizons : sequence of int
        Control steps after which the replay is compared with the motion; those longer than every
        trajectory are left out.
    threads : int
        Of the simulator, 0 for all cores.
    trusted : bool
        As of `dropo.load`.

    Returns
    -------
    ActionEstimate
        The data with the actions, and the errors of their replay.

    Raises
    ------
    UnknownName
        If there is no such problem or kind of controllers.
    BadFile
        If something is wrong in the problem file or its data.
    Incompatible
        If states are not whole, or the actuators are not of the kind that is asked for.

    References
    ----------
    The thesis behind the package, chapter 5, "Dataset collection": where demonstrations are
    provided, actions are inferred by inverse dynamics, or under ideal onboard controllers.
    """
    infer = METHODS[known("kind of controllers", controllers, METHODS)]
    recorded = load_states(problem, threads=threads, trusted=trusted)
    whole = with_velocities(recorded)
    simulator = whole.simulator
    if not isinstance(simulator, MujocoSimulator):
        kind = type(simulator).__name__
        raise Incompatible(f"Actions are inferred with a MujocoSimulator, not with a {kind}.")
    found = infer(simulator, whole.trajectories)
    unexplained = _unexplained(simulator, found.unexplained) if controllers == "modelled" else {}
    longest = max(stop - start for start, stop in whole.trajectories.spans)
    replays = [_replay(simulator, found.trajectories, h) for h in horizons if h <= longest]
    actions = found.trajectories.actions
    return ActionEstimate(
        replace(recorded.trajectories, actions=actions),
        controllers,
        tuple(controls(simulator, actions.shape[1])),
        tuple(simulator.signals),
        unexplained,
        tuple(replays),
    )


def check_place(out: Path, problem: str | Path) -> None:
    """Refuse a place for the data that is no .npz file, or that already holds something.

    Parameters
    ----------
    out : Path
        Where the data are to be written.
    problem : str or Path
        Whose data they are.

    Raises
    ------
    BadFile
        If the data cannot be written there.
    """
    if out.suffix != ".npz":
        raise BadFile(out, "--out", "a file that ends in .npz", repr(out.suffix))
    if out.exists():
        expected = f"a new file, so that no data of {problem} are lost"
        raise BadFile(out, "--out", expected, "one that is there")


def _replay(simulator: MujocoSimulator, trajectories: Trajectories, horizon: int) -> ActionReplay:
    """The errors after so many control steps."""
    segments = trajectories.segments(horizon)
    nominal = np.zeros(0) if simulator.nominal is None else np.asarray(simulator.nominal)
    targets = simulator.targets(segments)
    error = simulator.predict(nominal[None], segments)[0] - targets
    change = simulator.layout.coordinates(segments.starts, segments.targets) - targets
    return ActionReplay(horizon, _rms(error), _rms(change))


def _unexplained(simulator: MujocoSimulator, forces: Array) -> dict[str, tuple[str, float, float]]:
    """Unit, root mean square and largest size of the forces (N, nv), by degree of freedom."""
    layout = simulator.layout
    found = {}
    for column, name in zip(layout.columns, layout.names, strict=True):
        if column.field == "qvel":
            linear = layout.model_units.get((column.field, column.place)) == "m/s"
            force = forces[:, column.place]
            unit = "N" if linear else "N m"
            joint = name.removeprefix("qvel.")
            found[joint] = (unit, float(_rms(force)), float(np.abs(force).max()))
    return found


def _rms(values: Array) -> Array:
    """Root mean square of each column."""
    return np.asarray(np.sqrt(np.mean(values**2, axis=0)))


def _finite(value: float) -> float | None:
    """A number for JSON, which has no NaN."""
    return float(value) if np.isfinite(value) else None
