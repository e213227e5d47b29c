"""The columns of an observation row, and the coordinates in which predictions are compared with
measurements.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from dropo.core.records.trajectories import Signal
from dropo.core.services.errors import BadArgument
from dropo.core.services.validation import Array
from dropo.mjmodel.fields import item_columns
from dropo.mjmodel.joints import all_joints
from dropo.mjmodel.names import element_names

STATE = ("qpos", "qvel", "act")


@dataclass(frozen=True)
class _Column:
    field: str
    place: int


class Layout:
    """Observation rows (P,) of a model; compared as p signals, where a quaternion's four columns
    count for three.

    items: slices of "qpos", "qvel", "act" and "sensordata", or elements by name. A quaternion is
    compared in the tangent space at the measured one: a rotation vector in the body's frame, 0 for
    the measurement (mj_differentiatePos).
    """

    def __init__(self, model: mujoco.MjModel, items: Sequence[str]):
        sizes = {
            "qpos": model.nq,
            "qvel": model.nv,
            "act": model.na,
            "sensordata": model.nsensordata,
        }
        addresses = _addresses(model)
        self.columns = [
            _Column(field, i)
            for item in items
            for field, places in [item_columns(item, sizes, addresses)]
            for i in places
        ]
        if not self.columns:
            raise BadArgument("The observation must have at least one column. Got none.")
        self.quaternions = self._quaternion_columns(model)
        self.model_units = _units(model)
        self.names = [_name(addresses, column) for column in self.columns]
        self.signals = self._signals()
        self._plain = np.array(
            [
                i
                for i in range(len(self.columns))
                if not any(i in quat for quat in self.quaternions)
            ],
            dtype=int,
        )
        self._start = {field: self._places(field) for field in STATE}

    def __len__(self) -> int:
        return len(self.columns)

    @property
    def needs_sensors(self) -> bool:
        return any(column.field == "sensordata" for column in self.columns)

    def _places(self, field: str) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        found = [
            (i, column.place) for i, column in enumerate(self.columns) if column.field == field
        ]
        return np.array([i for i, _ in found], dtype=np.int64), np.array(
            [place for _, place in found], dtype=np.int64
        )

    def _quaternion_columns(self, model: mujoco.MjModel) -> list[list[int]]:
        """The four columns of each quaternion that is observed; a part of one is refused."""
        where = {column.place: i for i, column in enumerate(self.columns) if column.field == "qpos"}
        found = []
        for start in quaternion_addresses(model):
            have = [where[i] for i in range(start, start + 4) if i in where]
            if have and (len(have) < 4 or have != list(range(have[0], have[0] + 4))):
                raise BadArgument(
                    "The observation must hold all four numbers of the quaternion at "
                    f"qpos[{start}:{start + 4}], in order, or none."
                )
            if have:
                found.append(have)
        return found

    def _signals(self) -> list[Signal]:
        """One signal a plain column; three rotations in place of a quaternion's four columns."""
        out = []
        firsts = {quat[0]: quat for quat in self.quaternions}
        inside = {i for quat in self.quaternions for i in quat[1:]}
        for i, (column, name) in enumerate(zip(self.columns, self.names, strict=True)):
            if i in firsts:
                owner = name.rsplit("[", 1)[0] if "." in name else name
                out += [Signal(f"{owner}.r{axis}", "rad") for axis in "xyz"]
            elif i not in inside:
                out.append(Signal(name, self.model_units.get((column.field, column.place), "")))
        return out

    def places_of(self, items: Sequence[str], model: mujoco.MjModel) -> NDArray[np.bool_]:
        """(P,) which columns the items name, for `partial` resets."""
        named = {(column.field, column.place) for column in Layout(model, items).columns}
        return np.array([(column.field, column.place) in named for column in self.columns])

    def observe(self, states: Array, sensors: Array | None, model: mujoco.MjModel) -> Array:
        """Observation rows (..., P) from full physics states (..., 1 + nq + nv + na + ...) and
        sensor data; NaN without.
        """
        first = {"qpos": 1, "qvel": 1 + model.nq, "act": 1 + model.nq + model.nv}
        out = np.empty((*states.shape[:-1], len(self)))
        for i, column in enumerate(self.columns):
            if column.field == "sensordata":
                out[..., i] = np.nan if sensors is None else sensors[..., column.place]
            else:
                out[..., i] = states[..., first[column.field] + column.place]
        return out

    def write_start(
        self, states: Array, rows: Array, chosen: NDArray[np.bool_], model: mujoco.MjModel
    ) -> None:
        """Writes the chosen columns of observation rows (N, P) into full physics states (N, n), in
        place.
        """
        first = {"qpos": 1, "qvel": 1 + model.nq, "act": 1 + model.nq + model.nv}
        for field, (columns, places) in self._start.items():
            take = chosen[columns]
            states[:, first[field] + places[take]] = rows[:, columns[take]]

    def full_states(self, rows: Array, model: mujoco.MjModel) -> Array:
        """Physics states (N, 1 + nq + nv + na) of observation rows (N, P); what is not observed is
        at qpos0 or rests.
        """
        states = np.zeros((len(rows), 1 + model.nq + model.nv + model.na))
        states[:, 1 : 1 + model.nq] = model.qpos0
        self.write_start(states, rows, np.ones(len(self), dtype=bool), model)
        return states

    @property
    def column_signals(self) -> list[Signal]:
        """Names and units of the P columns; a quaternion's numbers have no unit."""
        units = [self.model_units.get((column.field, column.place), "") for column in self.columns]
        return [Signal(name, unit) for name, unit in zip(self.names, units, strict=True)]

    def move(self, rows: Array, offsets: Array) -> Array:
        """Observation rows (N, P) moved by offsets (N, p) in the signals' coordinates."""
        out = rows.copy()
        plain, rotations = self._signal_places()
        out[:, self._plain] += offsets[:, plain]
        for quat, places in zip(self.quaternions, rotations, strict=True):
            out[:, quat] = multiply(rows[:, quat], exponential(offsets[:, places]))
        return out

    def coordinates(self, rows: Array, measured: Array) -> Array:
        """Observation rows (..., P) as signals (..., p), in the chart at the measured rows
        (broadcast against `rows`).
        """
        plain, rotations = self._signal_places()
        out = np.empty((*rows.shape[:-1], len(self.signals)))
        out[..., plain] = rows[..., self._plain]
        for quat, places in zip(self.quaternions, rotations, strict=True):
            conjugate = measured[..., quat] * np.array([1.0, -1.0, -1.0, -1.0])
            out[..., places] = logarithm(multiply(conjugate, rows[..., quat]))
        return out

    def by_column(self, per_signal: Array) -> Array:
        """Numbers of the signals (p,) for the observation columns (P,); 0 for a quaternion's."""
        out = np.zeros(len(self))
        out[self._plain] = per_signal[self._signal_places()[0]]
        return out

    def _signal_places(self) -> tuple[list[int], list[list[int]]]:
        """Where the plain columns and each quaternion's rotations stand among the signals."""
        plain = []
        rotations = []
        at = 0
        firsts = {quat[0] for quat in self.quaternions}
        inside = {i for quat in self.quaternions for i in quat[1:]}
        for i in range(len(self)):
            if i in firsts:
                rotations.append([at, at + 1, at + 2])
                at += 3
            elif i not in inside:
                plain.append(at)
                at += 1
        return plain, rotations


