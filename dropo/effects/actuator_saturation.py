"""A limit below the declared one."""

from collections.abc import Iterator

import numpy as np

from dropo.core.checks import Array
from dropo.core.effect import Atom, Quantity, Robot
from dropo.effects.places import actuators


def actuator_saturation(robot: Robot) -> Iterator[Atom]:
    """A limit of the command below the declared one, by a share of it; without a declared limit, of the largest command 1."""
    for actuator in actuators(robot.model):

        def command(commands: Array, sizes: Array, place: int = actuator.id, reach: float = actuator.reach) -> Array:
            limit = reach * (1 - sizes[0])
            out = commands.copy()
            out[:, place] = np.clip(commands[:, place], -limit, limit)
            return out

        size = Quantity("share", "1", 0.0, 0.99, (0.02, 0.1, 0.3), smooth=False)
        yield Atom("actuator_saturation", actuator.name, (size,), command=command)
