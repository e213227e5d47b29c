"""Friction that grows with the load."""

from collections.abc import Iterator

import numpy as np

from dropo.core.checks import Array
from dropo.core.effect import Atom, Moment, Quantity, Robot
from dropo.effects.places import Joint, actuators

ZERO = 1e-2  # [rad/s, m/s] below which the sign of a speed fades out


def joint_load_friction(robot: Robot) -> Iterator[Atom]:
    """Dry friction of a joint that is a share of its motor's force, as in gears under load."""
    for actuator in actuators(robot.model):
        if actuator.joint is None:
            continue
        full = abs(float(robot.model.actuator_gainprm[actuator.id, 0]) * float(robot.model.actuator_gear[actuator.id, 0]))

        def force(moment: Moment, sizes: Array, place: int = actuator.id, joint: Joint = actuator.joint, full: float = full) -> Array:
            out, speed = np.zeros_like(moment.qvel), moment.qvel[:, joint.velocity]
            out[:, joint.velocity] = -sizes[0] * full * np.abs(moment.ctrl[:, place]) * np.tanh(speed / ZERO)
            return out

        size = Quantity("share", "1", 0.0, 0.9, (5e-3, 0.05))
        yield Atom("joint_load_friction", actuator.joint.name, (size,), force=force)
