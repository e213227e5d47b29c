"""Actions where only motion was recorded: by inverse dynamics, or by taking the robot's own
controllers as ideal.
"""

import copy
from dataclasses import dataclass, replace

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from dropo.core.contracts.simulator import describe_failures
from dropo.core.records.trajectories import Trajectories
from dropo.core.services.errors import Incompatible, SimulationFailed
from dropo.core.services.validation import Array, float_array
from dropo.simulators.mujoco.simulator import MujocoSimulator

ROUNDS = 20  # corrections by what the simulator itself does with the actions found


@dataclass(frozen=True, eq=False)
class InferredActions:
    """The trajectories with the actions (N, q) that were inferred.

    unexplained: (N, nv) the generalised force [N, N m] that the motion needs and that no action
    gives: the model is wrong there, something pushed, or the command range is too small. 0 where
    controllers are taken as ideal.
    """

    trajectories: Trajectories
    unexplained: Array


def by_inverse_dynamics(
    simulator: MujocoSimulator, trajectories: Trajectories, values: ArrayLike | None = None
) -> InferredActions:
    """The actions under which the model, with these parameter values (d,), moves as was measured;
    whole states must be observed.

    The force that each transition's mean acceleration needs half way through it (mj_inverse),
    shared out over the actuators by least squares, then corrected by what the simulator makes of
    it, so that a command that is held for several steps is found too. Actions stay within the
    control ranges; those in the given trajectories do not count.
    """
    nominal = np.zeros(len(simulator.space)) if simulator.nominal is None else simulator.nominal
    value = float_array(
        "values",
        nominal if values is None else values,
        (len(simulator.space),),
        "by_inverse_dynamics",
    )
    before = _states(simulator, trajectories.observations)
    after = _states(simulator, trajectories.next_observations)
    needs, masses, shares, idle = _needed(simulator, value, before, after)
    columns = simulator.controls
    low, high = _ranges(simulator.model)
    inverse = np.linalg.pinv(shares[:, :, columns])
    actions = np.clip(np.einsum("nqv,nv->nq", inverse, needs - idle), low[columns], high[columns])

    def left(actions: Array) -> tuple[Array, Array]:
        """The force that is missing with these actions, (N, nv), and the actions that would give
        it.
        """
        gap = _gap(simulator, value, replace(trajectories, actions=actions))
        force = np.einsum("nvw,nw->nv", masses, gap)
        return force, np.einsum("nqv,nv->nq", inverse, force)

    rest, change = left(actions)
    share = np.ones(len(actions))
    for _ in range(ROUNDS):
        tried = np.clip(actions + share[:, None] * change, low[columns], high[columns])
        now_rest, now_change = left(tried)
        better = np.linalg.norm(now_change, axis=1) < np.linalg.norm(change, axis=1)
        actions, rest, change = (
            np.where(better[:, None], *pair)
            for pair in ((tried, actions), (now_rest, rest), (now_change, change))
        )
        share = np.where(better, share, share / 2)
    return InferredActions(replace(trajectories, actions=actions), rest)


def by_ideal_controllers(simulator: MujocoSimulator, trajectories: Trajectories) -> InferredActions:
    """The actions of position and velocity actuators whose set point is taken as reached at the end
    of each step (thesis, chapter 5).
    """
    model = simulator.model
    data = mujoco.MjData(simulator.model)
    after = _states(simulator, trajectories.next_observations)
    kinds = [(int(i), controlled(model, int(i))) for i in simulator.controls]
    none = [model.actuator(i).name or f"ctrl[{i}]" for i, kind in kinds if kind is None]
    if none:
        raise Incompatible(
            f"The actuator {none[0]!r} is no position or velocity controller, so its set "
            "point is not what was reached."
            " Use by_inverse_dynamics (`--controllers modelled`)."
        )
    actions = np.empty((len(after), len(kinds)))
    for row, state in enumerate(after):
        data.qpos, data.qvel = np.split(state, [model.nq])
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_fwdVelocity(model, data)
        actions[row] = [
            (data.actuator_length if kind == "position" else data.actuator_velocity)[i]
            for i, kind in kinds
        ]
    return InferredActions(replace(trajectories, actions=actions), np.zeros((len(after), model.nv)))


def controlled(model: mujoco.MjModel, actuator: int) -> str | None:
    """ "position" or "velocity" where the actuator pulls its transmission to the command, else None."""
    gain = model.actuator_gainprm[actuator]
    bias = model.actuator_biasprm[actuator]
    plain = model.actuator_gaintype[actuator] == mujoco.mjtGain.mjGAIN_FIXED and gain[0] > 0
    if (
        not plain
        or model.actuator_biastype[actuator] != mujoco.mjtBias.mjBIAS_AFFINE
        or bias[0] != 0
    ):
        return None
    return (
        "position"
        if bias[1] == -gain[0]
        else "velocity"
        if bias[1] == 0 and bias[2] == -gain[0]
        else None
    )


