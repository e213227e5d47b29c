"""Springs in joints."""

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np

from dropo.core.contracts.effect import EffectContext, EffectInstance, Quantity, StepState
from dropo.core.services.validation import Array
from dropo.mjmodel.dynamics.forces import torque_scale
from dropo.mjmodel.joints import Joint, joints

WEAKEST = 1e-6
"""Stiffness of a spring that stands for a load alone, as a fraction of the largest torque a rad."""


def joint_stiffness(context: EffectContext) -> Iterator[EffectInstance]:
    """A spring in a joint, about the model's own rest position or about one that a load moves.

    -k (q - r) about the model's rest position r; with the variant "rest", F - k (q - r) with a load
    F. Of a joint whose spring is linear both are numbers of the model: a load moves the rest
    position, and a load alone is that of a very weak spring with a rest position far away.

    Parameters
    ----------
    context : EffectContext
        The robot for which instances are offered.

    Yields
    ------
    EffectInstance
        Two for each joint: with k [N/m or N m/rad] alone, and the variant "rest" with k and F [N or
        N m].
    """
    model = context.model
    for joint in joints(model):
        scale = torque_scale(model, joint)
        base = float(model.jnt_stiffness[joint.id])
        sizes = [fraction * scale for fraction in (-0.05, -0.005, 0.005, 0.05)]
        probes = tuple(size for size in sizes if size >= -base)
        stiffness = Quantity("stiffness", joint.stiffness, -base, 5 * scale, probes, base=base)
        add = partial(_add_spring, joint, float(model.qpos_spring[joint.qpos]), WEAKEST * scale)
        yield EffectInstance(
            "joint_stiffness", joint.name, (stiffness,), model=partial(_stiffen, add)
        )
        load = Quantity("load", joint.force, -scale, scale, (0.01 * scale,))
        loaded = partial(EffectInstance, "joint_stiffness", joint.name, (stiffness, load), "rest")
        if np.any(model.jnt_stiffnesspoly[joint.id]) or np.any(model.jnt_springyield[joint.id]):
            yield loaded(force=partial(_spring, joint))
        else:
            yield loaded(model=partial(_load, add))


AddSpring = Callable[[Any, float, float], None]
"""Adds a spring and a load to a model."""


def _stiffen(add: AddSpring, model: Any, magnitudes: Array) -> None:
    """Adds to the stiffness of a joint."""
    add(model, magnitudes[0], 0.0)


def _load(add: AddSpring, model: Any, magnitudes: Array) -> None:
    """Adds to the stiffness of a joint, and a load."""
    add(model, magnitudes[0], magnitudes[1])


def _add_spring(
    joint: Joint, rest: float, weakest: float, model: Any, stiffness: float, load: float
) -> None:
    """Adds the force load - stiffness (q - rest) to that of a joint's spring."""
    now = float(model.qpos_spring[joint.qpos])
    before = float(model.jnt_stiffness[joint.id])
    model.jnt_stiffness[joint.id] = before + stiffness
    if load == 0 and now == rest:
        return
    total = max(before + stiffness, weakest)
    model.jnt_stiffness[joint.id] = total
    model.qpos_spring[joint.qpos] = rest + (before * (now - rest) + load) / total


def _spring(joint: Joint, state: StepState, magnitudes: Array) -> Array:
    """The force of the added spring and the load."""
    out = np.zeros_like(state.qvel)
    rest = state.model.qpos_spring[joint.qpos]
    out[:, joint.qvel] = magnitudes[1] - magnitudes[0] * (state.qpos[:, joint.qpos] - rest)
    return out
