"""What the words in a column's name say: quantity, unit, and what is left for the joint's name."""

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from dropo.core.services.errors import BadFile
from dropo.logs.readers.reader import Log

# Quantities of columns.
POSITION = "position"
VELOCITY = "velocity"
COMMAND = "command"
EFFORT = "torque"
TIME = "time"
RUN = "run"
OTHER = "other"

_QUANTITIES: dict[str, tuple[str, ...]] = {
    COMMAND: (
        *("cmd", "command", "commanded", "commands", "target", "targets", "goal", "ctrl"),
        *("control", "action", "actions", "setpoint", "set", "ref", "reference", "des", "desired"),
        *("want", "wanted", "input", "u", "pwm", "request", "requested", "demand", "sp"),
        *("soll", "sollwert", "consigne", "qref", "qdes", "qcmd", "qtarget", "qgoal"),
        *("volt", "volts", "voltage", "voltages", "mv", "duty"),
    ),
    OTHER: (
        *("acc", "accel", "acceleration", "accelerations", "qdd", "ddq", "temp", "temperature"),
        *("error", "err", "battery", "status", "mode", "seq", "frame", "index", "count", "task"),
        *("kp", "kd", "ki", "gain", "tempc", "load", "done", "reward", "lost"),
    ),
    VELOCITY: (
        *("vel", "velocity", "velocities", "speed", "speeds", "dq", "qd", "qdot", "dqdt", "qvel"),
        *("omega", "rate", "vels", "dtheta", "thetadot", "geschwindigkeit"),
    ),
    EFFORT: (
        *("tau", "torque", "torques", "effort", "efforts", "current", "currents", "force", "amps"),
        *("taus", "forces", "moment"),
    ),
    POSITION: (
        *("pos", "position", "positions", "q", "qpos", "angle", "angles", "theta", "enc", "state"),
        *("encoder", "present", "phi", "rotation", "value", "deg", "degree", "degrees", "rad"),
        *("tick", "ticks", "counts", "raw", "poses", "x", "winkel", "istwert"),
    ),
}
"""Words of each quantity, the strongest quantity first: "q_cmd" is a command."""
_UNITS: dict[str, tuple[str, ...]] = {
    "deg/s": ("degps", "degs", "dps"),
    "rad/s": ("radps", "rads"),
    "rpm": ("rpm",),
    "rev/s": ("rps",),
    "deg": ("deg", "degree", "degrees", "grad"),
    "rad": ("rad", "radian", "radians"),
    "rev": ("rev", "revs", "turn", "turns", "revolutions"),
    "tick": ("tick", "ticks", "count", "counts", "raw", "lsb", "steps"),
    "mN m": ("mnm",),
    "N m": ("nm",),
    "mV": ("mv", "millivolts"),
    "V": ("volt", "volts", "voltage", "voltages"),
    "1": ("pwm", "duty"),
    "mA": ("ma", "milliamps"),
    "A": ("amp", "amps", "ampere"),
    "mm": ("mm",),
    "cm": ("cm",),
    "ms": ("ms", "msec", "millis", "milliseconds"),
    "us": ("us", "usec", "micros", "microseconds"),
    "ns": ("ns", "nsec", "nanos", "nanoseconds"),
    "s": ("s", "sec", "secs", "second", "seconds"),
}
"""Words of each unit."""
_TIMES = ("t", "time", "timestamp", "stamp", "clock", "timestamps", "times", "elapsed", "zeit")
_RUNS = ("run", "episode", "trial", "runid", "recording", "session")
_EMPTY = (
    *("joint", "joints", "motor", "motors", "actual", "measured", "meas", "observation", "header"),
    *("sensor", "fb", "feedback", "axis", "actuator", "data", "robot", "ros", "servo", "dof", "id"),
    *("per", "in", "of", "the", "current_pos", "arm", "act", "read", "readings", "main", "ist"),
)
"""Words that say nothing of which joint it is, unless joints are called so."""
TIME_UNITS = tuple(word for unit in ("ms", "us", "ns") for word in _UNITS[unit])
"""Words of units that only stamps have."""
_PER_SECOND = ("s", "sec", "second")
_SPEEDS = ("deg/s", "rad/s", "rpm", "rev/s")
_FORCES = ("N m", "mN m", "N", "V", "mV", "A", "mA")
"""Units of what drives a motor."""
_SIGNS = {
    "v": "V",
    "mv": "mV",
    "a": "A",
    "ma": "mA",
    "nm": "N m",
    "n m": "N m",
    "n.m": "N m",
    "n·m": "N m",
    "n*m": "N m",
    "mnm": "mN m",
    "n": "N",
    "%": "%",
    "°": "deg",
    "°/s": "deg/s",
}
"""Units as they stand in brackets at a name's end, in lower case."""
_IN_BRACKETS = re.compile(r"^(.+?)\s*[\[(]\s*([^\[\]()]+?)\s*[\])]\s*$")
_AT_END = re.compile(r"^(.+)_(V|mV|A|mA|Nm|mNm)$")
_ELEMENT = re.compile(r"(.+)\[([^\[\]]+)\]")
_TOKEN = re.compile(r"[A-Za-z]+|\d+")
_CAMEL = re.compile(r"(?<=[a-z])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])")


def tokens(name: str) -> list[str]:
    """Cut a name into lower-case words and numbers.

    Parameters
    ----------
    name : str
        Such as "Joint1 posDeg" or "observation.state[elbow.pos]".

    Returns
    -------
    list of str
        Such as ["joint", "1", "pos", "deg"].
    """
    return [word.lower() for word in _TOKEN.findall(_CAMEL.sub(" ", name))]


