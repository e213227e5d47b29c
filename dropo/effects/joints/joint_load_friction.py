"""Friction that grows with the load."""

from collections.abc import Iterator, Sequence
from functools import partial

import numpy as np

from dropo.core.contracts.effect import EffectContext, EffectInstance, Quantity, StepState
from dropo.core.services.validation import Array
from dropo.mjmodel.dynamics.forces import motor_force, motors
from dropo.mjmodel.joints import Joint


def joint_load_friction(context: EffectContext) -> Iterator[EffectInstance]:
    """Dry friction that grows by a fraction of the motors' force, as in gears under load.

    At most s |F|, which holds the joint where it rests.

    Parameters
    ----------
    context : EffectContext
        The robot for which instances are offered.

    Yields
    ------
    EffectInstance
        One for each joint with motors, with the pure number s.
    """
    for joint, ids in motors(context.model):
        fraction = Quantity("share", "1", 0.0, 0.9, (5e-3, 0.05))
        yield EffectInstance(
            "joint_load_friction", joint.name, (fraction,), friction=partial(_friction, joint, ids)
        )


def _friction(joint: Joint, ids: Sequence[int], state: StepState, magnitudes: Array) -> Array:
    """The largest friction in the present states."""
    out = np.zeros_like(state.qvel)
    out[:, joint.qvel] = magnitudes[0] * np.abs(motor_force(state, joint, ids))
    return out
