"""Friction that grows with the load."""

from collections.abc import Iterator, Sequence
from functools import partial

import numpy as np

from dropo.core.contracts.effect import EffectContext, EffectInstance, Quantity, StepState
from dropo.core.services.validation import Array
from dropo.mjmodel.forces import motor_force, motors
from dropo.mjmodel.joints import Joint

SIGN_WIDTH = 1e-2
"""The speed below which the sign of a speed fades out [rad/s, m/s]."""


def joint_load_friction(context: EffectContext) -> Iterator[EffectInstance]:
    """Dry friction of a joint that is a fraction of its motors' force, as in gears under load.

    -s |F| tanh(v / 0.01)
    """
    for joint, ids in motors(context.model):
        fraction = Quantity("share", "1", 0.0, 0.9, (5e-3, 0.05))
        yield EffectInstance(
            "joint_load_friction", joint.name, (fraction,), force=partial(_friction, joint, ids)
        )


def _friction(joint: Joint, ids: Sequence[int], state: StepState, magnitudes: Array) -> Array:
    """The friction force in the present states."""
    out = np.zeros_like(state.qvel)
    load = np.abs(motor_force(state, joint, ids))
    sign = np.tanh(state.qvel[:, joint.qvel] / SIGN_WIDTH)
    out[:, joint.qvel] = -magnitudes[0] * load * sign
    return out
