"""Entries of a mapping for the columns of gyros, accelerometers and other sensors of the model."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from dropo.logs.guessing.base import quaternion_order
from dropo.logs.guessing.guessed import NAMED, Guess, quote
from dropo.logs.guessing.log_columns import LogColumns
from dropo.logs.guessing.scales import accelerometer_unit
from dropo.logs.guessing.sensors import (
    ACCELEROMETER,
    ORIENTATION,
    SensorColumns,
    find_sensor_columns,
    match_by_name,
    match_sensors,
)
from dropo.logs.guessing.words import ColumnName
from dropo.mjmodel.joints import ModelJoints


def take_sensors(
    columns: LogColumns,
    robot: ModelJoints,
    free: Sequence[ColumnName],
    entries: Mapping[str, Any],
    guess: Guess,
    source: Callable[[ColumnName], dict[str, Any]],
) -> None:
    """Take the columns of the model's sensors into a guessed mapping.

    Parameters
    ----------
    columns : LogColumns
        The log's columns; those that are taken are used then.
    robot : ModelJoints
        The robot with its sensors.
    free : sequence of ColumnName
        Columns that may be a sensor's.
    entries : mapping
        By sensor what the mapping that was given says.
    guess : Guess
        What was guessed so far, which is added to.
    source : callable
        Says where a column stands, as an entry does.
    """
    taking = _Taking(columns, guess, source)
    groups, left = match_sensors(find_sensor_columns(free), robot)
    in_groups = {one for group in (*groups.values(), *left) for one in group.columns}
    for name, group in groups.items():
        if len(columns.numeric(group.columns)) == len(group.columns):
            taking.take(name, group, entries.get(name))
    rest = [one for one in free if one not in in_groups]
    for name, columns_of in match_by_name(rest, robot).items():
        if len(columns.numeric(columns_of)) == len(columns_of):
            unit = robot.sensors[name].units[0]
            taking.keep(name, columns_of, unit, "it is called so", entries.get(name))


@dataclass
class _Taking:
    """The columns of a log, and the mapping that sensors are taken into."""

    columns: LogColumns
    guess: Guess
    source: Callable[[ColumnName], dict[str, Any]]

    def take(self, name: str, group: SensorColumns, given: object) -> None:
        """Take columns of an IMU into the mapping."""
        columns = list(group.columns)
        if group.kind == ORIENTATION:
            why = "by the names"
            if not group.is_named:
                order = quaternion_order(np.stack(self.columns.read(columns), axis=1))
                columns = [columns[3], *columns[:3]] if order == "xyzw" else columns
                why = f"taken as {order or 'wxyz'}"
            self.keep(name, columns, "", why, given)
            return
        if group.unit is not None:
            self.keep(name, columns, group.unit, NAMED, given)
            return
        if group.kind == ACCELEROMETER:
            lengths = np.linalg.norm(np.stack(self.columns.read(columns), axis=1), axis=1)
            unit, why = accelerometer_unit(lengths)
            self.keep(name, columns, unit, why, given)
            return
        self.keep(name, columns, "rad/s", "nothing says otherwise", given)

    def keep(
        self, name: str, columns: Sequence[ColumnName], unit: str, why: str, given: object
    ) -> None:
        """Take columns into the mapping, in a unit."""
        self.columns.used |= set(columns)
        entry: dict[str, Any]
        if len(columns) == 1:
            entry = {"column": columns[0].column}
        else:
            entry = {"columns": [one.column for one in columns]}
        stated = given.get("unit") if isinstance(given, dict) else None
        if unit and stated is None:
            entry["unit"] = unit
            self.guess.sensor_units[name] = why
        entry |= self.source(columns[0])
        self.guess.mapping.setdefault("sensordata", {})[name] = entry
        shown = f"in {stated}, since it was given" if stated else f"in {unit}, since {why}"
        reading = shown if unit else f"in w, x, y, z, {why}"
        self.guess.lines.append(f"sensor: {name} = {quote(list(columns))}; {reading}")
