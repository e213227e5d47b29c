"""Torque that repeats with the angle."""

from collections.abc import Iterator
from functools import partial

import numpy as np

from dropo.core.contracts.effect import EffectContext, EffectInstance, Quantity, StepState
from dropo.core.services.validation import Array
from dropo.mjmodel.dynamics.forces import torque_scale
from dropo.mjmodel.joints import Joint, actuators

COGS = (6, 7, 8, 10, 12, 14, 16, 18, 20, 21, 24, 28, 30, 36, 42, 48)
"""The numbers of cogs a turn that are offered."""


def joint_cogging(context: EffectContext) -> Iterator[EffectInstance]:
    """Torque of a driven hinge that repeats with its angle, as of a motor's cogs.

    a sin(n q) + b cos(n q), for each of some numbers n of cogs a turn; the variant names n.

    Parameters
    ----------
    context : EffectContext
        The robot for which instances are offered.

    Yields
    ------
    EffectInstance
        One for each driven hinge and number n of cogs, with a and b in N m.
    """
    driven = {
        actuator.joint.id: actuator.joint
        for actuator in actuators(context.model)
        if actuator.joint is not None
    }
    for joint in driven.values():
        if joint.kind != "hinge":
            continue
        scale = torque_scale(context.model, joint)
        parts = tuple(
            Quantity(name, joint.force, -scale, scale, (0.01 * scale,))
            for name in ("sine", "cosine")
        )
        for cogs in COGS:
            yield EffectInstance(
                "joint_cogging",
                joint.name,
                parts,
                f"{cogs}-a-turn",
                force=partial(_torque, joint, cogs),
                order=cogs,
            )


def _torque(joint: Joint, cogs: int, state: StepState, magnitudes: Array) -> Array:
    """The torque at the present angles."""
    out = np.zeros_like(state.qvel)
    angle = cogs * state.qpos[:, joint.qpos]
    out[:, joint.qvel] = magnitudes[0] * np.sin(angle) + magnitudes[1] * np.cos(angle)
    return out
