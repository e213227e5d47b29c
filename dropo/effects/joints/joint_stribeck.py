"""Friction that falls with speed."""

from collections.abc import Iterator
from functools import partial

import numpy as np

from dropo.core.contracts.effect import EffectContext, EffectInstance, Quantity, StepState
from dropo.core.services.validation import Array
from dropo.mjmodel.dynamics.forces import torque_scale
from dropo.mjmodel.joints import Joint, joints

SIGN_WIDTH = 1e-2
"""The speed below which the sign of a speed fades out [rad/s, m/s]."""


def joint_stribeck(context: EffectContext) -> Iterator[EffectInstance]:
    """Dry friction of a joint that falls with its speed.

    -F exp(-(v / v_s)^2) tanh(v / 0.01), where v_s is to be found too.

    Parameters
    ----------
    context : EffectContext
        The robot for which instances are offered.

    Yields
    ------
    EffectInstance
        One for each joint, with F [N or N m] and the logarithm of v_s / 0.5.

    References
    ----------
    Stribeck 1902, Die wesentlichen Eigenschaften der Gleit- und Rollenlager.
    """
    for joint in joints(context.model):
        scale = torque_scale(context.model, joint)
        probes = (1e-3 * scale, 1e-2 * scale)
        friction = Quantity("friction", joint.force, 0.0, 0.5 * scale, probes)
        speed = Quantity("log(speed / 0.5)", "1", -3.0, 3.0, (-1.0, 1.0))
        trials = tuple(((probe, width),) for probe in probes for width in (-1.0, 0.0, 1.0))
        yield EffectInstance(
            "joint_stribeck",
            joint.name,
            (friction, speed),
            force=partial(_friction, joint),
            trials=trials,
            scaled=True,
        )


def _friction(joint: Joint, state: StepState, magnitudes: Array) -> Array:
    """The friction force at the present speeds."""
    out = np.zeros_like(state.qvel)
    speed = state.qvel[:, joint.qvel]
    width = 0.5 * np.exp(magnitudes[1])
    fading = np.exp(-((speed / width) ** 2))
    out[:, joint.qvel] = -magnitudes[0] * fading * np.tanh(speed / SIGN_WIDTH)
    return out
