"""The places of a robot at which several effects are offered."""

from collections.abc import Sequence

from dropo.mjmodel.joints import Actuator

LARGE_SENSOR_ERRORS = {"m": 0.05, "rad": 0.1, "m/s": 0.5, "rad/s": 1.0, "m/s^2": 1.0}
"""Large errors of a sensor, by its unit."""


def each_and_all(found: Sequence[Actuator]) -> list[tuple[str | None, tuple[int, ...]]]:
    """List every actuator, and all together where there are several.

    Parameters
    ----------
    found : sequence of Actuator
        The actuators.

    Returns
    -------
    list of (str or None, tuple of int)
        The target of an effect (None for all actuators), and the actuators' ids.
    """
    places: list[tuple[str | None, tuple[int, ...]]] = []
    for actuator in found:
        places.append((actuator.name, (actuator.id,)))
    if len(found) > 1:
        places.append((None, tuple(actuator.id for actuator in found)))
    return places


def is_rotation(signal: str) -> bool:
    """Return whether a signal is one of the three numbers of an orientation.

    Parameters
    ----------
    signal : str
        Its name, such as "qpos.torso.rx".

    Returns
    -------
    bool
        True where the name ends in rx, ry or rz and is of a position or a sensor.
    """
    return signal.startswith(("qpos", "sensordata")) and signal.endswith((".rx", ".ry", ".rz"))
