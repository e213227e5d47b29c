"""Commands that are lost around zero or around a reversal."""

from collections.abc import Iterator
from functools import partial

import numpy as np

from dropo.core.contracts.effect import EffectContext, EffectInstance, Quantity
from dropo.core.services.validation import Array
from dropo.effects.support.play_operator import play
from dropo.mjmodel.joints import actuators


def actuator_deadband(context: EffectContext) -> Iterator[EffectInstance]:
    """Commands that are lost around zero (a dead zone), or around a reversal (backlash).

    Dead zone: u' = sign(u) max(|u| - w, 0). Backlash: the command moves the actuator through play
    of width w, which begins in its middle at the trajectory's first command. Both come before the
    command is clamped.

    Parameters
    ----------
    context : EffectContext
        The robot for which instances are offered.

    Yields
    ------
    EffectInstance
        Two for each actuator, with w in units of its command: the dead zone, and the variant
        "backlash".
    """
    for actuator in actuators(context.model):
        largest = actuator.largest_command
        probes = (0.01 * largest, 0.05 * largest)
        width = Quantity("width", "command", 0.0, largest, probes, smooth=False)
        for variant, hook in (("", _dead_zone), ("backlash", _backlash)):
            change = partial(hook, actuator.id)
            yield EffectInstance(
                "actuator_deadband", actuator.name, (width,), variant, command=change
            )


def _dead_zone(place: int, commands: Array, magnitudes: Array) -> Array:
    """Cuts the width off the commands of one actuator, towards zero."""
    out = commands.copy()
    column = commands[:, place]
    out[:, place] = np.sign(column) * np.maximum(np.abs(column) - magnitudes[0], 0)
    return out


def _backlash(place: int, commands: Array, magnitudes: Array) -> Array:
    """Passes the commands of one actuator through play."""
    out = commands.copy()
    out[:, place] = play(commands[:, place], float(magnitudes[0]), float(commands[0, place]))
    return out
