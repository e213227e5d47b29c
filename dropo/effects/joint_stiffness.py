"""Springs in joints."""

from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np

from dropo.core.contracts.effect import Atom, Moment, Quantity, Robot
from dropo.core.services.validation import Array
from dropo.effects.support.places import Joint, joints, torque_scale


def joint_stiffness(robot: Robot) -> Iterator[Atom]:
    """A spring in a joint: -k (q - r) about the model's own rest position r, or F - k (q - r) with a load F, which moves it."""
    for joint in joints(robot.model):
        scale, base = torque_scale(robot.model, joint), float(robot.model.jnt_stiffness[joint.id])
        probes = tuple(share * scale for share in (-0.05, -0.005, 0.005, 0.05) if share * scale >= -base)
        stiffness = Quantity("stiffness", joint.stiffness, -base, 5 * scale, probes, base=base)
        yield Atom("joint_stiffness", joint.name, (stiffness,), model=partial(_stiffen, joint))
        load = Quantity("load", joint.force, -scale, scale, (0.01 * scale,))
        yield Atom("joint_stiffness", joint.name, (stiffness, load), "rest", force=partial(_spring, joint))


def _stiffen(joint: Joint, model: Any, sizes: Array) -> None:
    model.jnt_stiffness[joint.id] += sizes[0]


def _spring(joint: Joint, moment: Moment, sizes: Array) -> Array:
    out, rest = np.zeros_like(moment.qvel), moment.model.qpos_spring[joint.position]
    out[:, joint.velocity] = sizes[1] - sizes[0] * (moment.qpos[:, joint.position] - rest)
    return out
