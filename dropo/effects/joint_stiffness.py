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
    """A spring in a joint: -k (q - r) about the model's own rest position r, or F - k (q - r) with
    a load F, which moves it.
    """
    for joint in joints(context.model):
        scale = torque_scale(context.model, joint)
        base = float(context.model.jnt_stiffness[joint.id])
        probes = tuple(
            share * scale for share in (-0.05, -0.005, 0.005, 0.05) if share * scale >= -base
        )
        stiffness = Quantity("stiffness", joint.stiffness, -base, 5 * scale, probes, base=base)
        yield EffectInstance(
            "joint_stiffness", joint.name, (stiffness,), model=partial(_stiffen, joint)
        )
        load = Quantity("load", joint.force, -scale, scale, (0.01 * scale,))
        yield EffectInstance(
            "joint_stiffness", joint.name, (stiffness, load), "rest", force=partial(_spring, joint)
        )


def _stiffen(joint: Joint, model: Any, magnitudes: Array) -> None:
    model.jnt_stiffness[joint.id] += magnitudes[0]


def _spring(joint: Joint, state: StepState, magnitudes: Array) -> Array:
    out = np.zeros_like(state.qvel)
    rest = state.model.qpos_spring[joint.qpos]
    out[:, joint.qvel] = magnitudes[1] - magnitudes[0] * (state.qpos[:, joint.qpos] - rest)
    return out
