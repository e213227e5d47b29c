"""What a log's columns can stand for: the joints and actuators of a model, by name."""

from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from dropo.core.services.errors import BadFile
from dropo.core.services.validation import Array

KINDS = ("free", "ball", "slide", "hinge")
WIDTHS = {"free": (7, 6), "ball": (4, 3), "slide": (1, 1), "hinge": (1, 1)}
_POSITIONS = {"free": ("m",) * 3 + ("",) * 4, "ball": ("",) * 4, "slide": ("m",), "hinge": ("rad",)}
_VELOCITIES = {
    "free": ("m/s",) * 3 + ("rad/s",) * 3,
    "ball": ("rad/s",) * 3,
    "slide": ("m/s",),
    "hinge": ("rad/s",),
}


@dataclass(frozen=True)
class Joint:
    """A joint: its kind (of KINDS) and where its numbers begin in qpos and qvel."""

    name: str
    kind: str
    qpos: int
    qvel: int
    range: tuple[float, float] | None = None

    def units(self, field: str) -> tuple[str, ...]:
        """The SI units of its numbers in "qpos" or "qvel"; a quaternion's have none."""
        return (_POSITIONS if field == "qpos" else _VELOCITIES)[self.kind]

    def quaternion(self) -> slice | None:
        """Where the quaternion stands among its positions."""
        return {"free": slice(3, 7), "ball": slice(0, 4)}.get(self.kind)


@dataclass(frozen=True)
class Actuator:
    """An actuator: its place in ctrl, its control range where it has one, and the dof of the joint
    it drives (None: no joint).
    """

    name: str
    index: int
    range: tuple[float, float] | None
    dof: int | None


@dataclass(frozen=True, eq=False)
class Machine:
    """A compiled model's joints and actuators by name, in the model's order; a joint without a name
    goes by its body's.
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
        return (
            0.0
            if self.model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4
            else self.timestep / 2
        )

    @property
    def gravity(self) -> Array:
        """(3,) [m/s^2]"""
        return np.array(self.model.opt.gravity)


def load_machine(path: str | Path) -> Machine:
    """The machine of an MJCF file."""
    if not Path(path).is_file():
        raise BadFile(path, "", "an MJCF file", "no such file")
    try:
        return machine_of(mujoco.MjModel.from_xml_path(str(path)))
    except ValueError as error:
        raise BadFile(
            path, "", "an MJCF file", f"one that MuJoCo refuses ({' '.join(str(error).split())})"
        ) from None


def machine_of(model: mujoco.MjModel) -> Machine:
    """The machine of a compiled model."""
    joints = {}
    for j in range(model.njnt):
        name = model.joint(j).name or model.body(int(model.jnt_bodyid[j])).name or f"joint {j}"
        limits = tuple(map(float, model.jnt_range[j])) if model.jnt_limited[j] else None
        joints[name] = Joint(
            name,
            KINDS[int(model.jnt_type[j])],
            int(model.jnt_qposadr[j]),
            int(model.jnt_dofadr[j]),
            limits,
        )  # type: ignore[arg-type]
    actuators = {}
    for i in range(model.nu):
        limits = (
            tuple(map(float, model.actuator_ctrlrange[i]))
            if model.actuator_ctrllimited[i]
            else None
        )
        driven = (
            int(model.actuator_trnid[i, 0])
            if model.actuator_trntype[i] == mujoco.mjtTrn.mjTRN_JOINT
            else None
        )
        dof = None if driven is None else int(model.jnt_dofadr[driven])
        name = (
            model.actuator(i).name
            or (f"actuator {i}" if driven is None else model.joint(driven).name)
            or f"actuator {i}"
        )
        actuators[name] = Actuator(name, i, limits, dof)  # type: ignore[arg-type]
    return Machine(model, joints, actuators)
