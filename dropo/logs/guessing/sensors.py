"""Which columns of a log are gyros, accelerometers and orientations, and of which sensor."""

from collections.abc import Sequence
from dataclasses import dataclass

from dropo.logs.guessing.words import ColumnName, tokens
from dropo.mjmodel.joints import ModelJoints
from dropo.mjmodel.names import element_name
from dropo.mjmodel.sensors import Sensor

GYRO = "gyro"
ACCELEROMETER = "accelerometer"
ORIENTATION = "framequat"
"""Kinds of sensors that columns are known as by their words."""
_GYRO = {"gyro", "gyroscope", "gyr", "gyros", "angvel", "omega"}
_ACCELEROMETER = {"acc", "accel", "accelerometer", "acceleration", "accelerations"}
_ORIENTATION = {"quat", "quaternion", "orientation", "quats"}
_NONE = {"covariance", "cmd", "command", "target", "goal", "des", "desired", "joint", "mag"}
"""Words of columns that are no sensor's numbers."""
_SHORT = {"a": ACCELEROMETER, "g": GYRO, "w": GYRO}
"""First letters of "ax", "gy", "wz"."""
_UNIT_WORDS = {
    "rad/s": {"rad", "rads", "radps"},
    "deg/s": {"deg", "degs", "dps", "degps"},
    "mg": {"mg"},
    "g": {"g", "gs", "gee"},
    "m/s^2": {"m", "mps", "ms"},
}
_TRAILING = {word for unit in _UNIT_WORDS.values() for word in unit} | {
    "s",
    "s2",
    "ss",
    "per",
    "sec",
    "2",
}
_BY_NAME = ("touch", "force", "torque", "velocimeter", "magnetometer", "rangefinder")
_PLACES = {"qw": "w", "qx": "x", "qy": "y", "qz": "z"}


@dataclass(frozen=True)
class SensorColumns:
    """Columns that belong together as the numbers of one sensor.

    Attributes
    ----------
    kind : str
        "gyro", "accelerometer" or "framequat".
    columns : tuple of ColumnName
        Along x, y, z, or w, x, y, z of an orientation.
    words : frozenset of str
        Of their names and topic.
    unit : str or None
        The unit that a word names.
    is_named : bool
        Whether the names give the order of an orientation's four numbers.
    """

    kind: str
    columns: tuple[ColumnName, ...]
    words: frozenset[str]
    unit: str | None = None
    is_named: bool = True


def find_sensor_columns(columns: Sequence[ColumnName]) -> list[SensorColumns]:
    """Find the columns of gyros, accelerometers and orientations by their names.

    Parameters
    ----------
    columns : sequence of ColumnName
        All columns of a log.

    Returns
    -------
    list of SensorColumns
        In the order of the log.
    """
    groups: dict[tuple[str, ...], dict[str, ColumnName]] = {}
    units: dict[tuple[str, ...], list[str]] = {}
    for column in columns:
        key, place, trailing = _read(column)
        if place and column.quantity != "time":
            groups.setdefault(key, {}).setdefault(place, column)
            units[key] = trailing
    found = []
    for key, parts in groups.items():
        kind = _kind(key)
        order = sorted(parts)
        if kind is None:
            continue
        is_named = not order[0].isdigit()
        if kind == ORIENTATION:
            fits = order in (["w", "x", "y", "z"], ["0", "1", "2", "3"])
        else:
            fits = order in (["x", "y", "z"], ["0", "1", "2"])
        if fits:
            listed = tuple(parts[place] for place in order)
            unit = _unit(kind, [*key, *units[key]])
            found.append(SensorColumns(kind, listed, frozenset(key), unit, is_named))
    return found


def _read(column: ColumnName) -> tuple[tuple[str, ...], str, list[str]]:
    """The words of a column that its like share, its place among these, and words of units."""
    words = tokens(column.column)
    above = tuple(tokens(column.topic or column.file or ""))
    for i in range(len(words) - 1, -1, -1):
        word = words[i]
        if word in ("x", "y", "z", "w") or word in _PLACES:
            mark = ("quat",) if word in _PLACES else ()
            return (*above, *words[:i], *mark), _PLACES.get(word, word), words[i + 1 :]
        if len(word) == 2 and word[0] in _SHORT and word[1] in "xyz":
            return (*above, *words[:i], _SHORT[word[0]]), word[1], words[i + 1 :]
        if word not in _TRAILING:
            break
    if words and words[-1].isdigit():
        return (*above, *words[:-1]), words[-1], []
    return above, "", []


