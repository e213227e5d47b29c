"""What a log says of a robot's base: where it is, how it is turned, and whether it moves."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from dropo.core.services.validation import Array
from dropo.data.checks.findings import Finding, Level
from dropo.data.checks.kinematics import rotation_vectors
from dropo.logs.guessing.words import ColumnName, read_names, tokens
from dropo.logs.readers.reader import Log
from dropo.mjmodel.joints import ModelJoints

CERTAIN = ("base", "root", "torso", "trunk", "pelvis", "odom", "floating", "chassis")
"""Words of what belongs to a base ..."""
WORDS = (*CERTAIN, "imu", "body", "pose", "transform", "orientation")
"""... with those that may be of another body, such as an arm's hand."""
_NOT_A_POSITION = (
    *("vel", "velocity", "acc", "accel", "acceleration", "gyro", "angular", "twist", "force"),
    *("linear", "mag", "covariance", "rpy", "euler", "torque", "scale", "target", "cmd", "goal"),
)
_TURNS = ("gyro", "angular", "omega")
_COMPONENTS = {"qx": "x", "qy": "y", "qz": "z", "qw": "w"}


@dataclass(frozen=True)
class BaseSettings:
    """When a base moves, and which order a quaternion has.

    Attributes
    ----------
    turn : float
        Radians that a base at rest does not turn by.
    way : float
        Metres that a base at rest does not move by.
    speed : float
        rad/s (rms) of a gyro at rest.
    clear : float
        By how much the scalar part of a quaternion must be nearer to 1 than the other end's.
    """

    turn: float = 0.1
    way: float = 0.03
    speed: float = 0.2
    clear: float = 0.2


DEFAULTS = BaseSettings()


@dataclass(frozen=True)
class BaseColumns:
    """Columns of a base.

    Attributes
    ----------
    position : tuple of ColumnName
        x, y, z, or none.
    quaternion : tuple of ColumnName
        w, x, y, z where the names say so, else in the log's order, or none.
    named : bool
        Whether the names give the quaternion's order.
    gyro : tuple of ColumnName
        Angular velocity about x, y, z, or none.
    """

    position: tuple[ColumnName, ...] = ()
    quaternion: tuple[ColumnName, ...] = ()
    named: bool = True
    gyro: tuple[ColumnName, ...] = ()

    def all(self) -> tuple[ColumnName, ...]:
        """List all columns.

        Returns
        -------
        tuple of str
        """
        return (*self.position, *self.quaternion, *self.gyro)


def find_base(columns: Sequence[ColumnName], names: Sequence[str] = ()) -> BaseColumns:
    """Find the columns of a base by their names.

    Parameters
    ----------
    columns : sequence of ColumnName
        All columns of a log.
    names : sequence of str
        What the base is called beside `WORDS`.

    Returns
    -------
    BaseColumns
        The first of each kind.
    """
    own = {*WORDS, *(word for name in names for word in tokens(name))}
    groups: dict[tuple[str, ...], dict[str, ColumnName]] = {}
    for column in columns:
        words = tokens(column.column)
        if not words or column.quantity == "time":
            continue
        last = _COMPONENTS.get(words[-1], words[-1])
        key = (*tokens(column.topic or ""), *words[:-1])
        if words[-1] in _COMPONENTS:
            key = (*key, "quat")
        if last in ("x", "y", "z", "w") or last.isdigit():
            groups.setdefault(key, {}).setdefault(last, column)
    found = BaseColumns()
    for key, parts in groups.items():
        if not set(key) & own:
            continue
        found = _with_group(found, key, parts)
    return found


def _with_group(
    found: BaseColumns, key: tuple[str, ...], parts: dict[str, ColumnName]
) -> BaseColumns:
    """The columns, with those of a group where it is one of the three kinds."""
    is_quaternion = bool(set(key) & {"quat", "quaternion", "orientation", "rotation", "quats"})
    order = sorted(parts)
    if is_quaternion and not found.quaternion:
        if order == ["w", "x", "y", "z"]:
            return BaseColumns(
                found.position, tuple(parts[part] for part in order), True, found.gyro
            )
        if order == ["0", "1", "2", "3"]:
            return BaseColumns(
                found.position, tuple(parts[part] for part in order), False, found.gyro
            )
    if set(key) & set(_TURNS) and order in (["x", "y", "z"], ["0", "1", "2"]) and not found.gyro:
        three = tuple(parts[part] for part in order)
        return BaseColumns(found.position, found.quaternion, found.named, three)
    is_position = not set(key) & set(_NOT_A_POSITION) and not is_quaternion
    if is_position and order[-3:] == ["x", "y", "z"] and not found.position:
        three = tuple(parts[part] for part in ("x", "y", "z"))
        return BaseColumns(three, found.quaternion, found.named, found.gyro)
    return found


