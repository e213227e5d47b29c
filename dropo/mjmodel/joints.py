"""The joints and actuators of a model, by name."""

from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from dropo.core.services.validation import Array
from dropo.mjmodel.files.loading import load_model
from dropo.mjmodel.names import KINDS, actuator_names, driven_joints, joint_names
from dropo.mjmodel.options import gravity, integrator, physics_step
from dropo.mjmodel.sensors import Sensor, named_sensors

_POSITION_UNITS = {
    "free": ("m",) * 3 + ("",) * 4,
    "ball": ("",) * 4,
    "slide": ("m",),
    "hinge": ("rad",),
}
_VELOCITY_UNITS = {
    "free": ("m/s",) * 3 + ("rad/s",) * 3,
    "ball": ("rad/s",) * 3,
    "slide": ("m/s",),
    "hinge": ("rad/s",),
}


@dataclass(frozen=True)
class Joint:
    """A joint of a model.

    Attributes
    ----------
    id : int
        Its number in the model.
    name : str
        By `dropo.mjmodel.names.joint_names`: its own, else its body's, or "torso/slide_x" where a
        body has several joints without a name.
    kind : str
        "free", "ball", "slide" or "hinge".
    body : int
        The body that it moves.
    qpos, qvel : int
        Where its numbers begin in qpos and qvel.
    range : (float, float) or None
        Its limits, where it has some [m or rad].
    """

    id: int
    name: str
    kind: str
    body: int
    qpos: int
    qvel: int
    range: tuple[float, float] | None = None

    def units(self, field: str) -> tuple[str, ...]:
        """Give the SI units of the joint's numbers in a field.

        Parameters
        ----------
        field : str
            "qpos" or "qvel".

        Returns
        -------
        tuple of str
            One for each of its numbers; those of a quaternion are empty.
        """
        units = _POSITION_UNITS if field == "qpos" else _VELOCITY_UNITS
        return units[self.kind]

    def quaternion(self) -> slice | None:
        """Give the places of its quaternion.

        Returns
        -------
        slice or None
            Among the positions; None without one.
        """
        return {"free": slice(3, 7), "ball": slice(0, 4)}.get(self.kind)

    @property
    def length(self) -> str:
        """The unit of the position of a slide or hinge."""
        return "m" if self.kind == "slide" else "rad"

    @property
    def force(self) -> str:
        """The unit of the force on a slide or hinge."""
        return "N" if self.kind == "slide" else "N m"

    @property
    def damping(self) -> str:
        """The unit of viscous damping of a slide or hinge."""
        return f"{self.force} s/{self.length}"

    @property
    def stiffness(self) -> str:
        """The unit of a spring's stiffness at a slide or hinge."""
        return f"{self.force}/{self.length}"

    @property
    def inertia(self) -> str:
        """The unit of reflected inertia at a slide or hinge."""
        return "kg" if self.kind == "slide" else "kg m^2"


@dataclass(frozen=True)
class JointNumbers:
    """What a model says of a slide or hinge.

    Attributes
    ----------
    armature : float
        Reflected inertia [kg or kg m^2].
    damping : float
        Viscous friction [N s/m or N m s/rad].
    friction : float
        Dry friction [N or N m].
    stiffness : float
        Of its spring [N/m or N m/rad].
    rest : float
        Where the spring rests [m or rad].
    inertia : float
        What moves with it in the model's reference pose [kg or kg m^2].
    """

    armature: float
    damping: float
    friction: float
    stiffness: float
    rest: float
    inertia: float


@dataclass(frozen=True)
class Actuator:
    """An actuator of a model.

    Attributes
    ----------
    id : int
        Its number in the model, and its place in ctrl.
    name : str
        By `dropo.mjmodel.names.actuator_names`: its own, else that of the joint it alone drives.
    range : (float, float) or None
        Its control range, where it has one.
    joint : Joint or None
        The joint that it drives, where it drives one.
    """

    id: int
    name: str
    range: tuple[float, float] | None
    joint: Joint | None

    @property
    def largest_command(self) -> float:
        """The larger end of the control range, 1 where there is none."""
        return 1.0 if self.range is None else max(map(abs, self.range))


