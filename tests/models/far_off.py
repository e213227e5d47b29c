"""The torque arm with rotor inertia that its model lacks, as a model that is far off."""

from dataclasses import replace

import numpy as np

from dropo.core.contracts.effect import instances_of
from dropo.diagnosis.far_off.model import FarOffModel
from dropo.diagnosis.far_off.motions import LongWindowSettings
from dropo.diagnosis.far_off.search import FarOffSettings
from dropo.diagnosis.regression.quick import sides
from tests.models.first_models import unknown_rotor

NONE = np.zeros(0, dtype=np.int64)
SETTINGS = FarOffSettings(
    laws=(),
    families=(("joint_armature",), ("actuator_bias",)),
    motions=LongWindowSettings(seconds=(0.1,), physics_steps=12_000),
)
"""A search of short windows and few kinds of effects."""


def torque_arm(*labels, problem=None):
    """Its model with effects, at 0, among its numbers; none of its parameters is fitted."""
    problem = problem or unknown_rotor()
    context = problem.simulator.effect_context
    numbers = []
    for label in labels:
        name = label.partition(":")[0]
        instance = next(one for one in instances_of(context, name) if one.label == label)
        numbers.append((instance, np.zeros(len(instance.quantities))))
    fitted, held_out = sides(problem, 0.2)
    divided = replace(problem, trajectories=fitted, held_out=held_out)
    return FarOffModel(divided, np.array(problem.simulator.nominal), NONE, tuple(numbers))
