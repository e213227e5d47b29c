"""Worlds of a model in MuJoCo Warp, which are made once and simulated again and again."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from dropo.core.services.errors import Incompatible
from dropo.core.services.validation import Array
from dropo.mjmodel.fields import OPTION
from dropo.mjmodel.names import element_of_type
from dropo.simulators.mujoco.simulator import MAX_STATE

ROOM = 8
"""How often the room for contacts and constraints is doubled where a world needs more."""

CARRIED = ("time", "qacc_warmstart", "overflow", "history")
"""What a step leaves behind for the next one, beside the state."""

STATE = ("time", "qpos", "qvel", "act")
"""Warp's fields of a physics state, in its order."""

SMALL = 16
"""Up to how many degrees of freedom a world's matrices take the threads of one warp, not of four:
more would have nothing to do, and wait for each other.
"""


@dataclass
class Room:
    """What is held for a world at most; what is held and not needed costs time."""

    contacts: int = 8
    rows: int = 32

    def double(self) -> None:
        """Hold twice as much."""
        self.contacts *= 2
        self.rows *= 2


class Worlds:
    """Worlds side by side, each with its own numbers in some fields of the model.

    Parameters
    ----------
    model : MjModel
        What they have in common.
    fields : dict of str to (K, ...) array
        Numbers by field, as they are first: world w has those of row w % K.
    count : int
        The number W of worlds.
    device : str
        Where Warp holds them.
    steps : int
        Physics steps of an action.
    room : Room
        For contacts and constraints; it grows where a world needs more.

    Raises
    ------
    Incompatible
        If Warp cannot hold the model.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        fields: Mapping[str, Array],
        count: int,
        device: str,
        steps: int,
        room: Room,
    ):
        import warp as wp

        self.room = room
        self._model = model
        self._count = count
        self._device = device
        self._on_gpu = wp.get_device(device).is_cuda
        self._stream = wp.Stream(device) if self._on_gpu else None
        self._steps = steps
        rows = {name: len(own) for name, own in fields.items() if not name.startswith(OPTION)}
        self._held = put_model(model, device, rows)
        self._arrays = self._own_arrays(fields)
        self._copies: dict[str, Any] = {}
        self._staged: dict[str, Any] = {
            name: self._on_host(array.shape, array.dtype) for name, array in self._arrays.items()
        }
        self._make_room()

    @contextmanager
    def _queue(self) -> Iterator[None]:
        """The device, and a queue that others' work does not wait for."""
        import warp as wp

        with wp.ScopedDevice(self._device), wp.ScopedStream(self._stream):
            yield

    def _own_arrays(self, fields: Mapping[str, Array]) -> dict[str, Any]:
        """Arrays of rows of their own, by field, in the place of those that Warp made."""
        import warp as wp

        arrays: dict[str, Any] = {}
        for name, array in fields.items():
            owner = self._held.opt if name.startswith(OPTION) else self._held
            field = name.removeprefix(OPTION)
            kind = getattr(owner, field).dtype
            arrays[name] = wp.array(array.astype(np.float32), dtype=kind, device=self._device)
            setattr(owner, field, arrays[name])
        return arrays

    def _make_room(self) -> None:
        """Make the worlds' data, with room for contacts and constraints, and the graph."""
        import mujoco_warp
        import warp as wp

        self._graph = None
        contacts, rows = self._held_room = (self.room.contacts, self.room.rows)
        with self._queue():
            self._data = mujoco_warp.make_data(
                self._model, nworld=self._count, nconmax=contacts, njmax=rows
            )
            for name in STATE[1:]:
                own = getattr(self._data, name)
                self._staged[name] = self._on_host(own.shape, own.dtype)
            carried = [getattr(self._data, name) for name in CARRIED if hasattr(self._data, name)]
            self._fresh = [(array, wp.clone(array)) for array in carried if array.size]
            if not self._on_gpu:
                return
            mujoco_warp.step(self._held, self._data)  # compiles what no capture can compile
            with wp.ScopedCapture() as capture:
                for _ in range(self._steps):
                    mujoco_warp.step(self._held, self._data)
            self._graph = capture.graph

    def begin(
        self,
        fields: Mapping[str, Array],
        states: Array,
        commands: Array,
        *,
        every: bool,
        sensors: bool,
    ) -> None:
        """Begin to simulate all worlds; a GPU goes on with it while the caller does other things.

        Parameters
        ----------
        fields : dict of str to (K, ...) array
            Numbers by field, of the fields and of the K of the beginning.
        states : (N, K or 1, 1 + nq + nv + na) array
            Physics states of N times K worlds.
        commands : (N, L, nu) array
            Commands of L actions, the same in K worlds.
        every : bool
            Whether what follows every action is kept, or what follows the last alone.
        sensors : bool
            Whether sensor data are kept.
        """
        for name, array in fields.items():
            self._staged[name].numpy()[:] = array
        self._asked = (states, commands, every, sensors)
        self._launch()

    def _launch(self) -> None:
        """Put all that is asked for into the device's queue."""
        import mujoco_warp
        import warp as wp

        states, commands, every, sensors = self._asked
        data = self._data
        places, actions, _ = commands.shape
        with self._queue():
            for array, fresh in self._fresh:
                wp.copy(array, fresh)
            for name, array in self._arrays.items():
                wp.copy(array, self._staged[name])
            place = 1
            for name in STATE[1:]:
                staged = self._staged[name]
                if staged.size:
                    own = states[..., place : place + staged.shape[1]]
                    staged.numpy().reshape(places, -1, staged.shape[1])[:] = own
                    wp.copy(getattr(data, name), staged)
                place += staged.shape[1]
            by_action = self._stage_commands(commands)
            names = [*STATE, "overflow", *(["sensordata"] if sensors else [])]
            self._prepare_copies(names, actions if every else 1)
            for action in range(actions):
                if by_action.size:
                    wp.copy(data.ctrl, by_action[action])
                self._act()
                if every or action == actions - 1:
                    if sensors:
                        mujoco_warp.forward(self._held, data)
                    for name, copies in self._copies.items():
                        wp.copy(copies[action if every else 0], getattr(data, name))
            if self._on_gpu:
                self._done = wp.record_event()

    def _stage_commands(self, commands: Array) -> Any:
        """The commands on the host, (L, W, nu)."""
        places, actions, size = commands.shape
        shape = (actions, self._count, size)
        staged = self._staged.get("commands")
        if staged is None or staged.shape != shape:
            staged = self._staged["commands"] = self._on_host(shape, float)
        if staged.size:
            by_action = commands.swapaxes(0, 1)[:, :, None]
            staged.numpy().reshape(actions, places, -1, size)[:] = by_action
        return staged

    def _on_host(self, shape: tuple[int, ...], kind: Any) -> Any:
        """An array on the host, from and to which a GPU copies while the caller goes on."""
        import warp as wp

        return wp.empty(shape, dtype=kind, device="cpu", pinned=self._on_gpu)

    def _prepare_copies(self, names: list[str], count: int) -> None:
        """Make arrays on the host (count, W, ...) for what is kept of the worlds' data."""
        fields = {name: getattr(self._data, name) for name in names}
        shapes = {name: (count, *array.shape) for name, array in fields.items() if array.size}
        if shapes != {name: copies.shape for name, copies in self._copies.items()}:
            self._copies = {
                name: self._on_host(shape, fields[name].dtype) for name, shape in shapes.items()
            }

    def end(self) -> tuple[Array, Array | None]:
        """Wait for what has begun, with more room where a world had more contacts than were held.

        Returns
        -------
        states : (W, L or 1, 1 + nq + nv + na) array
            Physics states; NaN where a world diverged.
        sensors : (W, L or 1, nsensordata) array or None
            Sensor data, where they were asked for.

        Raises
        ------
        Incompatible
            If there is no room for all constraints.
        """
        import mujoco_warp
        import warp as wp

        kinds = mujoco_warp.OverflowType
        full = kinds.NEFC | kinds.NJMAX_NNZ | kinds.BROADPHASE | kinds.NARROWPHASE
        for _ in range(ROOM):
            if self._on_gpu:
                wp.synchronize_event(self._done)
            found = {name: copies.numpy() for name, copies in self._copies.items()}
            if not np.bitwise_or.reduce(found.pop("overflow"), axis=None) & full:
                break
            if self._held_room == (self.room.contacts, self.room.rows):
                self.room.double()
            self._make_room()
            self._launch()
        else:
            rows = self.room.rows
            raise Incompatible(f"Warp has no room for more than {rows} constraints in a world.")
        found["time"] = found["time"][..., None]
        parts = [found[name] for name in STATE if name in found]
        states = np.concatenate(parts, axis=-1).swapaxes(0, 1)
        if not (states.max() < MAX_STATE and states.min() > -MAX_STATE):
            states[~(np.abs(states) < MAX_STATE).all(axis=-1)] = np.nan
        sensors = found.get("sensordata")
        return states, None if sensors is None else sensors.swapaxes(0, 1)

    def _act(self) -> None:
        """Make the steps of an action, on a GPU with one launch."""
        import mujoco_warp
        import warp as wp

        if self._graph is not None:
            wp.capture_launch(self._graph)
            return
        for _ in range(self._steps):
            mujoco_warp.step(self._held, self._data)


def put_model(model: mujoco.MjModel, device: str, rows: dict[str, int]) -> Any:
    """Make Warp's model.

    Parameters
    ----------
    model : MjModel
        The compiled model.
    device : str
        Where Warp holds it.
    rows : dict of str to int
        The fields of which not all worlds share one row, with how many rows they have.

    Returns
    -------
    mujoco_warp.Model

    Raises
    ------
    Incompatible
        If Warp cannot hold an element, which is named.
    """
    import mujoco_warp
    import warp as wp

    try:
        with wp.ScopedDevice(device):
            held = mujoco_warp.put_model(model, batch_sizes=rows)
    except NotImplementedError as error:
        where = element_of_type(model, str(error))
        raise Incompatible(f"Warp cannot hold {where}: {error}") from None
    held.nlight = 0
    if not model.nsensor:  # nor one of a camera
        held.ncam = 0
    if model.nv <= SMALL:
        for name in ("update_gradient_JTDAJ_dense", "update_gradient_cholesky", "small_cholesky"):
            setattr(held.block_dim, name, 32)
    return held
