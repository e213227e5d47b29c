"""Commands that are lost around zero or around a reversal."""

from collections.abc import Iterator

import numpy as np

from dropo.core.checks import Array
from dropo.core.effect import Atom, Quantity, Robot
from dropo.effects.places import actuators


def actuator_deadband(robot: Robot) -> Iterator[Atom]:
    """A dead zone around zero, by which commands also become smaller; or backlash: play of the command at each reversal."""
    for actuator in actuators(robot.model):

        def zone(commands: Array, sizes: Array, place: int = actuator.id) -> Array:
            out = commands.copy()
            out[:, place] = np.sign(out[:, place]) * np.maximum(np.abs(out[:, place]) - sizes[0], 0)
            return out

        def play(commands: Array, sizes: Array, place: int = actuator.id) -> Array:
            out = commands.copy()
            out[:, place] = _play(commands[:, place], sizes[0])
            return out

        reach = actuator.reach
        for variant, hook in (("", zone), ("backlash", play)):
            size = Quantity("width", "command", 0.0, reach, (0.01 * reach, 0.05 * reach), smooth=False)
            yield Atom("actuator_deadband", actuator.name, (size,), variant, command=hook)


def _play(commands: Array, width: float) -> Array:
    """The play operator (Krasnosel'skii and Pokrovskii 1989): follows the command once half the width is taken up."""
    out = np.empty_like(commands)
    now = commands[0] if len(commands) else 0.0
    for t, wanted in enumerate(commands):
        now = min(max(now, wanted - width / 2), wanted + width / 2)
        out[t] = now
    return out
