"""A constant offset of a command."""

from collections.abc import Iterator
from functools import partial

from dropo.core.contracts.effect import EffectContext, EffectInstance, Quantity
from dropo.core.services.validation import Array
from dropo.mjmodel.joints import actuators


def actuator_bias(context: EffectContext) -> Iterator[EffectInstance]:
    """A constant that is added to an actuator's command, after the command was clamped.

    u' = u + b

    Parameters
    ----------
    context : EffectContext
        The robot for which instances are offered.

    Yields
    ------
    EffectInstance
        One for each actuator, with b in units of its command.
    """
    for actuator in actuators(context.model):
        largest = actuator.largest_command
        probes = tuple(fraction * largest for fraction in (-0.03, -0.003, 0.003, 0.03))
        bias = Quantity("bias", "command", -largest, largest, probes)
        yield EffectInstance(
            "actuator_bias", actuator.name, (bias,), actuation=partial(_shift, actuator.id)
        )


def _shift(place: int, commands: Array, step: float, magnitudes: Array) -> Array:
    """Adds the bias to the commands of one actuator."""
    out = commands.copy()
    out[:, place] += magnitudes[0]
    return out