@dataclass(frozen=True, eq=False)
class ModelJoints:
    """A compiled model's joints and actuators by name, in the model's order.

    What has no name in the MJCF is named by `dropo.mjmodel.names`.

    Attributes
    ----------
    model : MjModel
        The compiled model.
    joints : dict of str to Joint
        All joints.
    actuators : dict of str to Actuator
        All actuators.
    sensors : dict of str to Sensor
        Those that have a name.
    """

    model: mujoco.MjModel
    joints: dict[str, Joint]
    actuators: dict[str, Actuator]
    sensors: dict[str, Sensor]

    @property
    def name(self) -> str:
        """The name that the MJCF gives the robot; MuJoCo's own default is none."""
        name = self.model.names.split(b"\0", 1)[0].decode(errors="replace")
        return "" if name == "MuJoCo Model" else name

    @property
    def bodies(self) -> dict[str, str]:
        """By a joint's name that of the body that it alone moves, where that has another name."""
        moved = Counter(joint.body for joint in self.joints.values())
        found = {}
        for name, joint in self.joints.items():
            body = str(self.model.body(joint.body).name)
            if moved[joint.body] == 1 and body and body not in self.joints:
                found[name] = body
        return found

    @property
    def timestep(self) -> float:
        """The physics step [s]."""
        return physics_step(self.model)

    @property
    def velocity_lag(self) -> float:
        """The time by which the model's own velocities are behind its positions [s].

        Semi-implicit integrators move a position by the velocity of the end of the step, so that
        the velocity of a state is that of the middle of the step before; that of RK4 is not late.
        """
        return 0.0 if integrator(self.model) == "RK4" else self.timestep / 2

    @property
    def heaviest_body(self) -> tuple[str, float]:
        """The name and mass [kg] of the heaviest body; the first of several."""
        body = max(range(1, self.model.nbody), key=lambda i: self.model.body_mass[i], default=0)
        return str(self.model.body(body).name), float(self.model.body_mass[body])

    @property
    def gravity(self) -> Array:
        """(3,) gravity in the world's axes [m/s^2]."""
        return gravity(self.model)


def load_model_joints(path: str | Path) -> ModelJoints:
    """Read the joints and actuators of an MJCF file.

    Parameters
    ----------
    path : str or Path
        The file.

    Returns
    -------
    ModelJoints

    Raises
    ------
    BadFile
        If there is no such file, or MuJoCo refuses it.
    """
    return model_joints(load_model(path))


def model_joints(model: mujoco.MjModel) -> ModelJoints:
    """Collect the joints, actuators and sensors of a compiled model.

    Parameters
    ----------
    model : MjModel
        The compiled model.

    Returns
    -------
    ModelJoints
        By name.
    """
    joints = {joint.name: joint for joint in all_joints(model)}
    driven = {actuator.name: actuator for actuator in actuators(model)}
    return ModelJoints(model, joints, driven, named_sensors(model))


def all_joints(model: mujoco.MjModel) -> list[Joint]:
    """List every joint, in the model's order.

    Parameters
    ----------
    model : MjModel
        The compiled model.

    Returns
    -------
    list of Joint
        With the range of each joint that has one [m or rad].
    """
    found = []
    for i, name in enumerate(joint_names(model)):
        low, high = model.jnt_range[i].tolist()
        found.append(
            Joint(
                i,
                name,
                KINDS[int(model.jnt_type[i])],
                int(model.jnt_bodyid[i]),
                int(model.jnt_qposadr[i]),
                int(model.jnt_dofadr[i]),
                (low, high) if model.jnt_limited[i] else None,
            )
        )
    return found