def _states(simulator: MujocoSimulator, rows: Array) -> Array:
    """(N, nq + nv) whole states of observation rows."""
    model = simulator.model
    layout = simulator.layout
    seen = {(column.field, column.place) for column in layout.columns}
    missing = [
        f"{f}[{i}]"
        for f, n in (("qpos", model.nq), ("qvel", model.nv))
        for i in range(n)
        if (f, i) not in seen
    ]
    if missing:
        raise Incompatible(
            f"Actions are inferred from whole states, and {missing[0]} is not observed. "
            "Estimate velocities first, or"
            " name a model without that joint."
        )
    if model.na:
        raise Incompatible(
            "The model's actuators have states of their own (activations), which the "
            "motion does not tell."
        )
    states = np.zeros((len(rows), mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS)))
    layout.write_start(states, rows, np.ones(len(layout), dtype=bool), model)
    return states[:, 1 : 1 + model.nq + model.nv]


def _needed(
    simulator: MujocoSimulator, value: Array, before: Array, after: Array
) -> tuple[Array, Array, Array, Array]:
    """At the middle of each transition: the force needed (N, nv), the mass matrix with damping (N,
    nv, nv), the force of a unit of each command (N, nv, nu), and what the actuators give without
    one (N, nv).
    """
    model = copy.copy(simulator.model)
    for binding, number in zip(simulator.bindings, value[: len(simulator.bindings)], strict=True):
        binding.set(model, float(number))
    data = mujoco.MjData(model)
    nq = model.nq
    nv = model.nv
    step = simulator.control_step
    mujoco.mj_setConst(model, data)
    needs = np.empty((len(before), nv))
    masses = np.empty((len(before), nv, nv))
    shares = np.empty((len(before), nv, model.nu))
    idle = np.empty((len(before), nv))
    moved = np.empty(nv)
    step_state = np.zeros((model.nu, nv))
    affine = model.actuator_biastype == mujoco.mjtBias.mjBIAS_AFFINE
    stiffness = np.where(affine, -model.actuator_biasprm[:, 1], 0.0)
    damping = np.where(affine, -model.actuator_biasprm[:, 2], 0.0)
    resistance = stiffness * step**2 / 6 + damping * step / 2
    for row, (start, end) in enumerate(zip(before, after, strict=True)):
        data.qpos = start[:nq]
        mujoco.mj_differentiatePos(model, moved, step, start[:nq], end[:nq])
        mujoco.mj_integratePos(model, data.qpos, moved, step / 2)
        data.qvel = (start[nq:] + end[nq:]) / 2
        data.qacc = (end[nq:] - start[nq:]) / step
        mujoco.mj_inverse(model, data)
        needs[row] = data.qfrc_inverse
        mujoco.mj_fullM(model, data, masses[row])
        masses[row] += (
            np.diag(model.dof_damping) * step / 2
        )  # over a step, damping resists as so much mass
        mujoco.mju_sparse2dense(
            step_state,
            data.actuator_moment,
            data.moment_rownnz,
            data.moment_rowadr,
            data.moment_colind,
        )
        masses[row] += step_state.T @ (resistance[:, None] * step_state)  # and so do controllers
        gain, bias = _distributions(model, data.actuator_length, data.actuator_velocity)
        shares[row], idle[row] = step_state.T * gain, step_state.T @ bias
    return needs, masses, shares, idle


def _distributions(model: mujoco.MjModel, length: Array, velocity: Array) -> tuple[Array, Array]:
    """(nu,) the force of a unit of each command, and without one."""
    state = np.stack([np.ones(model.nu), length, velocity], axis=1)
    affine = (
        (mujoco.mjtGain.mjGAIN_FIXED, mujoco.mjtGain.mjGAIN_AFFINE),
        (mujoco.mjtBias.mjBIAS_NONE, mujoco.mjtBias.mjBIAS_AFFINE),
    )
    for name, types, valid in (
        ("gain", model.actuator_gaintype, affine[0]),
        ("bias", model.actuator_biastype, affine[1]),
    ):
        if not np.isin(types, valid).all():
            raise Incompatible(
                f"Actions are inferred for actuators of constant or affine {name}, and one "
                "has another: a muscle, say."
            )
    varying = (model.actuator_gaintype == mujoco.mjtGain.mjGAIN_AFFINE)[:, None] * np.array(
        [0, 1, 1]
    ) + np.array([1, 0, 0])
    biased = (model.actuator_biastype == mujoco.mjtBias.mjBIAS_AFFINE)[:, None]
    gain = np.sum(model.actuator_gainprm[:, :3] * varying * state, axis=1)
    return gain, np.sum(model.actuator_biasprm[:, :3] * biased * state, axis=1)


def _ranges(model: mujoco.MjModel) -> tuple[Array, Array]:
    limited = np.asarray(model.actuator_ctrllimited, dtype=bool)
    low, high = model.actuator_ctrlrange.T
    return np.where(limited, low, -np.inf), np.where(limited, high, np.inf)


def _gap(simulator: MujocoSimulator, value: Array, trajectories: Trajectories) -> Array:
    """(N, nv) the measured accelerations less the simulated ones, mean over each transition."""
    segments = trajectories.segments(1)
    names = [signal.name for signal in simulator.signals]
    predicted = simulator.predict(value[None], segments)
    if not np.isfinite(predicted).all():
        raise SimulationFailed(
            describe_failures(
                predicted[0], value[None].repeat(len(predicted[0]), axis=0), simulator.space
            )
        )
    layout = simulator.layout
    gap = np.zeros((len(trajectories), simulator.model.nv))
    error = simulator.targets(segments) - predicted[0]
    for column, name in zip(layout.columns, layout.names, strict=True):
        if column.field == "qvel":
            gap[:, column.place] = error[:, names.index(name)] / simulator.control_step
    return gap
