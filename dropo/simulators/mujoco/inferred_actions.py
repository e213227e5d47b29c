"""Actions where only motion was recorded: by inverse dynamics, or for ideal controllers."""

import copy
from dataclasses import dataclass, replace

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from dropo.core.contracts.simulator import describe_failures
from dropo.core.records.trajectories import Trajectories
from dropo.core.services.errors import Incompatible, SimulationFailed
from dropo.core.services.validation import Array, float_array
from dropo.simulators.mujoco.layers import control_ranges
from dropo.simulators.mujoco.simulator import MujocoSimulator


@dataclass(frozen=True)
class InverseDynamicsSettings:
    """How actions are inferred by inverse dynamics.

    Attributes
    ----------
    iterations : int
        Corrections by what the simulator itself does with the actions found.
    """

    iterations: int = 20


@dataclass(frozen=True, eq=False)
class InferredActions:
    """Trajectories with the actions that were inferred.

    Attributes
    ----------
    trajectories : Trajectories
        The given ones, with the inferred actions (N, q).
    unexplained : (N, nv) array
        The generalised force that the motion needs and that no action gives [N, N m]: the model is
        wrong there, an external force acted, or the command range is too small. 0 where
        controllers are taken as ideal.
    """

    trajectories: Trajectories
    unexplained: Array


@dataclass(frozen=True, eq=False)
class _Balance:
    """Forces at the middle of each of N transitions."""

    needed: Array  # (N, nv) by the measured motion
    masses: Array  # (N, nv, nv) mass matrix; damping over a step counts as mass
    per_command: Array  # (N, nv, nu) given by a unit of each command
    without_command: Array  # (N, nv) given by the actuators without a command


def by_inverse_dynamics(
    simulator: MujocoSimulator,
    trajectories: Trajectories,
    values: ArrayLike | None = None,
    settings: InverseDynamicsSettings | None = None,
) -> InferredActions:
    """Infer the actions under which the model moves as was measured.

    Parameters
    ----------
    simulator : MujocoSimulator
        The model; whole states must be observed.
    trajectories : Trajectories
        N transitions, whose actions are not used.
    values : (d,) array_like, optional
        The simulator's parameters; by default their nominal values.
    settings : InverseDynamicsSettings, optional
        The number of corrections.

    Returns
    -------
    InferredActions
        Actions stay within the control ranges.

    Raises
    ------
    BadArgument
        If the values have another shape or are not finite.
    Incompatible
        If a position or velocity is not observed, or an actuator has a state of its own or another
        gain or bias than a constant or affine one.
    SimulationFailed
        If a simulation under the actions found diverges.

    Notes
    -----
    The force that the mean acceleration of each transition needs half way through it (mj_inverse)
    is distributed over the actuators by least squares. Then it is corrected by what the simulator
    makes of it, so that a command that is held for several physics steps is found too; a
    transition's correction is halved where it does not help.
    """
    chosen = settings or InverseDynamicsSettings()
    nominal = np.zeros(len(simulator.space)) if simulator.nominal is None else simulator.nominal
    given = nominal if values is None else values
    value = float_array("values", given, (len(simulator.space),), "by_inverse_dynamics")
    before = _states(simulator, trajectories.observations)
    after = _states(simulator, trajectories.next_observations)
    balance = _force_balance(simulator, value, before, after)
    columns = simulator.controls
    ranges = control_ranges(simulator.model)
    low = ranges[0][columns]
    high = ranges[1][columns]
    inverse = np.linalg.pinv(balance.per_command[:, :, columns])

    def actions_for(forces: Array) -> Array:
        """(N, q) the actions that give generalised forces (N, nv)."""
        return np.asarray(np.einsum("nqv,nv->nq", inverse, forces))

    def missing_force(actions: Array) -> Array:
        """(N, nv) the force that is missing with these actions, as the simulator shows it."""
        gap = _acceleration_gap(simulator, value, replace(trajectories, actions=actions))
        return np.asarray(np.einsum("nvw,nw->nv", balance.masses, gap))

    actions = np.clip(actions_for(balance.needed - balance.without_command), low, high)
    missing = missing_force(actions)
    change = actions_for(missing)
    fraction = np.ones(len(actions))
    for _ in range(chosen.iterations):
        tried = np.clip(actions + fraction[:, None] * change, low, high)
        tried_missing = missing_force(tried)
        tried_change = actions_for(tried_missing)
        better = np.linalg.norm(tried_change, axis=1) < np.linalg.norm(change, axis=1)
        actions = np.where(better[:, None], tried, actions)
        missing = np.where(better[:, None], tried_missing, missing)
        change = np.where(better[:, None], tried_change, change)
        fraction = np.where(better, fraction, fraction / 2)
    return InferredActions(replace(trajectories, actions=actions), missing)


