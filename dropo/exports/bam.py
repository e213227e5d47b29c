"""The target `bam`: friction models of servos as the parameter files of BAM."""

import json
import math
from typing import Any

from dropo.core.contracts.effect import EffectInstance
from dropo.core.services.validation import Array
from dropo.exports.support.subject import Subject, Written, effects_left_out
from dropo.mjmodel.dynamics.drives import drives_of

ACTUATORS = ("mx64", "mx106", "xl320", "xl330", "xc330m288t", "erob80_50", "erob80_100", "sts3215")
"""Actuators that BAM knows, by which a servo's name is recognized."""
UNKNOWN = "unknown"
CURVATURE = 2.0
"""The exponent of BAM's Stribeck curve that is that of `joint_stribeck`."""
REFERENCE_SPEED = 0.5
"""The speed to which `joint_stribeck` relates its own [rad/s]."""


def bam(subject: Subject) -> Written:
    """Parameter files of BAM, one for each servo: model m1, or m2 where its friction falls with
    speed.

    Parameters
    ----------
    subject : Subject
        The robot at its means; only its actuated joints are written.

    Returns
    -------
    Written
        One JSON file a joint, with what BAM has no number for among `left_out`.

    References
    ----------
    M. Duclusaud, G. Passault, V. Padois and O. Ly, "Extended friction models for the physics
    simulation of servo actuators", 2025.
    """
    files: dict[str, str | bytes] = {}
    held = set()
    unknown = []
    names = subject.actuators
    for drive in drives_of(subject.model):
        if drive.actuator is None:
            continue
        content: dict[str, Any] = {
            "armature": drive.armature,
            "q_offset": 0.0,
            "friction_base": drive.friction,
            "friction_viscous": drive.viscous,
            "model": "m1",
        }
        for i, (instance, sizes) in enumerate(subject.around):
            if _add(content, instance, sizes, drive.joint, names[drive.actuator]):
                held.add(i)
        content["actuator"] = _actuator(names[drive.actuator], drive.joint)
        if content["actuator"] == UNKNOWN:
            unknown.append(drive.joint)
        files[f"{drive.joint}.json"] = json.dumps(content, indent=1) + "\n"
    others = [pair for i, pair in enumerate(subject.around) if i not in held]
    left_out = effects_left_out(others, "models m1 and m2 of BAM have no number for it")
    left_out.append(
        "Torque constant kt and resistance R are left out: a model of joints does not tell them, "
        "and BAM takes those of its actuator."
    )
    if subject.distribution is not None:
        left_out.append("Spreads are left out: BAM holds one number of each parameter.")
    if unknown:
        left_out.append(
            f"The actuator of {', '.join(unknown)} is left out: write the name that BAM has for it."
        )
    left_out.append("Masses, inertias and contacts are left out: BAM holds servos alone.")
    return Written(files, tuple(left_out))


def _add(
    content: dict[str, Any], instance: EffectInstance, sizes: Array, joint: str, actuator: str
) -> bool:
    """Adds an effect to a servo's numbers; whether BAM has a number for it."""
    if instance.effect == "joint_stribeck" and instance.target == joint:
        content["friction_stribeck"] = float(sizes[0])
        content["dtheta_stribeck"] = REFERENCE_SPEED * math.exp(float(sizes[1]))
        content["alpha"] = CURVATURE
        content["model"] = "m2"
        return True
    if instance.effect == "actuator_delay" and instance.target in (None, actuator):
        content["command_delay"] = content.get("command_delay", 0.0) + float(sizes[0])
        return True
    return False


def _actuator(*names: str) -> str:
    """BAM's name of an actuator that is in one of the names."""
    plain = [name.lower().replace("-", "").replace("_", "") for name in names]
    found = [known for known in ACTUATORS if any(known.replace("_", "") in one for one in plain)]
    return found[-1] if found else UNKNOWN
