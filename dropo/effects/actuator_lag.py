"""First-order lag between a command and its force."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from scipy.signal import lfilter

from dropo.core.checks import Array
from dropo.core.effect import Atom, Quantity, Robot
from dropo.effects.places import actuators


def actuator_lag(robot: Robot) -> Iterator[Atom]:
    """A first-order lag of an actuator, or of all of them alike: T dx/dt = u - x, exact for commands that are held."""
    found, dt = actuators(robot.model), robot.control_step
    places: list[tuple[str | None, list[int]]] = [(actuator.name, [actuator.id]) for actuator in found]
    if len(found) > 1:
        places.append((None, [actuator.id for actuator in found]))
    for target, ids in places:
        size = Quantity("time constant", "s", 0.0, 20 * dt, (0.02 * dt, 0.2 * dt, dt), smooth=False)
        yield Atom("actuator_lag", target, (size,), actuation=_lagged(ids))


def _lagged(ids: Sequence[int]) -> Any:
    """The mean over a physics step of the lagged command; it begins settled on the trajectory's first command."""

    def actuation(commands: Array, step: float, sizes: Array) -> Array:
        time = max(float(sizes[0]), 1e-12)
        keep = np.exp(-step / time)
        behind = commands[:, ids] - commands[:1, ids]
        before = lfilter([0.0, 1 - keep], [1.0, -keep], behind, axis=0) + commands[:1, ids]  # at the start of each step
        out = commands.copy()
        out[:, ids] = commands[:, ids] + (before - commands[:, ids]) * (1 - keep) * time / step
        return out

    return actuation
