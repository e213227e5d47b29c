"""Friction that falls with speed."""

from collections.abc import Iterator
from functools import partial

import numpy as np

from dropo.core.contracts.effect import EffectContext, EffectInstance, Quantity, StepState
from dropo.core.services.validation import Array
from dropo.mjmodel.forces import torque_scale
from dropo.mjmodel.joints import Joint, joints

ZERO = 1e-2  # [rad/s, m/s] below which the sign of a speed fades out


def joint_stribeck(context: EffectContext) -> Iterator[EffectInstance]:
    """Dry friction that falls with speed: -F exp(-(v / v_s)^2) tanh(v / 0.01) (Stribeck 1902), with
    v_s to be found.
    """
    for joint in joints(context.model):
        scale = torque_scale(context.model, joint)
        size = Quantity("friction", joint.force, 0.0, 0.5 * scale, (1e-3 * scale, 1e-2 * scale))
        speed = Quantity("log(speed / 0.5)", "1", -3.0, 3.0, (-1.0, 1.0))
        trials = tuple(
            ((share * scale, width),) for share in (1e-3, 1e-2) for width in (-1.0, 0.0, 1.0)
        )
        yield EffectInstance(
            "joint_stribeck", joint.name, (size, speed), force=partial(_rub, joint), trials=trials
        )


def _rub(joint: Joint, state: StepState, magnitudes: Array) -> Array:
    out = np.zeros_like(state.qvel)
    speed = state.qvel[:, joint.qvel]
    width = 0.5 * np.exp(magnitudes[1])
    out[:, joint.qvel] = -magnitudes[0] * np.exp(-((speed / width) ** 2)) * np.tanh(speed / ZERO)
    return out