def by_ideal_controllers(simulator: MujocoSimulator, trajectories: Trajectories) -> InferredActions:
    """Infer the actions of controllers whose set point is reached at the end of each step.

    Parameters
    ----------
    simulator : MujocoSimulator
        A model with position and velocity actuators; whole states must be observed.
    trajectories : Trajectories
        N transitions, whose actions are not used.

    Returns
    -------
    InferredActions

    Raises
    ------
    Incompatible
        If an actuator is no position or velocity controller, a position or velocity is not
        observed, or an actuator has a state of its own.

    References
    ----------
    Thesis, chapter 5.
    """
    model = simulator.model
    data = mujoco.MjData(simulator.model)
    after = _states(simulator, trajectories.next_observations)
    kinds = [(int(i), _controller_kind(model, int(i))) for i in simulator.controls]
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
        for column, (i, kind) in enumerate(kinds):
            reached = data.actuator_length if kind == "position" else data.actuator_velocity
            actions[row, column] = reached[i]
    return InferredActions(replace(trajectories, actions=actions), np.zeros((len(after), model.nv)))


def _controller_kind(model: mujoco.MjModel, actuator: int) -> str | None:
    """The kind "position" or "velocity" of a controller; None of another actuator."""
    gain = model.actuator_gainprm[actuator]
    bias = model.actuator_biasprm[actuator]
    fixed_gain = model.actuator_gaintype[actuator] == mujoco.mjtGain.mjGAIN_FIXED and gain[0] > 0
    affine_bias = model.actuator_biastype[actuator] == mujoco.mjtBias.mjBIAS_AFFINE
    if not fixed_gain or not affine_bias or bias[0] != 0:
        return None
    if bias[1] == -gain[0]:
        return "position"
    if bias[1] == 0 and bias[2] == -gain[0]:
        return "velocity"
    return None


def _states(simulator: MujocoSimulator, rows: Array) -> Array:
    """(N, nq + nv) whole states of observation rows."""
    model = simulator.model
    layout = simulator.layout
    observed = {(column.field, column.place) for column in layout.columns}
    whole = [("qpos", i) for i in range(model.nq)] + [("qvel", i) for i in range(model.nv)]
    missing = [f"{field}[{i}]" for field, i in whole if (field, i) not in observed]
    if missing:
        raise Incompatible(
            f"Actions are inferred from whole states, and {missing[0]} is not observed. "
            "Estimate velocities first, or name a model without that joint."
        )
    if model.na:
        raise Incompatible(
            "The model's actuators have states of their own (activations), which the "
            "motion does not tell."
        )
    states = np.zeros((len(rows), mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS)))
    layout.write_start(states, rows, np.ones(len(layout), dtype=bool), model)
    return states[:, 1 : 1 + model.nq + model.nv]


