"""The places of a robot where effects can be: bodies, joints, actuators."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from dropo.core.contracts.effect import StepState
from dropo.core.services.validation import Array

FREE, BALL, SLIDE, HINGE = range(4)
FIXED = int(mujoco.mjtGain.mjGAIN_FIXED)
AFFINE = int(mujoco.mjtGain.mjGAIN_AFFINE)
NO_BIAS = int(mujoco.mjtBias.mjBIAS_NONE)
AFFINE_BIAS = int(mujoco.mjtBias.mjBIAS_AFFINE)
SENSOR_SIZES = {"m": 0.05, "rad": 0.1, "m/s": 0.5, "rad/s": 1.0}
"""Large errors of a sensor, by its unit."""


@dataclass(frozen=True)
class Joint:
    """A joint of one degree of freedom: its id and name, its places in qpos and qvel, the units of
    force and of position.
    """

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
    driven = set(
        model.actuator_trnid[model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT, 0].tolist()
    )
    of_body = [
        set(np.flatnonzero(model.jnt_bodyid == body).tolist()) for body in range(model.nbody)
    ]
    floating = {
        b
        for b in range(1, model.nbody)
        if model.body_parentid[b] == 0 and len(of_body[b]) > 1 and not of_body[b] & driven
    }
    found = []
    for i in np.flatnonzero(np.isin(model.jnt_type, (SLIDE, HINGE))).tolist():
        if int(model.jnt_bodyid[i]) in floating:
            continue
        slides = model.jnt_type[i] == SLIDE
        place = int(model.jnt_qposadr[i]), int(model.jnt_dofadr[i])
        found.append(
            Joint(
                i, joint_name(model, i), *place, "N" if slides else "N m", "m" if slides else "rad"
            )
        )
    return found


def joint_name(model: Any, joint: int) -> str:
    """The joint's name, else its body's where that has no other joint, else its number."""
    body = int(model.jnt_bodyid[joint])
    alone = body_name(model, body) if model.body_jntnum[body] == 1 else str(joint)
    return _name(model, mujoco.mjtObj.mjOBJ_JOINT, joint) or alone


def body_name(model: Any, body: int) -> str:
    """The body's name, else its number."""
    return _name(model, mujoco.mjtObj.mjOBJ_BODY, body) or str(body)


def bodies(model: Any) -> list[tuple[int, str]]:
    """Bodies with mass that can move."""
    return [
        (b, body_name(model, b))
        for b in range(1, model.nbody)
        if model.body_mass[b] > 0 and model.body_weldid[b] > 0
    ]


@dataclass(frozen=True)
class Actuator:
    """An actuator: its id and name, the largest command, and the joint of one degree of freedom
    that it drives, if one.
    """

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
        found.append(
            Actuator(i, name, reach, by_id.get(int(model.actuator_trnid[i, 0])) if drives else None)
        )
    return found


def _driven_name(model: Any, actuator: int) -> str:
    """An actuator without a name goes by the joint that it alone drives, else by its number."""
    same = (model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT) & (
        model.actuator_trnid[:, 0] == model.actuator_trnid[actuator, 0]
    )
    return (
        joint_name(model, int(model.actuator_trnid[actuator, 0]))
        if same[actuator] and same.sum() == 1
        else str(actuator)
    )


def motors(model: Any) -> list[tuple[Joint, list[int]]]:
    """The joints that are driven by actuators whose force is known from the state (`motor_force`),
    and these.
    """
    known = np.isin(model.actuator_gaintype, (FIXED, AFFINE)) & np.isin(
        model.actuator_biastype, (NO_BIAS, AFFINE_BIAS)
    )
    found: dict[int, tuple[Joint, list[int]]] = {}
    for actuator in actuators(model):
        if actuator.joint is not None and known[actuator.id]:
            found.setdefault(actuator.joint.id, (actuator.joint, []))[1].append(actuator.id)
    return list(found.values())


def motor_force(step_state: StepState, joint: Joint, ids: Sequence[int]) -> Array:
    """(n,) the generalised force of a joint's actuators: gear (gain u + bias), as MuJoCo computes
    it.
    """
    model = step_state.model
    total = np.zeros(len(step_state.ctrl))
    for i in ids:
        gear = float(model.actuator_gear[i, 0])
        state = int(model.actuator_actadr[i])
        limit = model.actuator_ctrlrange[i] if model.actuator_ctrllimited[i] else (-np.inf, np.inf)
        u = (
            np.clip(step_state.ctrl[:, i], *limit)
            if state < 0
            else step_state.act[:, state + int(model.actuator_actnum[i]) - 1]
        )
        terms = np.stack(
            [
                np.ones(len(u)),
                gear * step_state.qpos[:, joint.position],
                gear * step_state.qvel[:, joint.velocity],
            ]
        )
        gain = (
            model.actuator_gainprm[i, :3]
            if model.actuator_gaintype[i] == AFFINE
            else model.actuator_gainprm[i, :3] * (1, 0, 0)
        )
        bias = model.actuator_biasprm[i, :3] * (model.actuator_biastype[i] == AFFINE_BIAS)
        most = model.actuator_forcerange[i] if model.actuator_forcelimited[i] else (-np.inf, np.inf)
        total += gear * np.clip((gain @ terms) * u + bias @ terms, *most)
    return total


def torque_scale(model: Any, joint: Joint) -> float:
    """The size of forces at a joint: the largest that its actuators give, at least what moves it by
    10 rad/s^2 (m/s^2).
    """
    found = [10.0 * float(model.dof_M0[joint.velocity])]
    for actuator in actuators(model):
        if actuator.joint is not None and actuator.joint.id == joint.id:
            gain = abs(
                float(model.actuator_gainprm[actuator.id, 0])
                * float(model.actuator_gear[actuator.id, 0])
            )
            found.append(gain * actuator.reach)
    return max(found)


def touching(model: Any) -> list[tuple[int, str]]:
    """Geoms of moving bodies that can be in contact, by name."""
    can = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    found = np.flatnonzero(can & (model.geom_bodyid > 0)).tolist()
    return [(geom, _name(model, mujoco.mjtObj.mjOBJ_GEOM, geom) or str(geom)) for geom in found]


def each_and_all(found: Sequence[Actuator]) -> list[tuple[str | None, tuple[int, ...]]]:
    """(target, ids) of every actuator, and of all together where there are several."""
    each: list[tuple[str | None, tuple[int, ...]]] = [
        (actuator.name, (actuator.id,)) for actuator in found
    ]
    return [*each, (None, tuple(actuator.id for actuator in found))] if len(found) > 1 else each


def is_rotation(signal: str) -> bool:
    """Whether a signal is one of the three numbers of an orientation."""
    return signal.startswith("qpos") and signal.endswith((".rx", ".ry", ".rz"))


def _name(model: Any, kind: Any, i: int) -> str:
    return mujoco.mj_id2name(model, kind, i) or ""