def quaternion_addresses(model: mujoco.MjModel) -> list[int]:
    """Where in qpos the quaternions of free and ball joints begin."""
    places = [(joint.qpos, joint.quaternion()) for joint in all_joints(model)]
    return [first + inside.start for first, inside in places if inside is not None]


Addresses = dict[str, dict[str, tuple[int, int]]]
"""Start and length of each named element, by field."""


def _addresses(model: mujoco.MjModel) -> Addresses:
    """Those in qpos, qvel, act and sensordata; all joints and actuators have names."""
    joints = all_joints(model)
    actuators = {
        name: i
        for name, i in element_names(model, "actuator").items()
        if model.actuator_actnum[i] > 0
    }
    sensors = element_names(model, "sensor")
    return {
        "qpos": {joint.name: (joint.qpos, len(joint.units("qpos"))) for joint in joints},
        "qvel": {joint.name: (joint.qvel, len(joint.units("qvel"))) for joint in joints},
        "act": {
            name: (int(model.actuator_actadr[i]), int(model.actuator_actnum[i]))
            for name, i in actuators.items()
        },
        "sensordata": {
            name: (int(model.sensor_adr[i]), int(model.sensor_dim[i]))
            for name, i in sensors.items()
        },
    }


def _name(addresses: Addresses, column: _Column) -> str:
    """ "qpos.thigh_joint", "qpos.box[0]" where the element has several numbers, "sensordata[3]"
    where it has no name.
    """
    for name, (start, count) in addresses[column.field].items():
        if start <= column.place < start + count:
            number = f"[{column.place - start}]" if count > 1 else ""
            return f"{column.field}.{name}{number}"
    return f"{column.field}[{column.place}]"


def _units(model: mujoco.MjModel) -> dict[tuple[str, int], str]:
    """The unit of each number of qpos and qvel; a quaternion's have none."""
    out = {}
    for joint in all_joints(model):
        for i, unit in enumerate(joint.units("qpos")):
            out["qpos", joint.qpos + i] = unit
        for i, unit in enumerate(joint.units("qvel")):
            out["qvel", joint.qvel + i] = unit
    return out


def multiply(a: Array, b: Array) -> Array:
    """The product of quaternions (..., 4), w x y z."""
    aw, ax, ay, az = np.moveaxis(a, -1, 0)
    bw, bx, by, bz = np.moveaxis(b, -1, 0)
    return np.stack(
        [
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ],
        axis=-1,
    )


def exponential(rotation: Array) -> Array:
    """Unit quaternions (..., 4) of rotation vectors (..., 3) [rad]."""
    half = np.linalg.norm(rotation, axis=-1, keepdims=True) / 2
    return np.concatenate([np.cos(half), 0.5 * np.sinc(half / np.pi) * rotation], axis=-1)


def logarithm(quaternion: Array) -> Array:
    """Rotation vectors (..., 3) [rad], of length at most pi, of quaternions (..., 4) of any length
    but 0.
    """
    imaginary = quaternion[..., 1:] * np.where(quaternion[..., :1] < 0, -1.0, 1.0)
    real = np.abs(quaternion[..., 0])
    length = np.linalg.norm(imaginary, axis=-1)
    angle = 2 * np.arctan2(length, real)
    small = length < 1e-150
    factor = np.where(
        small, 2.0 / np.where(real > 0, real, 1.0), angle / np.where(small, 1.0, length)
    )
    return factor[..., None] * imaginary
