"""A limit below the declared one."""

from collections.abc import Iterator
from functools import partial

import numpy as np

from dropo.core.contracts.effect import EffectContext, EffectInstance, Quantity
from dropo.core.services.validation import Array
from dropo.mjmodel.joints import actuators


def actuator_saturation(context: EffectContext) -> Iterator[EffectInstance]:
    """A limit of an actuator's command below the declared one.

    |u| <= (1 - s) u_max; of an actuator without a declared limit |u| <= 1 / s.

    Parameters
    ----------
    context : EffectContext
        The robot for which instances are offered.

    Yields
    ------
    EffectInstance
        One for each actuator, with the pure number s; of one without a declared limit s is in units
        of 1 / command.
    """
    for actuator in actuators(context.model):
        if context.model.actuator_ctrllimited[actuator.id]:
            loss = Quantity("share", "1", 0.0, 0.99, (0.02, 0.1, 0.3), smooth=False)
            change = partial(_lower, actuator.id, actuator.largest_command)
        else:
            probes = (0.5, 1.0, 2.0, 10.0)
            loss = Quantity("1 / limit", "1/command", 0.0, 100.0, probes, smooth=False)
            change = partial(_limit, actuator.id)
        yield EffectInstance("actuator_saturation", actuator.name, (loss,), command=change)


def _lower(place: int, largest: float, commands: Array, magnitudes: Array) -> Array:
    """Clips the commands of one actuator to a fraction of the largest."""
    limit = largest * (1 - magnitudes[0])
    out = commands.copy()
    out[:, place] = np.clip(commands[:, place], -limit, limit)
    return out


def _limit(place: int, commands: Array, magnitudes: Array) -> Array:
    """Clips the commands of one actuator to the inverse of the magnitude."""
    out = commands.copy()
    out[:, place] = np.clip(commands[:, place], -1 / magnitudes[0], 1 / magnitudes[0])
    return out
