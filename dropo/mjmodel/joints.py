"""The joints and actuators of a model, by name."""

from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from dropo.core.services.errors import BadFile
from dropo.core.services.validation import Array
from dropo.mjmodel.names import KINDS, actuator_names, driven_joints, joint_names

_POSITIONS = {
    "free": ("m",) * 3 + ("",) * 4,
    "ball": ("",) * 4,
    "slide": ("m",),
    "hinge": ("rad",),
}
_VELOCITIES = {
    "free": ("m/s",) * 3 + ("rad/s",) * 3,
    "ball": ("rad/s",) * 3,
    "slide": ("m/s",),
    "hinge": ("rad/s",),
}


@dataclass(frozen=True)
class Joint:
    """A joint.

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
        """The SI units of its numbers in "qpos" or "qvel"; a quaternion's have none."""
        return (_POSITIONS if field == "qpos" else _VELOCITIES)[self.kind]

    def quaternion(self) -> slice | None:
        """Where the quaternion stands among its positions."""
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
class Actuator:
    """An actuator.

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

    A joint without a name goes by its body's; where a body has several such joints, they are called
    "torso/slide_x", "torso/slide_z", "torso/hinge_y" by the axis of the body's frame that they are
    along, or "torso/hinge_2" by their number in the body where that does not tell them apart. An
    actuator without a name goes by the joint that it alone drives. What has no name in this way
    either is "joint5" or "actuator2" by its id.
    """

    model: mujoco.MjModel
    joints: dict[str, Joint]
    actuators: dict[str, Actuator]

    @property
    def timestep(self) -> float:
        """Seconds of one physics step."""
        return float(self.model.opt.timestep)

    @property
    def velocity_lag(self) -> float:
        """Seconds by which the model's own velocities are behind its positions.

        Its semi-implicit integrators move a position by the velocity of the step's end, so that a
        state's velocity is that of the middle of the step before; RK4's is not late.
        """
        late = self.model.opt.integrator != mujoco.mjtIntegrator.mjINT_RK4
        return self.timestep / 2 if late else 0.0

    @property
    def heaviest_body(self) -> tuple[str, float]:
        """Its name and mass [kg]; the first of several."""
        body = max(range(1, self.model.nbody), key=lambda i: self.model.body_mass[i], default=0)
        return str(self.model.body(body).name), float(self.model.body_mass[body])

    @property
    def gravity(self) -> Array:
        """(3,) [m/s^2]"""
        return np.array(self.model.opt.gravity)


def load_model_joints(path: str | Path) -> ModelJoints:
    """The joints and actuators of an MJCF file; BadFile where it is none."""
    if not Path(path).is_file():
        raise BadFile(path, "", "an MJCF file", "no such file")
    try:
        return model_joints(mujoco.MjModel.from_xml_path(str(path)))
    except ValueError as error:
        got = f"one that MuJoCo refuses ({' '.join(str(error).split())})"
        raise BadFile(path, "", "an MJCF file", got) from None


def model_joints(model: mujoco.MjModel) -> ModelJoints:
    """The joints and actuators of a compiled model."""
    joints = {joint.name: joint for joint in all_joints(model)}
    return ModelJoints(model, joints, {actuator.name: actuator for actuator in actuators(model)})


def all_joints(model: mujoco.MjModel) -> list[Joint]:
    """Every joint, in the model's order."""
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
    """Hinges and slides, but for those of a floating base.

    A floating base is a body that hangs from the world by several joints, none of which is driven.
    """
    every = all_joints(model)
    driven = set(driven_joints(model).tolist())
    of_body: dict[int, list[Joint]] = {}
    for joint in every:
        of_body.setdefault(joint.body, []).append(joint)
    floating = {
        body
        for body, own in of_body.items()
        if model.body_parentid[body] == 0 and len(own) > 1 and not driven & {one.id for one in own}
    }
    return [one for one in every if one.kind in ("slide", "hinge") and one.body not in floating]


def degrees_of_freedom(model: mujoco.MjModel) -> list[tuple[str, str]]:
    """(nv,) the name of each degree of freedom, "hip" or "box[0]" of a joint of several, and the
    unit of forces on it.
    """
    found = []
    for joint in all_joints(model):
        units = joint.units("qvel")
        for i, unit in enumerate(units):
            name = f"{joint.name}[{i}]" if len(units) > 1 else joint.name
            found.append((name, "N" if unit == "m/s" else "N m"))
    return found


def actuators(model: mujoco.MjModel) -> list[Actuator]:
    """Every actuator, in the model's order."""
    every = all_joints(model)
    driven = driven_joints(model).tolist()
    found = []
    for i, name in enumerate(actuator_names(model)):
        low, high = model.actuator_ctrlrange[i].tolist()
        limits = (low, high) if model.actuator_ctrllimited[i] else None
        found.append(Actuator(i, name, limits, every[driven[i]] if driven[i] >= 0 else None))
    return found
