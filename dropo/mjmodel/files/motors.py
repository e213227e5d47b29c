"""Motors by their data sheets: as numbers of an MJCF joint and its actuator, and as parameters."""

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


@dataclass(frozen=True)
class MotorIntervalSettings:
    """How wide the intervals are in which a motor's numbers are fitted.

    Attributes
    ----------
    factor : float
        An interval reaches from the data sheet's number divided by it to that number times it.
    friction : float
        Where the data sheet has no friction: the largest dry friction as a fraction of the peak
        torque, and the largest viscous friction as that fraction at the speed without load.
    """

    factor: float = 3.0
    friction: float = 0.2


@dataclass(frozen=True)
class Motor:
    """A motor with its gear; what its data sheet does not say is None and stays as in the model.

    Attributes
    ----------
    label : str
        What it is called.
    gear_ratio : float
        Turns of the motor for one turn of the joint.
    rotor_inertia : float or None
        Inertia of the rotor, before the gear [kg m^2].
    torque_constant : float or None
        Before the gear [N m/A].
    rated_torque, peak_torque : float or None
        Behind the gear [N m].
    no_load_speed : float or None
        Behind the gear [rad/s].
    coulomb : float or None
        Dry friction, behind the gear [N m].
    viscous : float or None
        Viscous friction, behind the gear [N m s/rad].
    source : str
        Where the numbers are from.

    Raises
    ------
    BadArgument
        If a number is not finite and above 0; friction and inertia of the rotor may be 0.
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
            may_be_zero = field.name in ("coulomb", "viscous", "rotor_inertia")
            valid = _is_finite(value) and (value > 0 or (value == 0 and may_be_zero))
            require(valid, field.name, "a number above 0", value, f"motor {self.label!r}")

    @property
    def armature(self) -> float | None:
        """The rotor's inertia at the joint [kg m^2]: times the square of the gear ratio."""
        return None if self.rotor_inertia is None else self.rotor_inertia * self.gear_ratio**2


def _is_finite(value: Any) -> bool:
    """Whether the value is a finite number."""
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    return is_number and math.isfinite(value)


def read_motors(path: Path | None = None) -> dict[str, Motor]:
    """Read motors from a JSON file.

    Parameters
    ----------
    path : Path, optional
        A file with a mapping from names to the fields of `Motor`; by default the package's own
        library.

    Returns
    -------
    dict of str to Motor

    Raises
    ------
    BadFile
        If the file cannot be read, or is no such mapping.
    UnknownName
        If a motor has a number that `Motor` has not.
    BadArgument
        If a number is out of its range.
    """
    library = files("dropo.mjmodel.files") / "motors.json"
    source: Any = library if path is None else path
    try:
        content = json.loads(source.read_text())
    except (OSError, ValueError) as error:
        raise BadFile(source, "", "a JSON file of motors", str(error)) from None
    if not isinstance(content, dict):
        raise BadFile(source, "", "a mapping from names to motors", type(content).__name__)
    return {name: motor_of(entry, f"{source}: {name}") for name, entry in content.items()}


def motor_of(entry: Any, where: str) -> Motor:
    """Make a motor from an entry of a file.

    Parameters
    ----------
    entry : str or dict
        The name of a motor in the library, or a mapping with the fields of `Motor`.
    where : str
        The place of the entry, for refusals.

    Returns
    -------
    Motor

    Raises
    ------
    BadFile
        If the entry is neither.
    UnknownName
        If there is no such motor or number; with the nearest valid name.
    BadArgument
        If a number is out of its range.
    """
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
    """Write a motor's numbers into a joint of a specification.

    Its peak torque limits the force of the joint's actuators.

    Parameters
    ----------
    spec : MjSpec
        The specification, which is changed in place.
    joint : str
        The name of a hinge or slide.
    motor : Motor
        What turns or moves it.

    Raises
    ------
    UnknownName
        If there is no such joint; with the nearest valid name.
    Incompatible
        If the joint is neither a hinge nor a slide.
    """
    names = [one.name for one in spec.joints if one.name]
    place = spec.joint(known("joint", joint, names))
    if place.type not in (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE):
        raise Incompatible(
            f"A motor turns a hinge or moves a slide, and the joint {joint!r} is neither."
        )
    numbers = {
        "armature": motor.armature,
        "frictionloss": motor.coulomb,
        "damping": motor.viscous,
    }
    for attribute, number in numbers.items():
        if number is None:
            continue
        old = getattr(place, attribute)
        if isinstance(old, float | int):
            setattr(place, attribute, number)
        else:  # coefficients of a polynomial, the linear one first
            setattr(place, attribute, [number, *list(old)[1:]])
    for actuator in spec.actuators:
        if actuator.target == joint and motor.peak_torque is not None:
            limit = motor.peak_torque / abs(float(actuator.gear[0]))
            actuator.forcelimited = True
            actuator.forcerange = [-limit, limit]


def motor_parameters(
    joint: str, motor: Motor, settings: MotorIntervalSettings | None = None
) -> list[FieldParameter]:
    """List the parameters of a motor at a joint that are worth fitting.

    Parameters
    ----------
    joint : str
        The name of the joint.
    motor : Motor
        The motor that drives it.
    settings : MotorIntervalSettings, optional
        How wide the intervals around the data sheet's numbers are.

    Returns
    -------
    list of FieldParameter
        Rotor inertia, dry and viscous friction: those for which the data sheet has numbers.
    """
    chosen = settings or MotorIntervalSettings()
    parameters = []
    if motor.armature:
        parameters.append(
            FieldParameter(
                f"{joint}_armature",
                motor.armature / chosen.factor,
                motor.armature * chosen.factor,
                "kg m^2",
                field="dof_armature",
                element=joint,
            )
        )
    dry, viscous = _largest_frictions(motor, chosen)
    if dry is not None:
        parameters.append(
            FieldParameter(
                f"{joint}_friction", 0.0, dry, "N m", field="dof_frictionloss", element=joint
            )
        )
    if viscous is not None:
        parameters.append(
            FieldParameter(
                f"{joint}_damping", 0.0, viscous, "N m s/rad", field="dof_damping", element=joint
            )
        )
    return parameters


def _largest_frictions(
    motor: Motor, settings: MotorIntervalSettings
) -> tuple[float | None, float | None]:
    """The largest dry [N m] and viscous [N m s/rad] friction that are fitted, where known."""
    dry: float | None = None
    viscous: float | None = None
    if motor.coulomb:
        dry = settings.factor * motor.coulomb
    elif motor.peak_torque:
        dry = settings.friction * motor.peak_torque
    if motor.viscous:
        viscous = settings.factor * motor.viscous
    elif motor.peak_torque is not None and motor.no_load_speed is not None:
        viscous = settings.friction * motor.peak_torque / motor.no_load_speed
    return dry, viscous
