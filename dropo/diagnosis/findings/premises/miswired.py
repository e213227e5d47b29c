"""The diagnosis of a log whose columns are not what the model takes them for: it ends there."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dropo.core.contracts.problem import Problem
from dropo.core.records.trajectories import Trajectories
from dropo.core.services.validation import Array
from dropo.diagnosis.parts import Cause, Estimate, Remaining
from dropo.diagnosis.regression.readings import Reading
from dropo.diagnosis.regression.result import WiringFault
from dropo.diagnosis.regression.wiring import Wiring
from dropo.diagnosis.result import Diagnosis, HeldOut
from dropo.diagnosis.search.library import robot_of
from dropo.mjmodel.joints import joints
from dropo.mjmodel.robot_simulator import RobotSimulator


def miswired(problem: Problem, wiring: Wiring) -> Diagnosis:
    """Say what is wrong with the columns of a log; nothing is simulated.

    Parameters
    ----------
    problem : Problem
        The robot, and its data as they are read.
    wiring : Wiring
        With faults that the forces of the log show.

    Returns
    -------
    Diagnosis
        Each fault is a cause. Its problem has the columns as they are to be read; likelihoods are
        those of forces, but for a constant [nats per row of the equation of motion].
    """
    causes = tuple(_cause(fault) for fault in wiring.faults if fault.evidence is not None)
    space = problem.space
    nominal = space.clip(np.asarray(problem.simulator.nominal, dtype=float))
    return Diagnosis(
        name=problem.name,
        verdict="partly",
        causes=causes,
        suspects=(),
        baseline=HeldOut(0.0, ()),
        extended=HeldOut(sum(cause.held_out_gain for cause in causes), ()),
        remaining=Remaining(False, np.nan, (), {}),
        problem=read_right(problem, wiring.reading) if wiring.reading else problem,
        noise={},
        window_steps=0,
        faults=wiring.faults,
        parameters=dict(zip(space.names, nominal.tolist(), strict=True)),
        warnings=problem.warnings,
    )


def _cause(fault: WiringFault) -> Cause:
    """A fault as a cause."""
    evidence = fault.evidence
    if evidence is None:
        raise AssertionError("a fault without forces is a warning")
    estimate = {}
    if fault.factor is not None:
        estimate["factor"] = Estimate(fault.factor, np.nan, "1", 1.0)
    return Cause(
        effect=fault.kind,
        target=fault.target,
        variant=fault.of,
        estimate=estimate,
        p_value=evidence.p_value,
        held_out_gain=evidence.gain,
        held_out_gain_se=evidence.gain_se,
        rmse_before=evidence.before,
        rmse_after=evidence.after,
        to_change=fault.to_change,
    )


def read_right(problem: Problem, reading: Reading) -> Problem:
    """Return a problem whose data have their columns as a reading says.

    Parameters
    ----------
    problem : Problem
        A robot and its data.
    reading : Reading
        How its columns are to be read.

    Returns
    -------
    Problem
        Velocities that follow the positions as they were logged are changed with them.
    """
    simulator = robot_of(problem)
    angles = _angle_changes(simulator, problem.trajectories, reading)
    place = {int(control): i for i, control in enumerate(simulator.controls.tolist())}
    commands = [
        (place[i], place[source], scale)
        for i, (source, scale) in enumerate(
            zip(reading.commands, reading.command_scales, strict=True)
        )
        if i in place and source in place
    ]

    def changed(data: Trajectories | None) -> Trajectories | None:
        if data is None:
            return None
        return replace(
            data,
            observations=_moved(data.observations, angles),
            next_observations=_moved(data.next_observations, angles),
            actions=_moved(data.actions, commands),
        )

    return replace(
        problem,
        trajectories=changed(problem.trajectories) or problem.trajectories,
        held_out=changed(problem.held_out),
        everything=changed(problem.everything),
    )


def _moved(rows: Array, changes: Sequence[tuple[int, int, float]]) -> Array:
    """Rows with columns that are others, times a factor: (column, its source, the factor)."""
    out = rows.copy()
    for column, source, factor in changes:
        out[:, column] = factor * rows[:, source]
    return out


def _angle_changes(
    simulator: RobotSimulator, data: Trajectories, reading: Reading
) -> list[tuple[int, int, float]]:
    """What becomes of the columns of positions and velocities."""
    column = simulator.layout.column_places
    own = {joint.qvel: joint for joint in joints(simulator.model)}
    found = []
    for dof, (source, scale) in enumerate(zip(reading.angles, reading.angle_scales, strict=True)):
        if dof not in own or (source, scale) == (dof, 1.0):
            continue
        here, there = own[dof], own[source]
        found.append((column["qpos", here.qpos], column["qpos", there.qpos], scale))
        rates = ("qvel", here.qvel), ("qvel", there.qvel)
        if not all(rate in column for rate in rates):
            continue
        if _follows(data, column["qpos", there.qpos], column[rates[1]]):
            found.append((column[rates[0]], column[rates[1]], scale))
    return found


def _follows(data: Trajectories, position: int, velocity: int) -> bool:
    """Whether a column of velocities has the sign of what a column of positions does."""
    change = data.next_observations[:, position] - data.observations[:, position]
    return bool(change @ data.observations[:, velocity] > 0)
