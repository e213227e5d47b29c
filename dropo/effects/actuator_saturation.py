"""A limit below the declared one."""

from collections.abc import Iterator
from functools import partial

import numpy as np

from dropo.core.contracts.effect import EffectContext, EffectInstance, Quantity
from dropo.core.services.validation import Array
from dropo.mjmodel.joints import actuators


def actuator_saturation(context: EffectContext) -> Iterator[EffectInstance]:
    """A limit of the command below the declared one, |u| <= (1 - s) u_max; of an actuator without
    one, |u| <= 1 / s.
    """
    for actuator in actuators(context.model):
        if context.model.actuator_ctrllimited[actuator.id]:
            size = Quantity("share", "1", 0.0, 0.99, (0.02, 0.1, 0.3), smooth=False)
            yield EffectInstance(
                "actuator_saturation",
                actuator.name,
                (size,),
                command=partial(_lower, actuator.id, actuator.largest_command),
            )
        else:
            size = Quantity(
                "1 / limit", "1/command", 0.0, 100.0, (0.5, 1.0, 2.0, 10.0), smooth=False
            )
            yield EffectInstance(
                "actuator_saturation", actuator.name, (size,), command=partial(_limit, actuator.id)
            )


def _lower(place: int, reach: float, commands: Array, magnitudes: Array) -> Array:
    out = commands.copy()
    out[:, place] = np.clip(
        commands[:, place], -reach * (1 - magnitudes[0]), reach * (1 - magnitudes[0])
    )
    return out


def _limit(place: int, commands: Array, magnitudes: Array) -> Array:
    out = commands.copy()
    out[:, place] = np.clip(commands[:, place], -1 / magnitudes[0], 1 / magnitudes[0])
    return out
