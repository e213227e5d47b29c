"""The forces of a model's actuators at its joints."""

from collections.abc import Sequence

import mujoco
import numpy as np

from dropo.core.contracts.effect import StepState
from dropo.core.services.validation import Array
from dropo.mjmodel.joints import Joint, actuators

FIXED = int(mujoco.mjtGain.mjGAIN_FIXED)
AFFINE = int(mujoco.mjtGain.mjGAIN_AFFINE)
NO_BIAS = int(mujoco.mjtBias.mjBIAS_NONE)
AFFINE_BIAS = int(mujoco.mjtBias.mjBIAS_AFFINE)
UNLIMITED = (-np.inf, np.inf)


def motors(model: mujoco.MjModel) -> list[tuple[Joint, list[int]]]:
    """List the slides and hinges driven by actuators whose force is known from the state.

    Parameters
    ----------
    model : MjModel
        The compiled model.

    Returns
    -------
    list of (Joint, list of int)
        Each joint with the ids of its actuators for which `motor_force` holds.
    """
    gain = np.isin(model.actuator_gaintype, (FIXED, AFFINE))
    bias = np.isin(model.actuator_biastype, (NO_BIAS, AFFINE_BIAS))
    found: dict[int, tuple[Joint, list[int]]] = {}
    for actuator in actuators(model):
        joint = actuator.joint
        if joint is None or joint.kind not in ("slide", "hinge"):
            continue
        if gain[actuator.id] and bias[actuator.id]:
            found.setdefault(joint.id, (joint, []))[1].append(actuator.id)
    return list(found.values())


def motor_force(state: StepState, joint: Joint, ids: Sequence[int]) -> Array:
    """Compute the generalised force of a joint's actuators as MuJoCo does: gear (gain u + bias).

    Parameters
    ----------
    state : StepState
        n simulations at one physics step.
    joint : Joint
        A slide or hinge.
    ids : sequence of int
        The actuators, of the kinds that `motors` finds.

    Returns
    -------
    (n,) array
        [N or N m]
    """
    model = state.model
    total = np.zeros(len(state.ctrl))
    for i in ids:
        gear = float(model.actuator_gear[i, 0])
        u = _input_of(state, i)
        position = gear * state.qpos[:, joint.qpos]
        velocity = gear * state.qvel[:, joint.qvel]
        terms = np.stack([np.ones(len(u)), position, velocity])
        gain = model.actuator_gainprm[i, :3]
        if model.actuator_gaintype[i] != AFFINE:
            gain = gain * (1, 0, 0)
        bias = model.actuator_biasprm[i, :3] * (model.actuator_biastype[i] == AFFINE_BIAS)
        limits = model.actuator_forcerange[i] if model.actuator_forcelimited[i] else UNLIMITED
        total += gear * np.clip((gain @ terms) * u + bias @ terms, *limits)
    return total


def _input_of(state: StepState, i: int) -> Array:
    """(n,) what actuator i multiplies by its gain: its last activation, or its clamped command."""
    model = state.model
    activation = int(model.actuator_actadr[i])
    if activation >= 0:
        return state.act[:, activation + int(model.actuator_actnum[i]) - 1]
    limits = model.actuator_ctrlrange[i] if model.actuator_ctrllimited[i] else UNLIMITED
    return np.clip(state.ctrl[:, i], *limits)


def torque_scale(model: mujoco.MjModel, joint: Joint) -> float:
    """Estimate the size of the forces at a slide or hinge.

    Parameters
    ----------
    model : MjModel
        The compiled model.
    joint : Joint
        A slide or hinge.

    Returns
    -------
    float
        The largest force of its actuators, at least the force that moves it by 10 m/s^2 or rad/s^2
        [N or N m].
    """
    sizes = [10.0 * float(model.dof_M0[joint.qvel])]
    for actuator in actuators(model):
        if actuator.joint is not None and actuator.joint.id == joint.id:
            gear = float(model.actuator_gear[actuator.id, 0])
            gain = abs(float(model.actuator_gainprm[actuator.id, 0]) * gear)
            sizes.append(gain * actuator.largest_command)
    return max(sizes)


def inverse_forces(
    model: mujoco.MjModel, positions: Array, velocities: Array, accelerations: Array
) -> Array:
    """Compute the generalised forces that a motion needs (mj_inverse).

    Parameters
    ----------
    model : MjModel
        The compiled model.
    positions : (n, nq) array
        Positions [m, rad].
    velocities, accelerations : (n, nv) arrays
        Velocities [m/s, rad/s] and accelerations [m/s^2, rad/s^2].

    Returns
    -------
    (n, nv) array
        [N or N m]
    """
    data = mujoco.MjData(model)
    forces = np.empty((len(positions), model.nv))
    for i in range(len(positions)):
        data.qpos[:] = positions[i]
        data.qvel[:] = velocities[i]
        data.qacc[:] = accelerations[i]
        mujoco.mj_inverse(model, data)
        forces[i] = data.qfrc_inverse
    return forces
