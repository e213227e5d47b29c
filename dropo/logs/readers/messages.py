"""Numbers inside messages: "position[elbow]", "pose.orientation.w", "header.stamp", out of ROS
messages and JSON objects.
"""

import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

STAMP = "header.stamp"
LOG_TIME = "log_time"
"""When the recorder received a message."""
LONGEST = 1024
"""A longer array inside a message (a picture) is no row of columns."""
_STEP = re.compile(r"([^.\[\]]+)|\[([^\]]*)\]")


def columns_of(message: Any) -> list[str]:
    """The paths of all numbers in a message; numbers beside a list `name` of the same length go by
    the names.
    """
    return [LOG_TIME, *_paths(message, "")]


def _paths(value: Any, path: str) -> list[str]:
    if _is_stamp(value) or isinstance(value, bool | int | float | np.number):
        return [path]
    if isinstance(value, str | bytes):
        return []
    if isinstance(value, np.ndarray | Sequence):
        return (
            [found for i, item in enumerate(value) for found in _paths(item, f"{path}[{i}]")]
            if len(value) <= LONGEST
            else []
        )
    names = _names(value)
    out = []
    for key, item in _members(value).items():
        inner = f"{path}.{key}" if path else key
        named = (
            names is not None
            and key != "name"
            and isinstance(item, np.ndarray | Sequence)
            and len(item) == len(names)
        )
        out += [f"{inner}[{name}]" for name in names or ()] if named else _paths(item, inner)
    return out


def _members(value: Any) -> dict[str, Any]:
    if isinstance(value, Mapping):
        return {str(key): item for key, item in value.items()}
    return {
        key: item for key, item in getattr(value, "__dict__", {}).items() if not key.startswith("_")
    }


def _names(value: Any) -> list[str] | None:
    """The names of a message such as sensor_msgs/JointState."""
    given = _get(value, "name")
    return (
        list(given)
        if isinstance(given, Sequence) and not isinstance(given, str) and len(given)
        else None
    )


def _get(value: Any, key: str) -> Any:
    return value.get(key) if isinstance(value, Mapping) else getattr(value, key, None)


def _is_stamp(value: Any) -> bool:
    return _get(value, "sec") is not None and (
        _get(value, "nanosec") is not None or _get(value, "nsec") is not None
    )


def getter(path: str) -> Callable[[Any], Any]:
    """A function from a message to the number at a path: NaN where it is not there, a date for a
    time stamp.
    """
    steps = [key or f"[{inside}]" for key, inside in _STEP.findall(path)]

    def get(message: Any) -> Any:
        value = message
        owner = None
        for step in steps:
            value, owner = (
                _item(value, owner, step[1:-1]) if step.startswith("[") else _get(value, step),
                value,
            )
            if value is None:
                return np.nan
        return _stamp(value) if _is_stamp(value) else value

    return get


def _item(value: Any, owner: Any, place: str) -> Any:
    """An element by its number, or by the names that stand beside the list."""
    names = _names(owner)
    if names is not None and place in names:
        place = str(names.index(place))
    return value[int(place)] if place.isdigit() and int(place) < len(value) else None


def _stamp(value: Any) -> np.datetime64:
    fraction = _get(value, "nanosec")
    return np.datetime64(
        int(_get(value, "sec")) * 10**9
        + int(_get(value, "nsec") if fraction is None else fraction),
        "ns",
    )
