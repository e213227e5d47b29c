"""A constant offset of a command."""

from collections.abc import Iterator
from functools import partial

from dropo.core.contracts.effect import Atom, Quantity, Robot
from dropo.core.services.validation import Array
from dropo.effects.support.places import actuators


def actuator_bias(robot: Robot) -> Iterator[Atom]:
    """A constant that is added to an actuator's command after it was clamped: u' = u + b."""
    for actuator in actuators(robot.model):
        reach = actuator.reach
        size = Quantity("bias", "command", -reach, reach, (-0.03 * reach, -0.003 * reach, 0.003 * reach, 0.03 * reach))
        yield Atom("actuator_bias", actuator.name, (size,), actuation=partial(_shift, actuator.id))


def _shift(place: int, commands: Array, step: float, sizes: Array) -> Array:
    out = commands.copy()
    out[:, place] += sizes[0]
    return out
