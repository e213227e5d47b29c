"""Motors as engineers know them: a data sheet's numbers as those of an MJCF joint and its actuator,
and as parameters to fit.
"""

import json
import math
from dataclasses import dataclass, fields
from importlib.resources import files
from pathlib import Path
from typing import Any

import mujoco

from dropo.core.services.errors import BadFile, Incompatible
from dropo.core.services.validation import known, require
from dropo.mjmodel.fields import FieldParameter

# a parameter's interval reaches from the data sheet's number divided by it to that many times as
# much
WIDE = 3.0
# of the peak torque: the largest dry friction, and the largest viscous one at the speed without
# load
FRICTION = 0.2


@dataclass(frozen=True)
class Motor:
    """A motor with its gear; what a data sheet does not say is None and is left as the model has
    it.

    gear_ratio: motor turns a turn of the joint; rotor_inertia [kg m^2], torque_constant [N m / A]:
    before the gear; rated_torque, peak_torque [N m], no_load_speed [rad/s], coulomb [N m], viscous
    [N m s/rad]: behind it; source: of the numbers.
    """

    label: str = ""
    gear_ratio: float = 1.0
    rotor_inertia: float | None = None
    torque_constant: float | None = None
    rated_torque: float | None = None
    peak_torque: float | None = None
    no_load_speed: float | None = None
    coulomb: float | None = None
    viscous: float | None = None
    source: str = ""

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if field.name in ("label", "source") or value is None:
                continue
            number = (
                isinstance(value, int | float)
                and not isinstance(value, bool)
                and math.isfinite(value)
            )
            least_ok = number and (
                value > 0 or (value == 0 and field.name in ("coulomb", "viscous", "rotor_inertia"))
            )
            require(least_ok, field.name, "a number above 0", value, f"motor {self.label!r}")

    @property
    def armature(self) -> float | None:
        """The rotor's inertia as the joint feels it [kg m^2]: times the square of the gear ratio."""
        return None if self.rotor_inertia is None else self.rotor_inertia * self.gear_ratio**2


def read_motors(path: Path | None = None) -> dict[str, Motor]:
    """The motors of a JSON file, by name, each a mapping with the fields of `Motor`; of the
    package's own library by default.
    """
    own = files("dropo.mjmodel") / "motors.json"
    where: Any = own if path is None else path
    try:
        content = json.loads(where.read_text())
    except (OSError, ValueError) as error:
        raise BadFile(where, "", "a JSON file of motors", str(error)) from None
    if not isinstance(content, dict):
        raise BadFile(where, "", "a mapping from names to motors", type(content).__name__)
    return {name: motor_of(entry, f"{where}: {name}") for name, entry in content.items()}


def motor_of(entry: Any, where: str) -> Motor:
    """A motor from the name of one in the library, or from a mapping with the fields of `Motor`."""
    if isinstance(entry, str):
        library = read_motors()
        return library[known("motor", entry, library)]
    if not isinstance(entry, dict):
        raise BadFile(where, "", "the name of a motor, or a mapping with its numbers", repr(entry))
    names = [field.name for field in fields(Motor)]
    for key in entry:
        known("number of a motor", str(key), names)
    return Motor(**entry)


def mount(spec: mujoco.MjSpec, joint: str, motor: Motor) -> None:
    """Writes the motor's numbers into the joint of a specification, and its peak torque into the
    range of its actuators' forces.
    """
    names = [one.name for one in spec.joints if one.name]
    place = spec.joint(known("joint", joint, names))
    if place.type not in (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE):
        raise Incompatible(
            f"A motor turns a hinge or moves a slide, and the joint {joint!r} is neither."
        )
    for attribute, number in (
        ("armature", motor.armature),
        ("frictionloss", motor.coulomb),
        ("damping", motor.viscous),
    ):
        if number is not None:
            old = getattr(place, attribute)
            setattr(
                place,
                attribute,
                number if isinstance(old, float | int) else [number, *list(old)[1:]],
            )
    for actuator in spec.actuators:
        if actuator.target == joint and motor.peak_torque is not None:
            limit = motor.peak_torque / abs(float(actuator.gear[0]))
            actuator.forcelimited = True
            actuator.forcerange = [-limit, limit]


def motor_parameters(joint: str, motor: Motor) -> list[FieldParameter]:
    """What is worth fitting of a motor at a joint: rotor inertia, dry and viscous friction, in
    intervals around the data sheet's.
    """
    out = []
    if motor.armature:
        low = motor.armature / WIDE
        high = motor.armature * WIDE
        out.append(
            FieldParameter(
                f"{joint}_armature", low, high, "kg m^2", field="dof_armature", element=joint
            )
        )
    dry = (
        WIDE * motor.coulomb
        if motor.coulomb
        else FRICTION * motor.peak_torque
        if motor.peak_torque
        else None
    )
    if dry is not None:
        out.append(
            FieldParameter(
                f"{joint}_friction", 0.0, dry, "N m", field="dof_frictionloss", element=joint
            )
        )
    wet = (
        None
        if motor.peak_torque is None or motor.no_load_speed is None
        else FRICTION * motor.peak_torque / motor.no_load_speed
    )
    wet = WIDE * motor.viscous if motor.viscous else wet
    if wet is not None:
        out.append(
            FieldParameter(
                f"{joint}_damping", 0.0, wet, "N m s/rad", field="dof_damping", element=joint
            )
        )
    return out
