"""Joints that stay where they are, in a model that keeps its positions and velocities."""

from collections.abc import Mapping

import mujoco
import numpy as np

ROTOR = 1e6
"""The rotor inertia of a joint that no force moves [kg m^2, kg]."""
CLOSE = 1e-12
"""A joint this near to the model's own pose is in it [rad, m]."""


def can_hold(model: mujoco.MjModel, joint: int, value: float) -> bool:
    """Tell whether `hold_joints` can hold a joint.

    Parameters
    ----------
    model : MjModel
        Any.
    joint : int
        The number of a hinge or slide.
    value : float
        Where it stays [rad, m].

    Returns
    -------
    bool
        Away from the model's own pose it must be the first joint of its body.
    """
    first = int(model.body_jntadr[model.jnt_bodyid[joint]]) == joint
    return first or abs(value - float(model.qpos0[model.jnt_qposadr[joint]])) < CLOSE


def hold_joints(values: Mapping[int, float], model: mujoco.MjModel) -> None:
    """Hold hinges and slides.

    Parameters
    ----------
    values : mapping of int to float
        By the joints' numbers, where each stays [rad, m].
    model : MjModel
        Changed in place: their rotors are so heavy that no force moves them, and its own pose
        (qpos0) has them there, by bodies that are turned or shifted as far.
    """
    quat = np.empty(4)
    whole = np.empty(4)
    before = np.empty(3)
    after = np.empty(3)
    for joint, value in values.items():
        place = int(model.jnt_qposadr[joint])
        change = value - float(model.qpos0[place])
        body = int(model.jnt_bodyid[joint])
        own = model.body_quat[body].copy()
        model.dof_armature[int(model.jnt_dofadr[joint])] = ROTOR
        if abs(change) < CLOSE:
            continue
        if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE:
            mujoco.mju_rotVecQuat(after, model.jnt_axis[joint], own)
            model.body_pos[body] += change * after
        else:
            mujoco.mju_axisAngle2Quat(quat, model.jnt_axis[joint], change)
            mujoco.mju_mulQuat(whole, own, quat)
            mujoco.mju_rotVecQuat(before, model.jnt_pos[joint], own)
            mujoco.mju_rotVecQuat(after, model.jnt_pos[joint], whole)
            model.body_pos[body] += before - after
            model.body_quat[body] = whole
        model.qpos0[place] = value
    _derive(model)


def free_joints(other: mujoco.MjModel, model: mujoco.MjModel) -> None:
    """Undo `hold_joints`.

    Parameters
    ----------
    other : MjModel
        The model before.
    model : MjModel
        Changed in place.
    """
    model.dof_armature[:] = other.dof_armature
    model.qpos0[:] = other.qpos0
    model.body_pos[:] = other.body_pos
    model.body_quat[:] = other.body_quat
    _derive(model)


def _derive(model: mujoco.MjModel) -> None:
    """Compute what follows from the model's own pose."""
    spring = model.qpos_spring.copy()
    mujoco.mj_setConst(model, mujoco.MjData(model))
    model.qpos_spring[:] = spring
