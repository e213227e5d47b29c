"""Force that falls with speed."""

from collections.abc import Iterator

import numpy as np

from dropo.core.checks import Array
from dropo.core.effect import Atom, Moment, Quantity, Robot
from dropo.effects.places import Joint, actuators


def actuator_torque_speed(robot: Robot) -> Iterator[Atom]:
    """A motor whose force falls with speed while it drives: times 1 - slope |v|, v the joint's speed; never below 0."""
    for actuator in actuators(robot.model):
        if actuator.joint is None:
            continue

        def drive(moment: Moment, sizes: Array, place: int = actuator.id, joint: Joint = actuator.joint) -> Array:
            out, speed = moment.ctrl.copy(), moment.qvel[:, joint.velocity]
            driving = out[:, place] * speed > 0
            out[:, place] *= np.where(driving, np.maximum(1 - sizes[0] * np.abs(speed), 0.0), 1.0)
            return out

        size = Quantity("slope", f"s/{actuator.joint.length}", 0.0, 1.0, (2e-3, 0.02))
        yield Atom("actuator_torque_speed", actuator.name, (size,), drive=drive)
