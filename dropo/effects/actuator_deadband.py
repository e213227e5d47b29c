"""Commands that are lost around zero or around a reversal."""

from collections.abc import Iterator
from functools import partial

import numpy as np

from dropo.core.contracts.effect import EffectContext, EffectInstance, Quantity
from dropo.core.services.validation import Array
from dropo.effects.support.play_operator import play
from dropo.mjmodel.joints import actuators


def actuator_deadband(context: EffectContext) -> Iterator[EffectInstance]:
    """A dead zone around zero, u' = sign(u) max(|u| - w, 0); or backlash: the command moves the
    actuator by play of width w.

    Both come before the command is clamped. Play begins in its middle, at the trajectory's first
    command.
    """
    for actuator in actuators(context.model):
        reach = actuator.largest_command
        for variant, hook in (("", _zone), ("backlash", _backlash)):
            size = Quantity(
                "width", "command", 0.0, reach, (0.01 * reach, 0.05 * reach), smooth=False
            )
            yield EffectInstance(
                "actuator_deadband",
                actuator.name,
                (size,),
                variant,
                command=partial(hook, actuator.id),
            )


def _zone(place: int, commands: Array, magnitudes: Array) -> Array:
    out = commands.copy()
    out[:, place] = np.sign(out[:, place]) * np.maximum(np.abs(out[:, place]) - magnitudes[0], 0)
    return out


def _backlash(place: int, commands: Array, magnitudes: Array) -> Array:
    out = commands.copy()
    out[:, place] = play(commands[:, place], float(magnitudes[0]), float(commands[0, place]))
    return out
