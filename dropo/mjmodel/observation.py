"""The columns of observation rows, and the coordinates in which predictions meet measurements."""

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from dropo.core.records.trajectories import Signal
from dropo.core.services.errors import BadArgument
from dropo.core.services.validation import Array
from dropo.mjmodel.fields import item_columns
from dropo.mjmodel.followers import Follower, followers_of
from dropo.mjmodel.joints import all_joints
from dropo.mjmodel.names import element_names
from dropo.mjmodel.sensors import named_sensors

STATE = ("qpos", "qvel", "act")


@dataclass(frozen=True)
class ObservedColumn:
    """A column of observation rows: a place in a field of the state.

    Attributes
    ----------
    field : str
        "qpos", "qvel", "act" or "sensordata".
    place : int
        The place in the field.
    """

    field: str
    place: int


class Layout:
    """The P columns of observation rows of a model, compared as p signals.

    A quaternion's four columns, of a joint or of a sensor, are three signals: it is compared in the
    tangent space at the measured one, by a rotation vector in the body's frame that is 0 for the
    measurement (mj_differentiatePos).

    Parameters
    ----------
    model : MjModel
        The compiled model.
    items : sequence of str
        Slices of "qpos", "qvel", "act" and "sensordata", or elements by name, in the order of the
        columns.

    Attributes
    ----------
    columns : list of ObservedColumn
        What each of the P columns holds.
    names : list of str
        The names of the P columns.
    quaternions : list of list of int
        The four columns of each observed quaternion.
    signals : list of Signal
        Names and units of the p signals.
    model_units : dict
        The unit of each number of qpos, qvel and named sensors, by field and place.

    Raises
    ------
    BadArgument
        If there is no column, an item is outside of its field, or a part of a quaternion of qpos is
        observed.
    UnknownName
        If there is no such field or element; with the nearest valid name.
    """

    def __init__(self, model: mujoco.MjModel, items: Sequence[str]):
        addresses = _addresses(model)
        self.columns = _columns(model, items, addresses)
        if not self.columns:
            raise BadArgument("The observation must have at least one column. Got none.")
        self.quaternions = self._quaternion_columns(model)
        self.model_units = _units(model)
        self.names = [_name(addresses, column) for column in self.columns]
        self.signals = self._signals()
        in_quaternion = {i for quaternion in self.quaternions for i in quaternion}
        plain = [i for i in range(len(self.columns)) if i not in in_quaternion]
        self._plain = np.array(plain, dtype=int)
        self._start = {field: self._places(field) for field in STATE}
        self._followers = self._unobserved_followers(model)

    def __len__(self) -> int:
        return len(self.columns)

    @property
    def needs_sensors(self) -> bool:
        """Whether a column is of sensor data, which MuJoCo computes with each step."""
        return any(column.field == "sensordata" for column in self.columns)

    def observed(self, field: str) -> set[int]:
        """Return the places of a field that are observed.

        Parameters
        ----------
        field : str
            "qpos", "qvel", "act" or "sensordata".

        Returns
        -------
        set of int
        """
        return {column.place for column in self.columns if column.field == field}

    def _places(self, field: str) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """The columns of a field, and their places in it."""
        columns = [i for i, column in enumerate(self.columns) if column.field == field]
        places = [self.columns[i].place for i in columns]
        return np.array(columns, dtype=np.int64), np.array(places, dtype=np.int64)

    def _quaternion_columns(self, model: mujoco.MjModel) -> list[list[int]]:
        """The four columns of each quaternion that is observed; a part of a joint's is refused."""
        column_of = {(column.field, column.place): i for i, column in enumerate(self.columns)}
        starts = [("qpos", start) for start in quaternion_addresses(model)]
        for sensor in named_sensors(model).values():
            starts += [("sensordata", sensor.place)] if sensor.is_rotation else []
        quaternions = []
        for field, start in starts:
            places = [(field, i) for i in range(start, start + 4)]
            own = [column_of[place] for place in places if place in column_of]
            if not own:
                continue
            if len(own) != 4 or own != list(range(own[0], own[0] + 4)):
                if field == "sensordata":
                    continue  # numbers like any others
                raise BadArgument(
                    "The observation must hold all four numbers of the quaternion at "
                    f"qpos[{start}:{start + 4}], in order, or none."
                )
            quaternions.append(own)
        return quaternions

    def _signals(self) -> list[Signal]:
        """One signal for a plain column, three rotations for a quaternion's four columns."""
        signals = []
        firsts = {quaternion[0] for quaternion in self.quaternions}
        others = {i for quaternion in self.quaternions for i in quaternion[1:]}
        for i, (column, name) in enumerate(zip(self.columns, self.names, strict=True)):
            if i in firsts:
                owner = name.rsplit("[", 1)[0] if "." in name else name
                signals += [Signal(f"{owner}.r{axis}", "rad") for axis in "xyz"]
            elif i not in others:
                unit = self.model_units.get((column.field, column.place), "")
                signals.append(Signal(name, unit))
        return signals

    def places_of(self, items: Sequence[str], model: mujoco.MjModel) -> NDArray[np.bool_]:
        """Find the columns that the items name, for `partial` resets.

        Parameters
        ----------
        items : sequence of str
            As of the layout.
        model : MjModel
            The compiled model.

        Returns
        -------
        (P,) array of bool

        Raises
        ------
        BadArgument, UnknownName
            As of the layout.
        """
        named = {(column.field, column.place) for column in Layout(model, items).columns}
        return np.array([(column.field, column.place) in named for column in self.columns])

    def observe(self, states: Array, sensors: Array | None, model: mujoco.MjModel) -> Array:
        """Read observation rows from full physics states.

        Parameters
        ----------
        states : (..., 1 + nq + nv + na + ...) array
            Full physics states.
        sensors : (..., nsensordata) array or None
            Sensor data; columns of it are NaN without.
        model : MjModel
            The compiled model.

        Returns
        -------
        (..., P) array
        """
        first = _first_places(model)
        if not self.needs_sensors:
            places = [first[column.field] + column.place for column in self.columns]
            return np.take(states, places, axis=-1)
        out = np.empty((*states.shape[:-1], len(self)))
        for i, column in enumerate(self.columns):
            if column.field == "sensordata":
                out[..., i] = np.nan if sensors is None else sensors[..., column.place]
            else:
                out[..., i] = states[..., first[column.field] + column.place]
        return out

    def _unobserved_followers(self, model: mujoco.MjModel) -> list[Follower]:
        """The joints that no column holds, and that follow one whose position is observed."""
        seen = self.observed("qpos")
        found: dict[int, Follower] = {}
        for one in followers_of(model):
            own, leading = one.places
            if own not in seen and leading in seen:
                found.setdefault(own, one)
        return list(found.values())

    def write_start(
        self, states: Array, rows: Array, chosen: NDArray[np.bool_], model: mujoco.MjModel
    ) -> None:
        """Write columns of observation rows into full physics states.

        Joints that are not observed and follow one that is written are where that one has them.

        Parameters
        ----------
        states : (N, 1 + nq + nv + na + ...) array
            Full physics states, which are changed in place.
        rows : (N, P) array
            Observation rows.
        chosen : (P,) array of bool
            The columns that are written.
        model : MjModel
            The compiled model.
        """
        first = _first_places(model)
        for field, (columns, places) in self._start.items():
            take = chosen[columns]
            states[:, first[field] + places[take]] = rows[:, columns[take]]
        columns, places = self._start["qpos"]
        written = set(places[chosen[columns]].tolist())
        for one in self._followers:
            if one.places[1] in written:
                own, other = (first["qpos"] + place for place in one.places)
                speed, leading = (first["qvel"] + dof for dof in one.dofs)
                states[:, own] = one.position(states[:, other])
                states[:, speed] = one.slope(states[:, other]) * states[:, leading]

    def full_states(self, rows: Array, model: mujoco.MjModel) -> Array:
        """Make physics states of observation rows.

        Parameters
        ----------
        rows : (N, P) array
            Observation rows.
        model : MjModel
            The compiled model.

        Returns
        -------
        (N, 1 + nq + nv + na) array
            What is not observed is at qpos0 or rests.
        """
        states = np.zeros((len(rows), 1 + model.nq + model.nv + model.na))
        states[:, 1 : 1 + model.nq] = model.qpos0
        self.write_start(states, rows, np.ones(len(self), dtype=bool), model)
        return states

    @property
    def column_places(self) -> dict[tuple[str, int], int]:
        """Where each number of MuJoCo's fields is among the columns, by the field and its place."""
        return {(one.field, one.place): i for i, one in enumerate(self.columns)}

    @property
    def column_signals(self) -> list[Signal]:
        """Names and units of the P columns; a quaternion's numbers have no unit."""
        units = [self.model_units.get((column.field, column.place), "") for column in self.columns]
        return [Signal(name, unit) for name, unit in zip(self.names, units, strict=True)]

    def move(self, rows: Array, offsets: Array) -> Array:
        """Move observation rows by offsets in the coordinates of the signals.

        Parameters
        ----------
        rows : (N, P) array
            Observation rows.
        offsets : (N, p) array
            In the signals' units.

        Returns
        -------
        (N, P) array
        """
        out = rows.copy()
        plain, rotations = self._signal_places()
        out[:, self._plain] += offsets[:, plain]
        for columns, places in zip(self.quaternions, rotations, strict=True):
            out[:, columns] = multiply(rows[:, columns], exponential(offsets[:, places]))
        return out

    def coordinates(self, rows: Array, measured: Array) -> Array:
        """Express observation rows as signals, rotations relative to measured rows.

        Parameters
        ----------
        rows : (..., P) array
            Observation rows.
        measured : (..., P) array
            The measured rows, broadcast against `rows`.

        Returns
        -------
        (..., p) array
        """
        plain, rotations = self._signal_places()
        if not rotations:
            return np.take(rows, self._plain, axis=-1)
        out = np.empty((*rows.shape[:-1], len(self.signals)))
        out[..., plain] = rows[..., self._plain]
        for columns, places in zip(self.quaternions, rotations, strict=True):
            conjugate = measured[..., columns] * np.array([1.0, -1.0, -1.0, -1.0])
            out[..., places] = logarithm(multiply(conjugate, rows[..., columns]))
        return out

    def missing_state(self, model: mujoco.MjModel) -> list[ObservedColumn]:
        """Find what of qpos, qvel and act no column holds, and no joint that is observed gives.

        Parameters
        ----------
        model : MjModel
            The compiled model.

        Returns
        -------
        list of ObservedColumn
        """
        held = set(self.columns)
        for one in self._followers:
            held |= {ObservedColumn("qpos", one.places[0]), ObservedColumn("qvel", one.dofs[0])}
        sizes = {"qpos": model.nq, "qvel": model.nv, "act": model.na}
        every = [ObservedColumn(field, i) for field in STATE for i in range(sizes[field])]
        return [column for column in every if column not in held]

    @property
    def of_state(self) -> NDArray[np.bool_]:
        """Which of the p signals are of qpos, qvel or act (p,)."""
        plain, rotations = self._signal_places()
        out = np.ones(len(self.signals), dtype=bool)
        out[plain] = [self.columns[i].field in STATE for i in self._plain]
        for columns, places in zip(self.quaternions, rotations, strict=True):
            out[places] = self.columns[columns[0]].field in STATE
        return out

    def by_column(self, per_signal: Array) -> Array:
        """Give each observation column the number of its signal.

        Parameters
        ----------
        per_signal : (p,) array
            A number for each signal.

        Returns
        -------
        (P,) array
            0 in the columns of a quaternion, which have no signal of their own.
        """
        out = np.zeros(len(self))
        out[self._plain] = per_signal[self._signal_places()[0]]
        return out

    def _signal_places(self) -> tuple[list[int], list[list[int]]]:
        """Where the plain columns and each quaternion's rotations stand among the signals."""
        plain = []
        rotations = []
        place = 0
        firsts = {quaternion[0] for quaternion in self.quaternions}
        others = {i for quaternion in self.quaternions for i in quaternion[1:]}
        for i in range(len(self)):
            if i in firsts:
                rotations.append([place, place + 1, place + 2])
                place += 3
            elif i not in others:
                plain.append(place)
                place += 1
        return plain, rotations


