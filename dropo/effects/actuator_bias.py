"""A constant offset of a command."""

from collections.abc import Iterator
from functools import partial

from dropo.core.contracts.effect import EffectContext, EffectInstance, Quantity
from dropo.core.services.validation import Array
from dropo.mjmodel.joints import actuators


def actuator_bias(context: EffectContext) -> Iterator[EffectInstance]:
    """A constant that is added to an actuator's command after it was clamped: u' = u + b."""
    for actuator in actuators(context.model):
        reach = actuator.largest_command
        size = Quantity(
            "bias",
            "command",
            -reach,
            reach,
            (-0.03 * reach, -0.003 * reach, 0.003 * reach, 0.03 * reach),
        )
        yield EffectInstance(
            "actuator_bias", actuator.name, (size,), actuation=partial(_shift, actuator.id)
        )


def _shift(place: int, commands: Array, step: float, magnitudes: Array) -> Array:
    out = commands.copy()
    out[:, place] += magnitudes[0]
    return out