def how_it_moves(
    found: BaseColumns, values: dict[ColumnName, Array], settings: BaseSettings = DEFAULTS
) -> str | None:
    """Say how a base moves.

    Parameters
    ----------
    found : BaseColumns
        Its columns.
    values : dict
        The numbers (n,) of each.
    settings : BaseSettings, optional
        What counts as moving.

    Returns
    -------
    str or None
        Such as "base_z moves by 0.21 m"; None where it is at rest.
    """
    if found.quaternion:
        turns = np.stack([values[column] for column in found.quaternion], axis=1)
        turns = turns[np.isfinite(turns).all(axis=1)]
        norms = np.linalg.norm(turns, axis=1, keepdims=True)
        if len(turns) and float(norms.min()) > 0.5:
            whole = turns / norms
            angle = rotation_vectors(np.broadcast_to(whole[0], whole.shape), whole)
            largest = float(np.linalg.norm(angle, axis=1).max())
            if largest > settings.turn:
                return f"{found.quaternion[0].column} and its like turn by {largest:.3g} rad"
    for column in found.position:
        way = float(np.nanmax(values[column]) - np.nanmin(values[column]))
        if way > settings.way:
            return f"{column.column} moves by {way:.3g} m"
    for column in found.gyro:
        speed = float(np.sqrt(np.nanmean(values[column] ** 2)))
        if speed > settings.speed:
            return f"{column.column} is {speed:.3g} rad/s (rms)"
    return None


def moving_base(
    log: Log, robot: ModelJoints, others: Collection[tuple[str | None, str]] = ()
) -> Finding | None:
    """Find a base that moves in a log and is fixed in the model.

    Parameters
    ----------
    log : Log
        The log, whose columns are known by their names.
    robot : ModelJoints
        The robot.
    others : collection of (str or None, str)
        Topic and name of columns that are known to be of something else, such as an IMU on a link.

    Returns
    -------
    Finding or None
        An error; a warning where the columns may be of another body than the base.
    """
    if any(joint.kind == "free" for joint in robot.joints.values()):
        return None
    columns = read_names(log, [*robot.joints, *robot.actuators])
    columns = [one for one in columns if (one.topic, one.column) not in others]
    certain = [one for one in columns if set(_words_of(one)) & set(CERTAIN)]
    found = find_base(certain)
    level: Level = "error"
    if not found.all():
        found = find_base(columns)
        level = "warning"
    values = {}
    for column in found.all():
        numbers = log.read(column.topic, [column.column], lambda fraction, text: None)
        if numbers[column.column].dtype.kind not in "biuf":
            return None
        values[column] = numbers[column.column].astype(float)
    how = how_it_moves(found, values)
    if how is None:
        return None
    text = f"the base is fixed in the model and moves in the log: {how}."
    advice = "Give the model a free joint, or log with the base held."
    if level == "warning":
        text = f"the base is fixed in the model, and {how}."
        advice = "If that is the base, give the model a free joint, or log with the base held."
    return Finding(level, "", text, advice)


def _words_of(column: ColumnName) -> list[str]:
    """The words of a column's topic and name."""
    return [*tokens(column.topic or ""), *tokens(column.column)]


def quaternion_order(parts: Array, settings: BaseSettings = DEFAULTS) -> str | None:
    """Find which end of a quaternion without names is its scalar part: near 1 for a base upright.

    Parameters
    ----------
    parts : (n, 4) array
        In the log's order.
    settings : BaseSettings, optional
        What counts as clear.

    Returns
    -------
    str or None
        "wxyz" or "xyzw"; None where both ends may be.
    """
    first = float(np.nanmean(np.abs(parts[:, 0])))
    last = float(np.nanmean(np.abs(parts[:, 3])))
    if abs(first - last) < settings.clear:
        return None
    return "wxyz" if first > last else "xyzw"
