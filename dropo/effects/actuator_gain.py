"""The gain of an actuator."""

from collections.abc import Iterator, Sequence
from typing import Any

from dropo.core.checks import Array
from dropo.core.effect import Atom, Quantity, Robot
from dropo.effects.places import actuators


def actuator_gain(robot: Robot) -> Iterator[Atom]:
    """The gain of an actuator, or of all of them alike, with its feedback terms: its whole force by one factor."""
    found = actuators(robot.model)
    places: list[tuple[str | None, list[int]]] = [(actuator.name, [actuator.id]) for actuator in found]
    if len(found) > 1:
        places.append((None, [actuator.id for actuator in found]))
    for target, ids in places:
        gain = Quantity("gain", "1", -0.9, 4.0, (-0.05, -0.01, 0.01, 0.05), relative=True)
        yield Atom("actuator_gain", target, (gain,), model=_scale(ids))


def _scale(ids: Sequence[int]) -> Any:
    def model(model: Any, sizes: Array) -> None:
        model.actuator_gainprm[ids, :3] *= 1 + sizes[0]
        model.actuator_biasprm[ids, :3] *= 1 + sizes[0]

    return model
