"""Dead time between a command and its force."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from dropo.core.checks import Array
from dropo.core.effect import Atom, Quantity, Robot
from dropo.effects.places import actuators


def actuator_delay(robot: Robot) -> Iterator[Atom]:
    """Dead time of an actuator, or of all of them alike; fractions of a physics step are interpolated.

    Before a trajectory begins, its first command is taken to have been held.
    """
    found, dt = actuators(robot.model), robot.control_step
    places: list[tuple[str | None, list[int]]] = [(actuator.name, [actuator.id]) for actuator in found]
    if len(found) > 1:
        places.append((None, [actuator.id for actuator in found]))
    for target, ids in places:
        size = Quantity("delay", "s", 0.0, 10 * dt, (0.02 * dt, 0.25 * dt, dt, 2 * dt, 3 * dt), smooth=False)
        yield Atom("actuator_delay", target, (size,), actuation=_delayed(ids), alike=() if target else ("sensor_delay",))


def _delayed(ids: Sequence[int]) -> Any:
    def actuation(commands: Array, step: float, sizes: Array) -> Array:
        whole, part = divmod(sizes[0] / step, 1.0)
        out = commands.copy()
        rows = np.arange(len(commands)) - int(whole)
        out[:, ids] = (1 - part) * commands[np.maximum(rows, 0)][:, ids] + part * commands[np.maximum(rows - 1, 0)][:, ids]
        return out

    return actuation
