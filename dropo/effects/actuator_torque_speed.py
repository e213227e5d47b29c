"""Force that falls with speed."""

from collections.abc import Iterator, Sequence
from functools import partial

import numpy as np

from dropo.core.contracts.effect import Atom, Moment, Quantity, Robot
from dropo.core.services.validation import Array
from dropo.effects.support.places import Joint, actuators, motor_force, motors


def actuator_torque_speed(robot: Robot) -> Iterator[Atom]:
    """A motor whose force falls with speed while it drives: F' = F max(1 - s |v|, 0) where F v > 0, v the joint's speed.

    The straight torque-speed line of a motor at constant voltage; its no-load speed is 1 / s.
    """
    names = {actuator.id: actuator.name for actuator in actuators(robot.model)}
    for joint, ids in motors(robot.model):
        for i in ids:
            size = Quantity("slope", f"s/{joint.length}", 0.0, 1.0, (2e-3, 0.02))
            yield Atom("actuator_torque_speed", names[i], (size,), force=partial(_loss, joint, (i,)))


def _loss(joint: Joint, ids: Sequence[int], moment: Moment, sizes: Array) -> Array:
    out, speed, drive = np.zeros_like(moment.qvel), moment.qvel[:, joint.velocity], motor_force(moment, joint, ids)
    out[:, joint.velocity] = np.where(drive * speed > 0, -np.minimum(sizes[0] * np.abs(speed), 1.0) * drive, 0.0)
    return out
