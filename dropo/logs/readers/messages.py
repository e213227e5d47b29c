"""Numbers inside ROS messages and JSON objects, such as "position[elbow]" or "header.stamp"."""

import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

STAMP = "header.stamp"
"""The message's own time stamp."""
LOG_TIME = "log_time"
"""When the recorder received a message."""
FRAME = "child_frame_id"
"""The name of a transform, by which it goes in place of its number."""
LONGEST = 1024
"""A longer array inside a message (a picture) is no row of columns."""
_STEP = re.compile(r"([^.\[\]]+)|\[([^\]]*)\]")


def columns_of(message: Any) -> list[str]:
    """List the paths of all numbers in a message.

    Parameters
    ----------
    message : object
        A ROS message, or what JSON holds.

    Returns
    -------
    list of str
        Such as "pose.orientation.w"; numbers beside a list `name` of the same length go by the
        names in it, such as "position[elbow]"; transforms by their frames, such as
        "transforms[base_link].transform.rotation.w".
    """
    return [LOG_TIME, *_paths(message, "")]


def _paths(value: Any, path: str) -> list[str]:
    """The paths of all numbers in a part of a message that stands at a path."""
    if _is_stamp(value) or isinstance(value, bool | int | float | np.number):
        return [path]
    if isinstance(value, str | bytes):
        return []
    if isinstance(value, np.ndarray | Sequence):
        return _list_paths(value, path)
    names = _names(value)
    out: list[str] = []
    for key, item in _members(value).items():
        inner = f"{path}.{key}" if path else key
        is_list = isinstance(item, np.ndarray | Sequence)
        if names is not None and key != "name" and is_list and len(item) == len(names):
            out += [f"{inner}[{name}]" for name in names]
        else:
            out += _paths(item, inner)
    return out


def _list_paths(values: Any, path: str) -> list[str]:
    """The paths of all numbers in a list, unless it is too long."""
    out: list[str] = []
    if len(values) <= LONGEST:
        for i, item in enumerate(values):
            frame = _get(item, FRAME)
            out += _paths(item, f"{path}[{i if frame is None else frame}]")
    return out


def _members(value: Any) -> dict[str, Any]:
    """The parts of a message by name."""
    if isinstance(value, Mapping):
        return {str(key): item for key, item in value.items()}
    members = getattr(value, "__dict__", {})
    return {key: item for key, item in members.items() if not key.startswith("_")}


def _names(value: Any) -> list[str] | None:
    """The names in a message such as sensor_msgs/JointState."""
    given = _get(value, "name")
    is_list = isinstance(given, Sequence) and not isinstance(given, str)
    return list(given) if is_list and len(given) else None


def _get(value: Any, key: str) -> Any:
    """A part of a message; None where it is not there."""
    return value.get(key) if isinstance(value, Mapping) else getattr(value, key, None)


def _is_stamp(value: Any) -> bool:
    """Whether a part of a message is a time stamp of ROS 1 or 2."""
    if _get(value, "sec") is None:
        return False
    return _get(value, "nanosec") is not None or _get(value, "nsec") is not None


def make_getter(path: str) -> Callable[[Any], Any]:
    """Make a function that takes the number at a path out of a message.

    Parameters
    ----------
    path : str
        As `columns_of` gives it.

    Returns
    -------
    callable
        From a message to the number: NaN where it is not there, a date for a time stamp.
    """
    steps = _STEP.findall(path)

    def get(message: Any) -> Any:
        value = message
        owner = None
        for key, place in steps:
            part = _get(value, key) if key else _item(value, owner, place)
            owner = value
            value = part
            if value is None:
                return np.nan
        return _stamp(value) if _is_stamp(value) else value

    return get


def _item(value: Any, owner: Any, place: str) -> Any:
    """An element by its number, or by the names that stand beside the list."""
    for item in value if _have_frames(value) else ():
        if _get(item, FRAME) == place:
            return item
    names = _names(owner)
    if names is not None and place in names:
        place = str(names.index(place))
    return value[int(place)] if place.isdigit() and int(place) < len(value) else None


def _have_frames(value: Any) -> bool:
    """Whether the elements of a list are of frames, as those of tf2_msgs/TFMessage."""
    is_list = isinstance(value, Sequence) and not isinstance(value, str | bytes)
    return is_list and len(value) > 0 and _get(value[0], FRAME) is not None


def _stamp(value: Any) -> np.datetime64:
    """A time stamp as a date."""
    fraction = _get(value, "nanosec")
    if fraction is None:
        fraction = _get(value, "nsec")
    return np.datetime64(int(_get(value, "sec")) * 10**9 + int(fraction), "ns")