def quaternion_addresses(model: mujoco.MjModel) -> list[int]:
    """Find the places in qpos at which the quaternions of free and ball joints begin.

    Parameters
    ----------
    model : MjModel
        The compiled model.

    Returns
    -------
    list of int
        Ascending; each quaternion takes four places.
    """
    addresses = []
    for joint in all_joints(model):
        within = joint.quaternion()
        if within is not None:
            addresses.append(joint.qpos + within.start)
    return addresses


Addresses = dict[str, dict[str, tuple[int, int]]]
"""Start and length of each named element, by field."""


def _columns(
    model: mujoco.MjModel, items: Sequence[str], addresses: Addresses
) -> list[ObservedColumn]:
    """The columns that the items name."""
    sizes = {
        "qpos": model.nq,
        "qvel": model.nv,
        "act": model.na,
        "sensordata": model.nsensordata,
    }
    columns = []
    for item in items:
        field, places = item_columns(item, sizes, addresses)
        columns += [ObservedColumn(field, place) for place in places]
    return columns


def _first_places(model: mujoco.MjModel) -> dict[str, int]:
    """Where each field of the state begins in a full physics state, behind the time."""
    return {"qpos": 1, "qvel": 1 + model.nq, "act": 1 + model.nq + model.nv}


def _addresses(model: mujoco.MjModel) -> Addresses:
    """The elements in qpos, qvel, act and sensordata; all joints and actuators have names."""
    positions = {}
    velocities = {}
    for joint in all_joints(model):
        positions[joint.name] = (joint.qpos, len(joint.units("qpos")))
        velocities[joint.name] = (joint.qvel, len(joint.units("qvel")))
    activations = {}
    for name, i in element_names(model, "actuator").items():
        if model.actuator_actnum[i] > 0:
            activations[name] = (int(model.actuator_actadr[i]), int(model.actuator_actnum[i]))
    sensors = {}
    for name, i in element_names(model, "sensor").items():
        sensors[name] = (int(model.sensor_adr[i]), int(model.sensor_dim[i]))
    return {"qpos": positions, "qvel": velocities, "act": activations, "sensordata": sensors}


