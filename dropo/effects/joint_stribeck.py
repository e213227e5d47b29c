"""Friction that falls with speed."""

from collections.abc import Iterator
from functools import partial

import numpy as np

from dropo.core.contracts.effect import Atom, Moment, Quantity, Robot
from dropo.core.services.validation import Array
from dropo.effects.support.places import Joint, joints, torque_scale

ZERO = 1e-2  # [rad/s, m/s] below which the sign of a speed fades out


def joint_stribeck(robot: Robot) -> Iterator[Atom]:
    """Dry friction that falls with speed: -F exp(-(v / v_s)^2) tanh(v / 0.01) (Stribeck 1902), with v_s to be found."""
    for joint in joints(robot.model):
        scale = torque_scale(robot.model, joint)
        size = Quantity("friction", joint.force, 0.0, 0.5 * scale, (1e-3 * scale, 1e-2 * scale))
        speed = Quantity("log(speed / 0.5)", "1", -3.0, 3.0, (-1.0, 1.0))
        trials = tuple(((share * scale, width),) for share in (1e-3, 1e-2) for width in (-1.0, 0.0, 1.0))
        yield Atom("joint_stribeck", joint.name, (size, speed), force=partial(_rub, joint), trials=trials)


def _rub(joint: Joint, moment: Moment, sizes: Array) -> Array:
    out, speed, width = np.zeros_like(moment.qvel), moment.qvel[:, joint.velocity], 0.5 * np.exp(sizes[1])
    out[:, joint.velocity] = -sizes[0] * np.exp(-((speed / width) ** 2)) * np.tanh(speed / ZERO)
    return out
