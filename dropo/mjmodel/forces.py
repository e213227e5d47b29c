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


def motors(model: mujoco.MjModel) -> list[tuple[Joint, list[int]]]:
    """The slides and hinges that are driven by actuators whose force is known from the state
    (`motor_force`), and these.
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


def motor_force(moment: StepState, joint: Joint, ids: Sequence[int]) -> Array:
    """The generalised force of a joint's actuators: gear (gain u + bias), as MuJoCo computes it.

    Parameters
    ----------
    moment : Moment
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
    model = moment.model
    total = np.zeros(len(moment.ctrl))
    for i in ids:
        gear = float(model.actuator_gear[i, 0])
        state = int(model.actuator_actadr[i])
        if state < 0:
            limit = (
                model.actuator_ctrlrange[i] if model.actuator_ctrllimited[i] else (-np.inf, np.inf)
            )
            u = np.clip(moment.ctrl[:, i], *limit)
        else:
            u = moment.act[:, state + int(model.actuator_actnum[i]) - 1]
        position = gear * moment.qpos[:, joint.qpos]
        velocity = gear * moment.qvel[:, joint.qvel]
        terms = np.stack([np.ones(len(u)), position, velocity])
        gain = model.actuator_gainprm[i, :3]
        if model.actuator_gaintype[i] != AFFINE:
            gain = gain * (1, 0, 0)
        bias = model.actuator_biasprm[i, :3] * (model.actuator_biastype[i] == AFFINE_BIAS)
        most = model.actuator_forcerange[i] if model.actuator_forcelimited[i] else (-np.inf, np.inf)
        total += gear * np.clip((gain @ terms) * u + bias @ terms, *most)
    return total


def torque_scale(model: mujoco.MjModel, joint: Joint) -> float:
    """The size of forces at a slide or hinge: the largest that its actuators give, at least what
    moves it by 10 m/s^2 (rad/s^2).
    """
    found = [10.0 * float(model.dof_M0[joint.qvel])]
    for actuator in actuators(model):
        if actuator.joint is not None and actuator.joint.id == joint.id:
            gear = float(model.actuator_gear[actuator.id, 0])
            gain = abs(float(model.actuator_gainprm[actuator.id, 0]) * gear)
            found.append(gain * actuator.largest_command)
    return max(found)


def inverse_forces(
    model: mujoco.MjModel, positions: Array, velocities: Array, accelerations: Array
) -> Array:
    """The generalised forces that a motion needs (mj_inverse).

    Parameters
    ----------
    model : MjModel
        The compiled model.
    positions : (n, nq) array
    velocities, accelerations : (n, nv) arrays

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