def _kind(key: Sequence[str]) -> str | None:
    """The kind of sensor that words are of."""
    words = set(key)
    if words & _NONE:
        return None
    if words & _ORIENTATION:
        return ORIENTATION
    is_rate = "angular" in words and bool(words & {"velocity", "vel", "rate", "speed", "rates"})
    if words & _GYRO or is_rate:
        return GYRO
    if (words & _ACCELEROMETER and "angular" not in words) or ACCELEROMETER in words:
        return ACCELEROMETER
    return None


def _unit(kind: str, words: Sequence[str]) -> str | None:
    """The unit that words name, of those that a kind has."""
    possible = {GYRO: ("deg/s", "rad/s"), ACCELEROMETER: ("mg", "m/s^2", "g")}.get(kind, ())
    for unit in possible:
        if set(words) & _UNIT_WORDS[unit]:
            return unit
    return None


def match_sensors(
    groups: Sequence[SensorColumns], robot: ModelJoints
) -> tuple[dict[str, SensorColumns], list[SensorColumns]]:
    """Find which columns are those of which sensor of the model.

    Parameters
    ----------
    groups : sequence of SensorColumns
        What the log has.
    robot : ModelJoints
        The model with its sensors.

    Returns
    -------
    found : dict
        By sensor its columns: the only ones of their kind, or those whose words are most alike.
    left : list of SensorColumns
        Those of no sensor, or which two sensors fit as well.
    """
    found: dict[str, SensorColumns] = {}
    for kind in (GYRO, ACCELEROMETER, ORIENTATION):
        own = [one for one in groups if one.kind == kind]
        sensors = [one for one in robot.sensors.values() if one.kind == kind]
        if len(own) == len(sensors) == 1:
            found[sensors[0].name] = own[0]
            continue
        scores = {
            (i, one.name): _alike(group, one, robot)
            for i, group in enumerate(own)
            for one in sensors
        }
        while scores:
            (i, name), best = max(scores.items(), key=lambda item: item[1])
            others = [score for (j, other), score in scores.items() if (j == i) != (other == name)]
            if best <= max(others, default=0.0):
                break
            found[name] = own[i]
            scores = {key: one for key, one in scores.items() if key[0] != i and key[1] != name}
    taken = list(found.values())
    return found, [group for group in groups if group not in taken]


def _alike(group: SensorColumns, sensor: Sensor, robot: ModelJoints) -> float:
    """The share of words that columns have in common with a sensor, its site and its body."""
    kind, _, place = sensor.mount.partition(" ")
    named = [sensor.name]
    if kind in ("site", "body"):
        named.append(element_name(robot.model, kind, int(place)))
    if sensor.body >= 0:
        named.append(element_name(robot.model, "body", sensor.body))
    wanted = {word for name in named for word in tokens(name)}
    return len(group.words & wanted) / max(1, len(group.words | wanted))


def match_by_name(
    columns: Sequence[ColumnName], robot: ModelJoints
) -> dict[str, tuple[ColumnName, ...]]:
    """Find the columns of touch, force and other sensors, which are called as the sensor is.

    Parameters
    ----------
    columns : sequence of ColumnName
        Those of no gyro, accelerometer or orientation.
    robot : ModelJoints
        The model with its sensors.

    Returns
    -------
    dict
        By sensor its columns.
    """
    by_words: dict[tuple[str, ...], ColumnName] = {}
    for column in columns:
        by_words.setdefault(tuple(tokens(column.column)), column)
    found = {}
    for sensor in robot.sensors.values():
        if sensor.kind not in _BY_NAME:
            continue
        own = tuple(tokens(sensor.name))
        wanted = [own] if len(sensor.units) == 1 else [(*own, axis) for axis in "xyz"]
        if all(words in by_words for words in wanted):
            found[sensor.name] = tuple(by_words[words] for words in wanted)
    return found