def joints(model: mujoco.MjModel) -> list[Joint]:
    """List the hinges and slides, without those of a floating base.

    A floating base is a body that hangs from the world by several joints, none of which is driven.

    Parameters
    ----------
    model : MjModel
        The compiled model.

    Returns
    -------
    list of Joint
        In the model's order.
    """
    every = all_joints(model)
    driven = set(driven_joints(model).tolist())
    joints_of: dict[int, list[Joint]] = {}
    for joint in every:
        joints_of.setdefault(joint.body, []).append(joint)
    floating = set()
    for body, own in joints_of.items():
        is_driven = any(joint.id in driven for joint in own)
        if model.body_parentid[body] == 0 and len(own) > 1 and not is_driven:
            floating.add(body)
    return [
        joint for joint in every if joint.kind in ("slide", "hinge") and joint.body not in floating
    ]


def degrees_of_freedom(model: mujoco.MjModel) -> list[tuple[str, str]]:
    """Name the degrees of freedom of a model.

    Parameters
    ----------
    model : MjModel
        The compiled model.

    Returns
    -------
    list of (str, str)
        The name of each of the nv degrees of freedom, "hip" or "box[0]" where a joint has several,
        and the unit of the generalised force on it.
    """
    found = []
    for joint in all_joints(model):
        units = joint.units("qvel")
        for i, unit in enumerate(units):
            name = f"{joint.name}[{i}]" if len(units) > 1 else joint.name
            found.append((name, "N" if unit == "m/s" else "N m"))
    return found


def actuators(model: mujoco.MjModel) -> list[Actuator]:
    """List every actuator, in the model's order.

    Parameters
    ----------
    model : MjModel
        The compiled model.

    Returns
    -------
    list of Actuator
        With its control range and the joint that it drives, where it has them.
    """
    every = all_joints(model)
    driven = driven_joints(model).tolist()
    found = []
    for i, name in enumerate(actuator_names(model)):
        low, high = model.actuator_ctrlrange[i].tolist()
        limits = (low, high) if model.actuator_ctrllimited[i] else None
        found.append(Actuator(i, name, limits, every[driven[i]] if driven[i] >= 0 else None))
    return found


def numbers_of(model: mujoco.MjModel, joint: Joint) -> JointNumbers:
    """Read what a model says of a joint.

    Parameters
    ----------
    model : MjModel
        The compiled model.
    joint : Joint
        A slide or hinge.

    Returns
    -------
    JointNumbers
    """
    dof = joint.qvel
    return JointNumbers(
        armature=float(model.dof_armature[dof]),
        damping=float(np.ravel(model.dof_damping[dof])[0]),
        friction=float(model.dof_frictionloss[dof]),
        stiffness=float(np.ravel(model.jnt_stiffness[joint.id])[0]),
        rest=float(model.qpos_spring[joint.qpos]),
        inertia=float(model.dof_M0[dof]),
    )


def inertias(model: mujoco.MjModel) -> Array:
    """Return what moves with each degree of freedom.

    Parameters
    ----------
    model : MjModel
        The compiled model.

    Returns
    -------
    (nv,) array
        In the reference pose [kg or kg m^2].
    """
    return np.array(model.dof_M0)


def dry_frictions(model: mujoco.MjModel) -> Array:
    """Return the dry friction at each degree of freedom.

    Parameters
    ----------
    model : MjModel
        The compiled model.

    Returns
    -------
    (nv,) array
        In N or N m.
    """
    return np.array(model.dof_frictionloss)


def reference_pose(model: mujoco.MjModel) -> Array:
    """Return the positions in which a model begins.

    Parameters
    ----------
    model : MjModel
        The compiled model.

    Returns
    -------
    (nq,) array
        In m and rad.
    """
    return np.array(model.qpos0)


def command_limits(model: mujoco.MjModel) -> Array:
    """Return the limits of commands.

    Parameters
    ----------
    model : MjModel
        The compiled model.

    Returns
    -------
    (2, nu) array
        Lower and upper, infinite where there are none.
    """
    limited = np.asarray(model.actuator_ctrllimited, dtype=bool)
    return np.where(limited, model.actuator_ctrlrange.T, np.array([[-np.inf], [np.inf]]))
