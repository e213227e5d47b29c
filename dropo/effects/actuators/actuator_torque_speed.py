"""Force that falls with speed."""

from collections.abc import Iterator, Sequence
from functools import partial

import numpy as np

from dropo.core.contracts.effect import EffectContext, EffectInstance, Quantity, StepState
from dropo.core.services.validation import Array
from dropo.mjmodel.dynamics.forces import motor_force, motors
from dropo.mjmodel.joints import Joint, actuators


def actuator_torque_speed(context: EffectContext) -> Iterator[EffectInstance]:
    """A motor whose force falls with the speed of its joint while it drives.

    F' = F max(1 - s |v|, 0) where F v > 0: the straight torque-speed line of a motor at constant
    voltage, with the no-load speed 1 / s.

    Parameters
    ----------
    context : EffectContext
        The robot for which instances are offered.

    Yields
    ------
    EffectInstance
        One for each actuator that drives a joint, with s in s/m or s/rad.
    """
    names = {actuator.id: actuator.name for actuator in actuators(context.model)}
    for joint, ids in motors(context.model):
        for i in ids:
            slope = Quantity("slope", f"s/{joint.length}", 0.0, 1.0, (2e-3, 0.02))
            yield EffectInstance(
                "actuator_torque_speed", names[i], (slope,), force=partial(_loss, joint, (i,))
            )


def _loss(joint: Joint, ids: Sequence[int], state: StepState, magnitudes: Array) -> Array:
    """The generalised force that is lost."""
    out = np.zeros_like(state.qvel)
    speed = state.qvel[:, joint.qvel]
    drive = motor_force(state, joint, ids)
    loss = -np.minimum(magnitudes[0] * np.abs(speed), 1.0) * drive
    out[:, joint.qvel] = np.where(drive * speed > 0, loss, 0.0)
    return out
