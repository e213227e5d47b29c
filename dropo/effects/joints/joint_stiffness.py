"""Springs in joints."""

from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np

from dropo.core.contracts.effect import EffectContext, EffectInstance, Quantity, StepState
from dropo.core.services.validation import Array
from dropo.mjmodel.forces import torque_scale
from dropo.mjmodel.joints import Joint, joints


def joint_stiffness(context: EffectContext) -> Iterator[EffectInstance]:
    """A spring in a joint, about the model's own rest position or about one that a load moves.

    -k (q - r) about the model's rest position r; with the variant "rest", F - k (q - r) with a load
    F.
    """
    for joint in joints(context.model):
        scale = torque_scale(context.model, joint)
        base = float(context.model.jnt_stiffness[joint.id])
        sizes = [fraction * scale for fraction in (-0.05, -0.005, 0.005, 0.05)]
        probes = tuple(size for size in sizes if size >= -base)
        stiffness = Quantity("stiffness", joint.stiffness, -base, 5 * scale, probes, base=base)
        yield EffectInstance(
            "joint_stiffness", joint.name, (stiffness,), model=partial(_stiffen, joint)
        )
        load = Quantity("load", joint.force, -scale, scale, (0.01 * scale,))
        yield EffectInstance(
            "joint_stiffness", joint.name, (stiffness, load), "rest", force=partial(_spring, joint)
        )


def _stiffen(joint: Joint, model: Any, magnitudes: Array) -> None:
    """Adds to the stiffness of a joint."""
    model.jnt_stiffness[joint.id] += magnitudes[0]


def _spring(joint: Joint, state: StepState, magnitudes: Array) -> Array:
    """The force of the added spring and the load."""
    out = np.zeros_like(state.qvel)
    rest = state.model.qpos_spring[joint.qpos]
    out[:, joint.qvel] = magnitudes[1] - magnitudes[0] * (state.qpos[:, joint.qpos] - rest)
    return out
