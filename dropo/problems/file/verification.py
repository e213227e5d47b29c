"""What a diagnosis announced, once more: its extended model in plain MuJoCo."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from dropo.core.contracts.effect import ActiveEffects
from dropo.core.records.saved_schema import REGRESSION, read_diagnosis
from dropo.core.records.trajectories import Ints, Segments
from dropo.core.services.errors import BadFile
from dropo.core.services.tables import Report, Table, number, steps_text
from dropo.core.services.validation import Array
from dropo.evaluation.held_out import OF_DIAGNOSIS, errors_of, held_out_part, held_out_windows
from dropo.mjmodel.numbers import changed_numbers
from dropo.mjmodel.options import physics_step
from dropo.mjmodel.warnings import suppress_mujoco_warnings
from dropo.problems.file.plain_model import (
    active_effects,
    format_plain_model,
    load_robot,
    read_plain_model,
    run_plain_model,
)
from dropo.problems.loading import load
from dropo.simulators.mujoco.layers import (
    delay_columns,
    measured_signals,
    split_by_time_profile,
    start_speeds,
    total_delays,
    true_starts,
)
from dropo.simulators.mujoco.plain_robot import Robot, write_numbers
from dropo.simulators.mujoco.simulator import MAX_STATE, MujocoSimulator

TOLERANCE = 0.02
"""Fraction of an announced error by which the verified one may differ."""
ROUNDING = 1e-7
"""Fraction of a signal's spread below which two errors are the same: of rounding alone."""


@dataclass(frozen=True)
class Verified:
    """An error that was announced, and the same in plain MuJoCo.

    Attributes
    ----------
    steps : int
        The horizon in control steps.
    seconds : float or None
        The horizon [s].
    unit : str
        Of the signals.
    announced, verified : float
        Root mean square errors over the signals of that unit.
    negligible : float
        Differences below it are of rounding.
    """

    steps: int
    seconds: float | None
    unit: str
    announced: float
    verified: float
    negligible: float

    @property
    def difference(self) -> float:
        """The difference, as a fraction of what was announced; 0 where it is negligible."""
        off = abs(self.verified - self.announced)
        return 0.0 if off <= self.negligible else off / max(self.announced, self.negligible)


@dataclass(frozen=True, repr=False)
class Verification(Report):
    """The errors of a diagnosis' extended model, announced and verified.

    Attributes
    ----------
    name : str
        The problem's.
    errors : tuple of Verified
        By horizon and unit.
    """

    name: str
    errors: tuple[Verified, ...]

    @property
    def difference(self) -> float:
        """The largest difference, as a fraction of an announced error."""
        return max((one.difference for one in self.errors), default=0.0)

    @property
    def holds(self) -> bool:
        """Whether every error is the announced one within `TOLERANCE`."""
        return self.difference <= TOLERANCE

    def parts(self) -> list[str | Table]:
        """The table of errors, and whether they hold."""
        rows = []
        for one in self.errors:
            after = steps_text(one.steps, one.seconds)
            errors = (number(one.announced, 3), number(one.verified, 3))
            rows.append((after, one.unit, *errors, f"{one.difference:.2%}"))
        header = ("after", "unit", "announced", "in plain MuJoCo", "difference")
        table = Table("Errors on held-out data", header, tuple(rows))
        said = "as announced" if self.holds else "NOT as announced"
        return [table, f"The errors are {said}: at most {self.difference:.2%} off."]

    def to_json(self) -> dict[str, Any]:
        """As `dropo verify --json` prints it.

        Returns
        -------
        dict
            As `dropo verify --json` prints it.
        """
        errors = [
            {
                "steps": one.steps,
                "seconds": one.seconds,
                "unit": one.unit,
                "announced": one.announced,
                "verified": one.verified,
                "difference": one.difference,
            }
            for one in self.errors
        ]
        return {"problem": self.name, "holds": self.holds, "errors": errors}


def verify(folder: str | Path, *, trusted: bool = False) -> Verification:
    """Roll the extended model of a diagnosis out in plain MuJoCo, and compare its errors.

    Parameters
    ----------
    folder : str or Path
        What `dropo diagnose --out` wrote.
    trusted : bool
        Whether model.py is run even if it is not what this version writes.

    Returns
    -------
    Verification

    Raises
    ------
    BadFile
        If the folder holds no diagnosis by simulation, a file of its extended model is missing or
        broken, or model.py was changed and is not trusted.
    """
    folder = Path(folder)
    kept = folder / "diagnosis.json"
    content = read_diagnosis(kept)
    if content.get("method") == REGRESSION:
        rule = "a diagnosis by simulation, which `dropo diagnose` makes without --quick"
        raise BadFile(kept, "method", rule, REGRESSION)
    if not content.get("extended_problem"):
        raise BadFile(kept, "extended_problem", "the path of an extended problem", "none")
    path = folder / str(content["extended_problem"])
    problem = load(path, checked=False, trusted=False)
    simulator = problem.simulator
    if not isinstance(simulator, MujocoSimulator):
        raise BadFile(path, "model", "a MuJoCo model", type(simulator).__name__)
    rollout = PlainRollout(simulator, values_of(simulator, content), path.parent, trusted)
    part = held_out_part(problem, content["window_steps"])
    errors: list[Verified] = []
    for i, announced in enumerate(content["extended"]["horizons"]):
        windows = held_out_windows(part, announced["steps"], OF_DIAGNOSIS)
        if announced["rmse"] is None or not len(windows):
            continue
        with suppress_mujoco_warnings():
            predicted = rollout.predict(windows)
        spread = np.ones(len(simulator.signals))
        (found,) = errors_of(simulator, predicted[None], windows, spread)
        scale = np.abs(simulator.targets(windows)).max()
        for unit, value in found.by_unit.items():
            if unit not in announced["units"]:
                key = f"extended.horizons.{i}.units"
                got = ", ".join(announced["units"]) or "none"
                raise BadFile(kept, key, f"an error in {unit}", got)
            said = announced["units"][unit]["rmse"]
            if said is None:
                key = f"extended.horizons.{i}.units.{unit}.rmse"
                raise BadFile(kept, key, "a number, as the horizon's rmse is one", "null")
            negligible = ROUNDING * float(scale)
            steps, seconds = announced["steps"], announced["seconds"]
            errors.append(Verified(steps, seconds, unit, said, value, negligible))
    return Verification(str(content["problem"]), tuple(errors))


