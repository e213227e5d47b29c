"""Springs in joints."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from dropo.core.checks import Array
from dropo.core.effect import Atom, Moment, Quantity, Robot
from dropo.effects.places import Joint, joints, torque_scale


def joint_stiffness(robot: Robot) -> Iterator[Atom]:
    """A spring in a joint: about the model's own rest position, or with a load there, which moves its rest position."""
    for joint in joints(robot.model):
        scale, base = torque_scale(robot.model, joint), float(robot.model.jnt_stiffness[joint.id])
        probes = tuple(share * scale for share in (-0.05, -0.005, 0.005, 0.05) if share * scale >= -base)
        stiffness = Quantity("stiffness", joint.stiffness, -base, 5 * scale, probes, base=base)

        def model(model: Any, sizes: Array, joint: Joint = joint) -> None:
            model.jnt_stiffness[joint.id] += sizes[0]

        def force(
            moment: Moment, sizes: Array, joint: Joint = joint, rest: float = float(robot.model.qpos_spring[joint.position])
        ) -> Array:
            out = np.zeros_like(moment.qvel)
            out[:, joint.velocity] = sizes[1] - sizes[0] * (moment.qpos[:, joint.position] - rest)
            return out

        yield Atom("joint_stiffness", joint.name, (stiffness,), model=model)
        load = Quantity("load", joint.force, -scale, scale, (0.01 * scale,))
        yield Atom("joint_stiffness", joint.name, (stiffness, load), "rest", force=force)
