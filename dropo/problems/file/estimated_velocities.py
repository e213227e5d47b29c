"""Problems whose data hold positions alone: velocities estimated from them, with their errors."""

from dataclasses import replace

import numpy as np

from dropo.core.contracts.problem import Problem
from dropo.core.records.trajectories import Trajectories
from dropo.core.services.validation import Array
from dropo.logs.signals.velocities import ORDER, Velocities, estimate_velocities
from dropo.mjmodel.joints import all_joints
from dropo.simulators.mujoco.simulator import MujocoSimulator


def with_velocities(problem: Problem) -> Problem:
    """Add velocities of the hinges and slides whose positions alone are observed.

    Parameters
    ----------
    problem : Problem
        Any problem.

    Returns
    -------
    Problem
        With velocities estimated by a smoother, which is not causal. They are compared like any
        other signal, and their noise is carried into what starts from them. The same problem where
        all are observed, segments start otherwise than from measurements, or there is no motion to
        take velocities from.
    """
    simulator = problem.simulator
    if not isinstance(simulator, MujocoSimulator) or problem.reset != "transition":
        return problem
    unmeasured = _unmeasured_velocities(simulator)
    held_out = problem.held_out
    parts = [problem.trajectories] if held_out is None else [problem.trajectories, held_out]
    if not unmeasured or not all(_is_continuous(part) for part in parts):
        return problem
    columns = list(unmeasured)
    step = simulator.control_step
    trajectories, variance = _add_velocities(problem.trajectories, columns, step)
    if held_out is not None:
        held_out, _ = _add_velocities(held_out, columns, step)
    items = [f"qvel[{dof}]" for dof in unmeasured.values()]
    observing = simulator.observing([*simulator.observation, *items])
    names = [signal.name for signal in observing.signals[-len(items) :]]
    warning = (
        f"{', '.join(names)}: estimated from the positions before and after, since not measured."
    )
    return replace(
        problem,
        simulator=observing,
        trajectories=trajectories,
        held_out=held_out,
        start_noise=True,
        epsilon=_all_variances(problem, variance),
        warnings=(*problem.warnings, warning),
        estimated={
            **problem.estimated,
            **dict(zip(names, np.sqrt(variance).tolist(), strict=True)),
        },
    )


def _unmeasured_velocities(simulator: MujocoSimulator) -> dict[int, int]:
    """By column of an observed position, the degree of freedom whose velocity is not observed."""
    columns = [(column.field, column.place) for column in simulator.layout.columns]
    found = {}
    for joint in all_joints(simulator.model):
        position = ("qpos", joint.qpos)
        observed = position in columns and ("qvel", joint.qvel) not in columns
        if joint.kind in ("slide", "hinge") and observed:
            found[columns.index(position)] = joint.qvel
    return found


def _is_continuous(data: Trajectories) -> bool:
    """Whether each trajectory has enough rows, of which each ends where the next one begins."""
    for start, stop in data.spans:
        if stop - start < 2 * ORDER:
            return False
        ends = data.next_observations[start : stop - 1]
        if not np.array_equal(ends, data.observations[start + 1 : stop]):
            return False
    return True


def _add_velocities(
    data: Trajectories, columns: list[int], step: float
) -> tuple[Trajectories, Array]:
    """The data with the velocities of some columns behind the others, and the variance of these."""
    motions = [_smooth(data, start, stop, columns, step) for start, stop in data.spans]
    before = np.concatenate([motion.velocities[:-1] for motion in motions])
    after = np.concatenate([motion.velocities[1:] for motion in motions])
    observations = np.concatenate([data.observations, before], axis=1)
    following = np.concatenate([data.next_observations, after], axis=1)
    weights = np.array([stop - start for start, stop in data.spans])
    variances = [motion.velocity_noise**2 for motion in motions]
    variance = np.average(variances, axis=0, weights=weights)
    return replace(data, observations=observations, next_observations=following), variance


def _smooth(
    data: Trajectories, start: int, stop: int, columns: list[int], step: float
) -> Velocities:
    """The motion of some columns in one trajectory."""
    last = data.next_observations[stop - 1 : stop, columns]
    positions = np.concatenate([data.observations[start:stop, columns], last])
    return estimate_velocities(step * np.arange(len(positions)), positions)


def _all_variances(problem: Problem, variance: Array) -> Array | None:
    """The stated noise variances, where there are such, and those of the velocities."""
    if problem.epsilon is None:
        return None
    own = np.broadcast_to(np.asarray(problem.epsilon, dtype=float), len(problem.simulator.signals))
    return np.concatenate([own, variance])