def values_of(simulator: MujocoSimulator, content: dict[str, Any]) -> Array:
    """Read the parameters of an extended model.

    Parameters
    ----------
    simulator : MujocoSimulator
        Of extended/problem.yaml; model.xml has the declared parameters as fitted.
    content : dict
        Of diagnosis.json, which has those of effects.

    Returns
    -------
    (d,) array
    """
    values = np.array(simulator.nominal, dtype=float)
    fitted = content.get("parameters", {})
    for i, name in enumerate(simulator.space.names):
        if i >= len(simulator.bindings):
            values[i] = fitted.get(name, values[i])
    return values


class PlainRollout:
    """Predictions of windows by a robot that mujoco alone steps.

    Parameters
    ----------
    simulator : MujocoSimulator
        The extended one: its layout, and its effects on what is measured.
    values : (d,) array
        Its parameters.
    folder : Path
        Where model.xml, model.npz and model.py are.
    trusted : bool
        Whether model.py is run even if it is not what this version writes.

    Raises
    ------
    BadFile
        If a file is missing or broken, or model.py was changed and is not trusted.
    """

    def __init__(self, simulator: MujocoSimulator, values: Array, folder: Path, trusted: bool):
        self.simulator = simulator
        self.values = values
        self.path = folder / "model.py"
        self.active = active_effects(simulator, values)
        expected = format_plain_model(simulator, self.active)
        self.kept = run_plain_model(read_plain_model(self.path, expected, trusted), self.path)

    def predict(self, windows: Segments) -> Array:
        """Predict the signals at the end of windows.

        Parameters
        ----------
        windows : Segments
            W windows, of each of which the last step is compared.

        Returns
        -------
        (W, p) array
            NaN where the simulation diverges.
        """
        layout = self.simulator.layout
        speeds = start_speeds(windows, layout, self.simulator.control_step)
        out = np.empty((len(windows), len(self.simulator.signals)))
        for own, active in split_by_time_profile(self.active, windows, np.arange(len(windows))):
            starts = true_starts(windows.starts[own], speeds[own], layout, active)
            rows = self._ends(self._robot(active), windows, own, starts, active)
            out[own] = measured_signals(layout.coordinates(rows, windows.targets[own]), active)
        return out

    def _robot(self, active: ActiveEffects) -> Robot:
        """The robot as it was written, or as it was at the time of some windows."""
        robot: Robot = load_robot(self.kept, self.path)
        if all(instance.time_profile is None for instance, _ in self.active):
            return robot
        then = run_plain_model(format_plain_model(self.simulator, active), self.path)
        model = robot.given_model
        write_numbers(model, changed_numbers(model, self.simulator.model_of(self.values, active)))
        found: Robot = then.Robot(model, self.simulator.frame_skip, then.EFFECTS)
        return found

    def _ends(
        self, robot: Robot, windows: Segments, own: Ints, starts: Array, active: ActiveEffects
    ) -> Array:
        """(n, P) the observed columns at the ends of n windows, as late as the sensors are."""
        simulator = self.simulator
        data = windows.trajectories
        layout = simulator.layout
        delays = layout.by_column(total_delays(active, len(simulator.signals)))
        late = delays > 0
        is_late = bool(late.any())
        model = simulator.model
        states = layout.full_states(starts, model)
        commands: dict[int, Array] = {}
        out = np.empty((len(own), len(layout)))
        for i, (window, state) in enumerate(zip(own.tolist(), states, strict=True)):
            steps = windows.steps[window]
            run = int(data.trajectory[steps[0]])
            first, last = data.spans[run]
            if run not in commands:
                commands[run] = robot.commands(simulator.commands_of(data.actions[first:last]))
            begin = (steps[0] - first) * simulator.frame_skip
            held = commands[run][begin : begin + len(steps) * simulator.frame_skip]
            qpos, qvel, act = np.split(state[1:], [model.nq, model.nq + model.nv])
            recorded = simulator.recorded_past(windows, np.array([window]))
            robot.reset(qpos, qvel, act[: model.na], recorded)
            trace = [self._observed(robot)] if is_late else []
            for command in held:
                robot.advance(command)
                if is_late:
                    trace.append(self._observed(robot))
            out[i] = self._observed(robot)
            if is_late:
                past = np.stack(trace)[None, :, late]
                in_steps = delays[late] / physics_step(model)
                out[i, late] = delay_columns(past, in_steps)[0, -1]
        return out

    def _observed(self, robot: Robot) -> Array:
        """(P,) the observed columns of the present state; NaN where it has diverged."""
        layout = self.simulator.layout
        state = robot.state()
        if not (np.abs(state) < MAX_STATE).all():
            return np.full(len(layout), np.nan)
        sensors = robot.sensors() if layout.needs_sensors else None
        found: Array = layout.observe(state, sensors, self.simulator.model)
        return found