@dataclass(frozen=True)
class ColumnName:
    """A column's name, read.

    Attributes
    ----------
    column : str
        The name.
    topic : str or None
        The topic that it belongs to.
    quantity : str or None
        One of the quantities; None where no word says it.
    kind : str or None
        Of a command, what quantity it is a command of; None where no word says it.
    unit : str or None
        The unit that a word names: one of units.UNITS, of time, or "tick".
    rest : tuple of str
        The other words, which may name the joint.
    file : str or None
        The file beside the log that it stands in, as a mapping names it.
    """

    column: str
    topic: str | None
    quantity: str | None
    kind: str | None
    unit: str | None
    rest: tuple[str, ...]
    file: str | None = None


def read_name(
    column: str, topic: str | None, joints: Iterable[str], above: str | None = None
) -> ColumnName:
    """Read the name of a column.

    Parameters
    ----------
    column : str
        The name.
    topic : str or None
        Its topic.
    joints : iterable of str
        Names of joints and actuators, whose words keep their meaning.
    above : str, optional
        A name whose words hold for all its columns; by default the topic.

    Returns
    -------
    ColumnName
    """
    above = above if above is not None else topic
    own = {word for name in joints for word in tokens(name)}
    bracket = _IN_BRACKETS.match(column) or _AT_END.match(column)
    sign = _SIGNS.get(bracket[2].lower()) if bracket and bracket[2].lower() not in own else None
    words = tokens(column if sign is None or bracket is None else bracket[1])
    quantity, kind, used = _quantity([word for word in words if word not in own])
    unit, of_unit = _unit([word for word in words if word not in own])
    unit = sign or unit
    if quantity is None:
        quantity, kind, _ = _quantity(words)
    if above is not None and quantity not in (COMMAND, TIME):
        of_all, _, _ = _quantity(tokens(above))
        if of_all == COMMAND:
            kind = quantity
            quantity = COMMAND
    if unit in _FORCES:
        quantity, kind = _of_force(quantity, kind, unit)
    if unit in _SPEEDS and quantity in (None, POSITION):
        quantity = VELOCITY
    if unit in _SPEEDS and quantity == COMMAND and kind in (None, POSITION):
        kind = VELOCITY
    rest = [word for word in words if word in own or word not in (*used, *of_unit, *_EMPTY)]
    return ColumnName(column, topic, quantity, kind, unit, tuple(rest))


def _of_force(quantity: str | None, kind: str | None, unit: str) -> tuple[str | None, str | None]:
    """The quantity of what is in a unit of forces, and the kind of its command."""
    if quantity == COMMAND:
        return COMMAND, kind if kind not in (None, POSITION) else EFFORT
    if quantity is None:
        return (COMMAND, EFFORT) if unit in ("V", "mV") else (EFFORT, None)
    return quantity, kind


def read_names(log: Log, joints: Sequence[str], above: str | None = None) -> list[ColumnName]:
    """Read the names of all columns of all topics.

    Parameters
    ----------
    log : Log
        The log.
    joints : sequence of str
        As of `read_name`.
    above : str, optional
        As of `read_name`.

    Returns
    -------
    list of ColumnName
        In the order of the log; topics without messages are left out.

    Raises
    ------
    BadFile
        If a log without topics cannot be read.
    """
    found = []
    topics: list[str | None] = [*log.topics()] or [None]
    for topic in topics:
        try:
            columns = log.columns(topic)
        except BadFile:
            if topic is None:
                raise
            continue
        found += [read_name(column, topic, joints, above) for column in _without_aliases(columns)]
    return found


def _without_aliases(columns: Sequence[str]) -> list[str]:
    """The columns without "state[0]" where there is "state[elbow]", too, which is the same."""
    parts = [_ELEMENT.fullmatch(column) for column in columns]
    named = {part[1] for part in parts if part and not part[2].isdigit()}
    return [
        column
        for column, part in zip(columns, parts, strict=True)
        if part is None or not part[2].isdigit() or part[1] not in named
    ]


def _quantity(words: list[str]) -> tuple[str | None, str | None, set[str]]:
    """The quantity of words, of which quantity a command is one, and the words that say so."""
    if words and words[0] in (*_TIMES, "log") and not set(words) & set(_QUANTITIES[COMMAND]):
        return TIME, None, set(words)
    if words and (words[-1] in _TIMES or words[-1] in ("sec", "nanosec", "nsec")):
        return TIME, None, set(words)
    if len(words) == 1 and words[0] in ("ms", "us", "ns", "sec", "seconds", "millis", "micros"):
        return TIME, None, set(words)
    if set(words) & set(_RUNS):
        return RUN, None, set(words)
    found: dict[str, set[str]] = {}
    for quantity, of_quantity in _QUANTITIES.items():
        here = set(words) & set(of_quantity)
        if here:
            found[quantity] = here
    used = set().union(*found.values()) if found else set()
    if COMMAND in found:
        kinds = [quantity for quantity in found if quantity not in (COMMAND, OTHER)]
        return COMMAND, kinds[0] if kinds else None, used
    first = next(iter(found), None)
    return first, None, used


def _unit(words: list[str]) -> tuple[str | None, set[str]]:
    """The unit that words name, and the words that say so."""
    for unit, of_unit in _UNITS.items():
        here = [i for i, word in enumerate(words) if word in of_unit]
        if not here or (unit == "s" and len(words) > 1 and words[0] not in _TIMES):
            continue
        used = {words[i] for i in here}
        rate = any(word in _PER_SECOND for word in words[here[-1] + 1 : here[-1] + 3])
        if unit in ("deg", "rad", "rev") and rate:
            return f"{unit}/s", used | set(_PER_SECOND) | {"per"}
        return unit, used
    return None, set()
