"""The joints of a model with what drives each, as a proportional-derivative law."""

from dataclasses import dataclass

import mujoco

from dropo.mjmodel.joints import Joint, actuators, joints
from dropo.mjmodel.names import driven_joints


@dataclass(frozen=True)
class Drive:
    """A hinge or slide, with the actuator that drives it alone.

    Attributes
    ----------
    joint : str
        Its name.
    actuator : int or None
        The actuator's number; None without one.
    gear : float
        Of the actuator, 1 without one.
    stiffness, damping : float
        Of the servo, behind the gear, the joint's own viscous friction in the damping.
    armature, friction, viscous : float
        Of the joint: rotor inertia, dry and viscous friction.
    limit : float or None
        The largest force or torque behind the gear, where there is a limit.
    """

    joint: str
    actuator: int | None
    gear: float
    stiffness: float
    damping: float
    armature: float
    friction: float
    viscous: float
    limit: float | None


@dataclass(frozen=True)
class Servo:
    """The gains of a position servo, before its gear.

    Attributes
    ----------
    kp, kv : float
        Of position and speed.
    """

    kp: float
    kv: float


def servo_of(model: mujoco.MjModel, actuator: int) -> Servo | None:
    """Read the gains of a position servo.

    Parameters
    ----------
    model : MjModel
        The compiled model.
    actuator : int
        The actuator's id.

    Returns
    -------
    Servo or None
        Its gains; None where the actuator is no position servo.
    """
    kp = float(model.actuator_gainprm[actuator, 0])
    if kp == 0 or model.actuator_biasprm[actuator, 1] != -kp:
        return None
    return Servo(kp, -float(model.actuator_biasprm[actuator, 2]))


def command_kind(model: mujoco.MjModel, actuator: int) -> str:
    """Tell what an actuator's command is.

    Parameters
    ----------
    model : MjModel
        The compiled model.
    actuator : int
        Its number.

    Returns
    -------
    str
        "position", "velocity" or "torque".
    """
    if servo_of(model, actuator) is not None:
        return "position"
    bias = model.actuator_biasprm[actuator]
    return "velocity" if bias[1] == 0 != bias[2] else "torque"


def feedback_at(model: mujoco.MjModel, joint: Joint) -> tuple[float, float]:
    """Add up what the servos at a joint feed back.

    Parameters
    ----------
    model : MjModel
        The compiled model.
    joint : Joint
        A slide or hinge.

    Returns
    -------
    stiffness, damping : float
        Behind the gears [N/m, N s/m or N m/rad, N m s/rad].
    """
    stiffness = 0.0
    damping = 0.0
    for actuator in actuators(model):
        if actuator.joint is None or actuator.joint.id != joint.id:
            continue
        gear = float(model.actuator_gear[actuator.id, 0])
        bias = model.actuator_biasprm[actuator.id]
        stiffness += abs(float(bias[1])) * gear**2
        damping += abs(float(bias[2])) * gear**2
    return stiffness, damping


def drives_of(model: mujoco.MjModel) -> list[Drive]:
    """List the hinges and slides of a model with what drives each.

    Parameters
    ----------
    model : MjModel
        The model.

    Returns
    -------
    list of Drive
        A joint with several actuators, or one of another law than a motor's or a servo's, is taken
        as not driven.
    """
    driven = driven_joints(model).tolist()
    found = []
    for joint in joints(model):
        i = driven.index(joint.id) if driven.count(joint.id) == 1 else None
        gear, stiffness, speed, limit = (1.0, 0.0, 0.0, None) if i is None else _law(model, i)
        viscous = float(model.dof_damping[joint.qvel])
        found.append(
            Drive(
                joint.name,
                i,
                gear,
                stiffness * gear**2,
                speed * gear**2 + viscous,
                float(model.dof_armature[joint.qvel]),
                float(model.dof_frictionloss[joint.qvel]),
                viscous,
                limit,
            )
        )
    return found


def _law(model: mujoco.MjModel, i: int) -> tuple[float, float, float, float | None]:
    """Gear, stiffness and damping of an actuator, and its limit behind the gear."""
    gear = float(model.actuator_gear[i, 0])
    pull = float(model.actuator_gainprm[i, 0])
    servo = model.actuator_biastype[i] == mujoco.mjtBias.mjBIAS_AFFINE
    stiffness = -float(model.actuator_biasprm[i, 1]) if servo else 0.0
    speed = -float(model.actuator_biasprm[i, 2]) if servo else 0.0
    limit = None
    if model.actuator_forcelimited[i]:
        limit = abs(gear) * float(abs(model.actuator_forcerange[i]).max())
    elif not servo and model.actuator_ctrllimited[i]:
        limit = abs(gear * pull) * float(abs(model.actuator_ctrlrange[i]).max())
    return gear, stiffness, speed, limit