def _force_balance(
    simulator: MujocoSimulator, value: Array, before: Array, after: Array
) -> _Balance:
    """The forces at the middle of each transition between whole states (N, nq + nv)."""
    model = copy.copy(simulator.simulated)
    for binding, number in zip(simulator.bindings, value[: len(simulator.bindings)], strict=True):
        binding.set(model, float(number))
    data = mujoco.MjData(model)
    mujoco.mj_setConst(model, data)
    nq = model.nq
    nv = model.nv
    step = simulator.control_step
    balance = _Balance(
        np.empty((len(before), nv)),
        np.empty((len(before), nv, nv)),
        np.empty((len(before), nv, model.nu)),
        np.empty((len(before), nv)),
    )
    # over a step, the feedback of controllers resists acceleration as so much mass
    affine = model.actuator_biastype == mujoco.mjtBias.mjBIAS_AFFINE
    stiffness = np.where(affine, -model.actuator_biasprm[:, 1], 0.0)
    damping = np.where(affine, -model.actuator_biasprm[:, 2], 0.0)
    resistance = stiffness * step**2 / 6 + damping * step / 2
    velocity = np.empty(nv)
    moment = np.zeros((model.nu, nv))
    for row, (start, end) in enumerate(zip(before, after, strict=True)):
        # the state half way, with the mean acceleration
        data.qpos = start[:nq]
        mujoco.mj_differentiatePos(model, velocity, step, start[:nq], end[:nq])
        mujoco.mj_integratePos(model, data.qpos, velocity, step / 2)
        data.qvel = (start[nq:] + end[nq:]) / 2
        data.qacc = (end[nq:] - start[nq:]) / step
        mujoco.mj_inverse(model, data)
        balance.needed[row] = data.qfrc_inverse
        # the mass matrix, with what resists as so much mass over a step
        mujoco.mj_fullM(model, data, balance.masses[row])
        balance.masses[row] += np.diag(model.dof_damping) * step / 2
        mujoco.mju_sparse2dense(
            moment,
            data.actuator_moment,
            data.moment_rownnz,
            data.moment_rowadr,
            data.moment_colind,
        )
        balance.masses[row] += moment.T @ (resistance[:, None] * moment)
        # what the actuators give
        gain, bias = _gains_and_biases(model, data.actuator_length, data.actuator_velocity)
        balance.per_command[row] = moment.T * gain
        balance.without_command[row] = moment.T @ bias
    return balance


def _gains_and_biases(model: mujoco.MjModel, length: Array, velocity: Array) -> tuple[Array, Array]:
    """(nu,) the force of a unit of each command, and the force without one."""
    gains = (mujoco.mjtGain.mjGAIN_FIXED, mujoco.mjtGain.mjGAIN_AFFINE)
    biases = (mujoco.mjtBias.mjBIAS_NONE, mujoco.mjtBias.mjBIAS_AFFINE)
    _require_affine("gain", np.isin(model.actuator_gaintype, gains))
    _require_affine("bias", np.isin(model.actuator_biastype, biases))
    terms = np.stack([np.ones(model.nu), length, velocity], axis=1)
    affine_gain = (model.actuator_gaintype == mujoco.mjtGain.mjGAIN_AFFINE)[:, None]
    affine_bias = (model.actuator_biastype == mujoco.mjtBias.mjBIAS_AFFINE)[:, None]
    used = affine_gain * np.array([0, 1, 1]) + np.array([1, 0, 0])  # of the gain's three terms
    gain = np.sum(model.actuator_gainprm[:, :3] * used * terms, axis=1)
    bias = np.sum(model.actuator_biasprm[:, :3] * affine_bias * terms, axis=1)
    return gain, bias


def _require_affine(name: str, valid: NDArray[np.bool_]) -> None:
    """Refuses actuators whose gain or bias is not constant or affine."""
    if not valid.all():
        raise Incompatible(
            f"Actions are inferred for actuators of constant or affine {name}, and one "
            "has another: a muscle, say."
        )


def _acceleration_gap(
    simulator: MujocoSimulator, value: Array, trajectories: Trajectories
) -> Array:
    """(N, nv) the measured accelerations less the simulated ones, mean over each transition."""
    segments = trajectories.segments(1)
    names = [signal.name for signal in simulator.signals]
    predicted = simulator.predict(value[None], segments)[0]
    if not np.isfinite(predicted).all():
        values = value[None].repeat(len(predicted), axis=0)
        raise SimulationFailed(describe_failures(predicted, values, simulator.space))
    layout = simulator.layout
    gap = np.zeros((len(trajectories), simulator.model.nv))
    error = simulator.targets(segments) - predicted
    for column, name in zip(layout.columns, layout.names, strict=True):
        if column.field == "qvel":
            gap[:, column.place] = error[:, names.index(name)] / simulator.control_step
    return gap