def _name(addresses: Addresses, column: ObservedColumn) -> str:
    """The name of a column, such as "qpos.thigh_joint".

    It is "qpos.box[0]" where the element has several numbers, "sensordata[3]" where it has no name.
    """
    for name, (start, count) in addresses[column.field].items():
        if start <= column.place < start + count:
            number = f"[{column.place - start}]" if count > 1 else ""
            return f"{column.field}.{name}{number}"
    return f"{column.field}[{column.place}]"


def _units(model: mujoco.MjModel) -> dict[tuple[str, int], str]:
    """The unit of each number of qpos, qvel and named sensors; a quaternion's have none."""
    out = {}
    for joint in all_joints(model):
        for i, unit in enumerate(joint.units("qpos")):
            out["qpos", joint.qpos + i] = unit
        for i, unit in enumerate(joint.units("qvel")):
            out["qvel", joint.qvel + i] = unit
    for sensor in named_sensors(model).values():
        for i, unit in enumerate(sensor.units):
            out["sensordata", sensor.place + i] = unit
    return out


def multiply(a: Array, b: Array) -> Array:
    """Multiply quaternions.

    Parameters
    ----------
    a, b : (..., 4) arrays
        Quaternions w, x, y, z.

    Returns
    -------
    (..., 4) array
        Their product a b.
    """
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
    """Turn rotation vectors into unit quaternions.

    Parameters
    ----------
    rotation : (..., 3) array
        Rotation vectors [rad].

    Returns
    -------
    (..., 4) array
        Quaternions w, x, y, z.
    """
    half = np.linalg.norm(rotation, axis=-1, keepdims=True) / 2
    return np.concatenate([np.cos(half), 0.5 * np.sinc(half / np.pi) * rotation], axis=-1)


def logarithm(quaternion: Array) -> Array:
    """Turn quaternions into rotation vectors.

    Parameters
    ----------
    quaternion : (..., 4) array
        Quaternions w, x, y, z of any length but 0.

    Returns
    -------
    (..., 3) array
        Rotation vectors of length at most pi [rad].
    """
    imaginary = quaternion[..., 1:] * np.where(quaternion[..., :1] < 0, -1.0, 1.0)
    real = np.abs(quaternion[..., 0])
    length = np.linalg.norm(imaginary, axis=-1)
    angle = 2 * np.arctan2(length, real)
    small = length < 1e-150
    limit = 2.0 / np.where(real > 0, real, 1.0)  # of angle / length as the length goes to 0
    factor = np.where(small, limit, angle / np.where(small, 1.0, length))
    return factor[..., None] * imaginary
