"""A command that also acts elsewhere."""

from collections.abc import Iterator

from dropo.core.checks import Array
from dropo.core.effect import Atom, Quantity, Robot
from dropo.effects.places import actuators


def actuator_coupling(robot: Robot) -> Iterator[Atom]:
    """A share of an actuator's command that also reaches another actuator; the variant names that one."""
    found = actuators(robot.model)
    for source in found:
        for other in found:
            if source.id == other.id:
                continue

            def actuation(commands: Array, step: float, sizes: Array, one: int = source.id, two: int = other.id) -> Array:
                out = commands.copy()
                out[:, two] += sizes[0] * commands[:, one]
                return out

            size = Quantity("share", "1", -1.0, 1.0, (-0.05, -0.005, 0.005, 0.05))
            yield Atom("actuator_coupling", source.name, (size,), f"on-{other.name}", actuation=actuation)
