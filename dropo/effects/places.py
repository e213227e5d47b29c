"""The places of a robot where effects can be: bodies, joints, actuators."""

from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

FREE, BALL, SLIDE, HINGE = range(4)
SENSOR_SIZES = {"m": 0.05, "rad": 0.1, "m/s": 0.5, "rad/s": 1.0}
"""Large errors of a sensor, by its unit."""


@dataclass(frozen=True)
class Joint:
    """A joint of one degree of freedom: its id and name, its places in qpos and qvel, the units of force and of position."""

    id: int
    name: str
    position: int
    velocity: int
    force: str
    length: str

    @property
    def kind(self) -> str:
        """ "hinges" or "slides"."""
        return "slides" if self.length == "m" else "hinges"

    @property
    def damping(self) -> str:
        """The unit of viscous damping."""
        return f"{self.force} s/{self.length}"

    @property
    def stiffness(self) -> str:
        """The unit of a spring's stiffness."""
        return f"{self.force}/{self.length}"

    @property
    def inertia(self) -> str:
        """The unit of reflected inertia."""
        return "kg" if self.length == "m" else "kg m^2"


def joints(model: Any) -> list[Joint]:
    """Hinges and slides, but for those of a floating base: one without a name goes by its body's.

    A floating base is a body that hangs from the world by several joints, none of which is driven.
    """
    driven = set(model.actuator_trnid[model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT, 0].tolist())
    of_body = [set(np.flatnonzero(model.jnt_bodyid == body).tolist()) for body in range(model.nbody)]
    floating = {b for b in range(1, model.nbody) if model.body_parentid[b] == 0 and len(of_body[b]) > 1 and not of_body[b] & driven}
    found = []
    for i in np.flatnonzero(np.isin(model.jnt_type, (SLIDE, HINGE))).tolist():
        if int(model.jnt_bodyid[i]) in floating:
            continue
        slides = model.jnt_type[i] == SLIDE
        place = int(model.jnt_qposadr[i]), int(model.jnt_dofadr[i])
        found.append(Joint(i, joint_name(model, i), *place, "N" if slides else "N m", "m" if slides else "rad"))
    return found


def joint_name(model: Any, joint: int) -> str:
    """The joint's name, else its body's, else its number."""
    return _name(model, mujoco.mjtObj.mjOBJ_JOINT, joint) or body_name(model, int(model.jnt_bodyid[joint]))


def body_name(model: Any, body: int) -> str:
    """The body's name, else its number."""
    return _name(model, mujoco.mjtObj.mjOBJ_BODY, body) or str(body)


def bodies(model: Any) -> list[tuple[int, str]]:
    """Bodies with mass, the world left out."""
    return [(b, body_name(model, b)) for b in range(1, model.nbody) if model.body_mass[b] > 0]


@dataclass(frozen=True)
class Actuator:
    """An actuator: its id and name, the largest command, and the joint of one degree of freedom that it drives, if one."""

    id: int
    name: str
    reach: float
    joint: Joint | None


def actuators(model: Any) -> list[Actuator]:
    """All actuators; `reach` is the larger end of the control range, 1 where there is none."""
    by_id = {joint.id: joint for joint in joints(model)}
    found = []
    for i in range(model.nu):
        name = _name(model, mujoco.mjtObj.mjOBJ_ACTUATOR, i) or _driven_name(model, i)
        limited = bool(model.actuator_ctrllimited[i])
        reach = float(np.abs(model.actuator_ctrlrange[i]).max()) if limited else 1.0
        drives = model.actuator_trntype[i] == mujoco.mjtTrn.mjTRN_JOINT
        found.append(Actuator(i, name, reach, by_id.get(int(model.actuator_trnid[i, 0])) if drives else None))
    return found


def _driven_name(model: Any, actuator: int) -> str:
    """An actuator without a name goes by what it drives."""
    if model.actuator_trntype[actuator] == mujoco.mjtTrn.mjTRN_JOINT:
        return joint_name(model, int(model.actuator_trnid[actuator, 0]))
    return str(actuator)


def torque_scale(model: Any, joint: Joint) -> float:
    """The size of forces at a joint: the largest that its actuators give, at least what moves it by 10 rad/s^2 (m/s^2)."""
    found = [10.0 * float(model.dof_M0[joint.velocity])]
    for actuator in actuators(model):
        if actuator.joint is not None and actuator.joint.id == joint.id:
            gain = abs(float(model.actuator_gainprm[actuator.id, 0]) * float(model.actuator_gear[actuator.id, 0]))
            found.append(gain * actuator.reach)
    return max(found)


def touching(model: Any) -> list[tuple[int, str]]:
    """Geoms of moving bodies that can be in contact, by name."""
    can = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    found = np.flatnonzero(can & (model.geom_bodyid > 0)).tolist()
    return [(geom, _name(model, mujoco.mjtObj.mjOBJ_GEOM, geom) or str(geom)) for geom in found]


def _name(model: Any, kind: Any, i: int) -> str:
    return mujoco.mj_id2name(model, kind, i) or ""
