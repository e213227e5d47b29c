"""Friction that grows with the load."""

from collections.abc import Iterator, Sequence
from functools import partial

import numpy as np

from dropo.core.contracts.effect import EffectContext, EffectInstance, Quantity, StepState
from dropo.core.services.validation import Array
from dropo.mjmodel.forces import motor_force, motors
from dropo.mjmodel.joints import Joint

ZERO = 1e-2  # [rad/s, m/s] below which the sign of a speed fades out


def joint_load_friction(context: EffectContext) -> Iterator[EffectInstance]:
    """Dry friction of a joint that is a share of its motors' force, as in gears under load: -s |F|
    tanh(v / 0.01).
    """
    for joint, ids in motors(context.model):
        size = Quantity("share", "1", 0.0, 0.9, (5e-3, 0.05))
        yield EffectInstance(
            "joint_load_friction", joint.name, (size,), force=partial(_rub, joint, ids)
        )


def _rub(joint: Joint, ids: Sequence[int], state: StepState, magnitudes: Array) -> Array:
    out = np.zeros_like(state.qvel)
    out[:, joint.qvel] = (
        -magnitudes[0]
        * np.abs(motor_force(state, joint, ids))
        * np.tanh(state.qvel[:, joint.qvel] / ZERO)
    )
    return out
