"""What several effects say of the places where they can be."""

from collections.abc import Sequence

from dropo.mjmodel.joints import Actuator

SENSOR_SIZES = {"m": 0.05, "rad": 0.1, "m/s": 0.5, "rad/s": 1.0}
"""Large errors of a sensor, by its unit."""


def each_and_all(found: Sequence[Actuator]) -> list[tuple[str | None, tuple[int, ...]]]:
    """(target, ids) of every actuator, and of all together where there are several."""
    each: list[tuple[str | None, tuple[int, ...]]] = []
    each += [(actuator.name, (actuator.id,)) for actuator in found]
    if len(found) > 1:
        each.append((None, tuple(actuator.id for actuator in found)))
    return each


def is_rotation(signal: str) -> bool:
    """Whether a signal is one of the three numbers of an orientation."""
    return signal.startswith("qpos") and signal.endswith((".rx", ".ry", ".rz"))
