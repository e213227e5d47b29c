"""Problems whose data hold positions alone: velocities estimated from them, with their errors as
noise.
"""

from dataclasses import replace

import numpy as np

from dropo.core.contracts.problem import Problem
from dropo.core.records.trajectories import Trajectories
from dropo.core.services.validation import Array
from dropo.logs.signals.velocities import ORDER, Velocities, estimate_velocities
from dropo.mjmodel.joints import all_joints
from dropo.simulators.mujoco.simulator import MujocoSimulator


def with_velocities(problem: Problem) -> Problem:
    """The problem with velocities of the hinges and slides whose positions alone are observed,
    estimated by a smoother, not causal.

    They are compared like any other signal, and their noise is carried into what starts from them.
    A problem that observes them all, starts its segments otherwise than from measurements, or has
    no motion to take them from, stays as it is.
    """
    simulator = problem.simulator
    if not isinstance(simulator, MujocoSimulator) or problem.reset != "transition":
        return problem
    places = unmeasured(simulator)
    sides = [side for side in (problem.trajectories, problem.held_out) if side is not None]
    if not places or not all(_continuous(side) for side in sides):
        return problem
    found = [_estimated(side, list(places), simulator.control_step) for side in sides]
    seen = simulator.observing(
        [*simulator.observation, *(f"qvel[{dof}]" for dof in places.values())]
    )
    names = [signal.name for signal in seen.signals[-len(places) :]]
    warning = (
        f"{', '.join(names)}: estimated from the positions before and after, since not measured."
    )
    return replace(
        problem,
        simulator=seen,
        trajectories=found[0][0],
        held_out=found[1][0] if len(found) > 1 else None,
        start_noise=True,
        epsilon=_with_theirs(problem, found[0][1]),
        warnings=(*problem.warnings, warning),
    )


def unmeasured(simulator: MujocoSimulator) -> dict[int, int]:
    """Column of each observed position -> its degree of freedom, of the joints whose velocity is
    not observed.
    """
    columns = [(column.field, column.place) for column in simulator.layout.columns]
    straight = [joint for joint in all_joints(simulator.model) if joint.kind in ("slide", "hinge")]
    pairs = [(("qpos", joint.qpos), ("qvel", joint.qvel)) for joint in straight]
    return {
        columns.index(position): velocity[1]
        for position, velocity in pairs
        if position in columns and velocity not in columns
    }


def _continuous(data: Trajectories) -> bool:
    """Whether every trajectory is a motion of enough rows, each transition ending where the next
    one begins.
    """
    goes_on = all(
        np.array_equal(data.next_observations[a : b - 1], data.observations[a + 1 : b])
        for a, b in data.spans
    )
    return goes_on and all(b - a >= 2 * ORDER for a, b in data.spans)


def _estimated(data: Trajectories, columns: list[int], step: float) -> tuple[Trajectories, Array]:
    """The data with the velocities behind their columns, and the variance of these."""
    motions = [_motion(data, a, b, columns, step) for a, b in data.spans]
    before, after = (
        np.concatenate([motion.velocities[part] for motion in motions])
        for part in (slice(None, -1), slice(1, None))
    )
    weights = np.array([b - a for a, b in data.spans])
    variance = np.average([motion.velocity_noise**2 for motion in motions], axis=0, weights=weights)
    rows = (
        np.concatenate([data.observations, before], axis=1),
        np.concatenate([data.next_observations, after], axis=1),
    )
    return replace(data, observations=rows[0], next_observations=rows[1]), variance


def _motion(data: Trajectories, a: int, b: int, columns: list[int], step: float) -> Velocities:
    positions = np.concatenate(
        [data.observations[a:b, columns], data.next_observations[b - 1 : b, columns]]
    )
    return estimate_velocities(step * np.arange(len(positions)), positions)


def _with_theirs(problem: Problem, variance: Array) -> Array | None:
    """The stated noise variances, where there are such, and those of the velocities."""
    if problem.epsilon is None:
        return None
    own = np.broadcast_to(np.asarray(problem.epsilon, dtype=float), len(problem.simulator.signals))
    return np.concatenate([own, variance])
