"""Worlds of a model in MuJoCo Warp, which are made once and simulated again and again."""

from collections.abc import Mapping
from typing import Any

import mujoco
import numpy as np

from dropo.core.services.errors import Incompatible
from dropo.core.services.validation import Array
from dropo.mjmodel.fields import OPTION
from dropo.mjmodel.names import element_of_type
from dropo.mjmodel.observation import Layout
from dropo.simulators.mujoco.simulator import MAX_STATE

ROOM = 6
"""How often the room for contacts and constraints is doubled where a world needs more."""

CARRIED = ("time", "qacc_warmstart", "overflow", "history")
"""What a step leaves behind for the next one, beside the state."""


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
    ):
        self._model = model
        self._count = count
        self._device = device
        self._steps = steps
        rows = {name: len(array) for name, array in fields.items()}
        held = {name: size for name, size in rows.items() if not name.startswith(OPTION)}
        self._held = put_model(model, device, held)
        self._arrays = self._own_arrays(fields)
        self._make_room({})

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

    def _make_room(self, room: dict[str, int]) -> None:
        """Make the worlds' data, with room for so many contacts and constraints, and the graph."""
        import mujoco_warp
        import warp as wp

        self._graph = None
        with wp.ScopedDevice(self._device):
            self._data = mujoco_warp.make_data(self._model, nworld=self._count, **room)
            carried = [getattr(self._data, name) for name in CARRIED if hasattr(self._data, name)]
            self._fresh = [(array, wp.clone(array)) for array in carried]
            if not wp.get_device(self._device).is_cuda:
                return
            mujoco_warp.step(self._held, self._data)  # compiles what no capture can compile
            with wp.ScopedCapture() as capture:
                for _ in range(self._steps):
                    mujoco_warp.step(self._held, self._data)
            self._graph = capture.graph

    def roll(
        self,
        fields: Mapping[str, Array],
        states: Array,
        commands: Array,
        layout: Layout,
        every: bool,
    ) -> tuple[Array, Array]:
        """Simulate all worlds, with more room where one has more contacts than are held.

        Parameters
        ----------
        fields : dict of str to (K, ...) array
            Numbers by field, of the fields and of the K of the beginning.
        states : (W, 1 + nq + nv + na) array
            Physics states.
        commands : (W, L, nu) array
            Commands of L actions.
        layout : Layout
            What is observed.
        every : bool
            Whether after every action, or after the last alone.

        Returns
        -------
        seen : (W, L or 1, P) array
            Observations; NaN where a world diverged.
        last : (W, 1 + nq + nv + na) array
            Physics states at the end.

        Raises
        ------
        Incompatible
            If there is no room for all constraints.
        """
        import mujoco_warp

        kinds = mujoco_warp.OverflowType
        full = kinds.NEFC | kinds.NJMAX_NNZ | kinds.BROADPHASE | kinds.NARROWPHASE
        for name, array in fields.items():
            self._arrays[name].assign(array.astype(np.float32))
        for _ in range(ROOM):
            found = self._trace(states, commands, layout, every)
            data = self._data
            if not np.bitwise_or.reduce(data.overflow.numpy()) & full:
                return found
            self._make_room({"naconmax": 2 * data.naconmax, "njmax": 2 * data.njmax})
        raise Incompatible(f"Warp has no room for more than {data.njmax} constraints in a world.")

    def _trace(
        self, states: Array, commands: Array, layout: Layout, every: bool
    ) -> tuple[Array, Array]:
        """Step worlds from states through their commands; as `roll`, whatever overflows."""
        import mujoco_warp
        import warp as wp

        model = self._model
        data = self._data
        for array, fresh in self._fresh:
            wp.copy(array, fresh)
        place = 1
        for field, size in (("qpos", model.nq), ("qvel", model.nv), ("act", model.na)):
            if size:
                getattr(data, field).assign(states[:, place : place + size].astype(np.float32))
            place += size
        observed = []
        for step in range(commands.shape[1]):
            if model.nu:
                data.ctrl.assign(commands[:, step].astype(np.float32))
            self._act()
            if not every and step < commands.shape[1] - 1:
                continue
            parts = [data.time.numpy()[:, None], data.qpos.numpy(), data.qvel.numpy()]
            parts.append(data.act.numpy().reshape(len(states), model.na))
            now = np.concatenate(parts, axis=1).astype(float)
            now[~(np.abs(now) < MAX_STATE).all(axis=1)] = np.nan
            sensors = None
            if layout.needs_sensors:
                with wp.ScopedDevice(self._device):
                    mujoco_warp.forward(self._held, data)
                sensors = data.sensordata.numpy().astype(float)
            observed.append(layout.observe(now, sensors, model))
        return np.stack(observed, axis=1), now

    def _act(self) -> None:
        """Make the steps of an action, on a GPU with one launch."""
        import mujoco_warp
        import warp as wp

        with wp.ScopedDevice(self._device):
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
            return mujoco_warp.put_model(model, batch_sizes=rows)
    except NotImplementedError as error:
        where = element_of_type(model, str(error))
        raise Incompatible(f"Warp cannot hold {where}: {error}") from None
