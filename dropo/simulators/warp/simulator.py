"""MuJoCo Warp: worlds in single precision side by side, on a GPU or, for checks, on the CPU."""

import copy
import dataclasses
import warnings
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from dropo.core.contracts.simulator import Simulator
from dropo.core.records.trajectories import Ints, Segments
from dropo.core.services.errors import Incompatible
from dropo.core.services.optional_dependencies import need
from dropo.core.services.run_warning import DropoWarning
from dropo.core.services.validation import Array, require
from dropo.mjmodel.fields import OPTION
from dropo.mjmodel.names import element_of_type
from dropo.simulators.mujoco.simulator import MAX_STATE, MujocoSimulator
from dropo.simulators.mujoco.worker import Worker

ROOM = 6
"""How often the room for contacts and constraints is doubled where a world needs more."""

ON_THE_CPU = (
    "Warp finds no CUDA device and simulates on the CPU, in single precision and about 30 times"
    " slower than MuJoCo itself: leave the simulator 'warp' out, or use a computer with a GPU."
)


class WarpSimulator(Simulator):
    """Replays segments in MuJoCo Warp: each parameter vector and segment is a world of its own.

    What parameters change in the model, with the constants that follow from it, is computed by
    MuJoCo in double precision and written into each world.

    Parameters
    ----------
    cpu : MujocoSimulator
        In whose place it is: the model, its parameters, and the columns of the data.
    device : str, optional
        As Warp names them: "cuda:0", "cpu"; by default a GPU where there is one, else the CPU,
        with a warning.
    worlds : int
        How many are simulated at a time at most; halved, with a warning, where memory ends.

    Raises
    ------
    MissingPackage
        If Warp or MuJoCo Warp is not installed.
    BadArgument
        If `worlds` is less than 1.
    Incompatible
        If Warp cannot hold the model, an effect or a parameter, or has no such device.
    """

    takes_over = True
    minimum_step = float(np.finfo(np.float32).eps ** (1 / 3))

    def __init__(self, cpu: Simulator, *, device: str | None = None, worlds: int = 8192):
        if not isinstance(cpu, MujocoSimulator):
            kind = type(cpu).__name__
            raise Incompatible(f"Warp simulates MuJoCo models, and {kind} has none.")
        require(worlds >= 1, "worlds", "at least 1", worlds, "WarpSimulator")
        for instance in [*cpu.effects, *(instance for instance, _ in cpu.fixed)]:
            raise Incompatible(
                f"Warp holds no effects, and the simulation has {instance.label}. Use the simulator"
                " 'mujoco', or leave that effect out."
            )
        self.cpu = cpu
        self.model = cpu.model
        self.worlds = worlds
        for name in ("space", "signals", "nominal", "control_step", "steps_per_action"):
            setattr(self, name, getattr(cpu, name))
        self.device = _device(device)
        self._model = copy.copy(cpu.model)
        # Warp resets no world by itself.
        self._model.opt.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
        self._batched = self._fields_by_world()
        for binding in cpu.bindings:
            for field, _, _ in binding.entries(cpu.model):
                if field not in self._batched:
                    raise Incompatible(
                        f"Parameter {binding.parameter.name!r}: in Warp all worlds share one"
                        f" {field!r}. Use the simulator 'mujoco', or leave that parameter out."
                    )

    def targets(self, segments: Segments) -> Array:
        """Measured signals (R, p) at every compared row; rotations are 0."""
        return self.cpu.targets(segments)

    def in_contact(self, segments: Segments) -> NDArray[np.bool_]:
        """(N,) whether bodies overlap in each segment's measured start."""
        return self.cpu.in_contact(segments)

    @property
    def state_coordinates(self) -> NDArray[np.bool_]:
        """Which start coordinates (s,) are of qpos, qvel or act, and not of sensor data."""
        return self.cpu.state_coordinates

    def observing_state(self) -> tuple[Simulator, Array]:
        """The same for data that hold the state whole, and what further columns rest at."""
        whole, columns = self.cpu.observing_state()
        if whole is self.cpu:
            return self, columns
        return WarpSimulator(whole, device=self.device, worlds=self.worlds), columns

    def with_finer_steps(self, times: int) -> "WarpSimulator":
        """Make the same simulator with shorter physics steps.

        Parameters
        ----------
        times : int
            Steps in the place of one.

        Returns
        -------
        WarpSimulator
            A new one, whose counts of steps and failures begin at 0.
        """
        finer = self.cpu.with_finer_steps(times)
        return WarpSimulator(finer, device=self.device, worlds=self.worlds)

    def _predict(self, values: Array, segments: Segments, offsets: Array | None) -> Array:
        out = np.empty((len(values), len(segments.rows[0]), len(self.signals)))
        fields = self._numbers(values)
        commands = self.cpu.commands_of(segments.actions)
        targets = segments.targets
        first_row = np.searchsorted(segments.rows[0], np.arange(len(segments)))
        ends: Array | None = None
        if len(segments.levels) > 1:
            size = 1 + self._model.nq + self._model.nv + self._model.na
            ends = np.empty((len(values), len(segments), size))
        for level in segments.levels:
            for length in np.unique(segments.lengths[level]):
                block = level[segments.lengths[level] == length]
                begin = 0
                while begin < len(values) * len(block):  # self.worlds may shrink on the way
                    stop = min(begin + self.worlds, len(values) * len(block))
                    draw, place = np.divmod(np.arange(begin, stop), len(block))
                    own = block[place]
                    begin = stop
                    states = self._start_states(segments, own, draw, offsets, ends)
                    numbers = {name: array[draw] for name, array in fields.items()}
                    every = segments.every_step
                    seen, last = self._simulate(numbers, states, commands[own, :length], every)
                    rows = first_row[own, None] + np.arange(seen.shape[1])
                    out[draw[:, None], rows] = self.cpu.layout.coordinates(seen, targets[rows])
                    if ends is not None:
                        ends[draw, own] = last
        return out

    def _start_states(
        self, segments: Segments, own: Ints, draw: Ints, offsets: Array | None, ends: Array | None
    ) -> Array:
        """Physics states (W, 1 + nq + nv + na) at the starts of segments, or where others ended."""
        layout = self.cpu.layout
        starts = segments.starts[own]
        if offsets is not None:
            starts = layout.move(starts, offsets[draw, own])
        before = segments.previous[own]
        if ends is None or before[0] < 0:
            return layout.full_states(starts, self._model)
        states = ends[draw, before]
        states[:, 0] = 0.0
        layout.write_start(states, starts, segments.set_columns, self._model)
        return states

    # --- the model in Warp

    def _put(self, sizes: dict[str, int]) -> Any:
        """Warp's model, some fields by world; Incompatible, with the element, where it has none."""
        import mujoco_warp
        import warp as wp

        try:
            with wp.ScopedDevice(self.device):
                return mujoco_warp.put_model(self._model, batch_sizes=sizes)
        except NotImplementedError as error:
            where = element_of_type(self._model, str(error))
            raise Incompatible(f"Warp cannot hold {where}: {error}") from None

    def _fields_by_world(self) -> list[str]:
        """Fields of the model of which every world may have its own numbers."""
        held = self._put({})
        found = []
        for prefix, part in (("", held), (OPTION, held.opt)):
            for field in dataclasses.fields(part):
                spec = getattr(field.type, "shape", None)
                if spec and spec[0] == "*":
                    ours = np.shape(_numbers_of(self._model, prefix + field.name))
                    theirs = getattr(part, field.name).numpy().shape[1:]
                    found += [prefix + field.name] * (ours == theirs and 0 not in ours)
        return found

    def _numbers(self, values: Array) -> dict[str, Array]:
        """The fields that differ from the model's, (K, ...) of each parameter vector."""
        worker = Worker(self.cpu.simulated, self.cpu.bindings)
        rows: dict[str, list[Array]] = {name: [] for name in self._batched}
        for value in values:
            worker.set(value)
            for name, numbers in rows.items():
                numbers.append(_numbers_of(worker.model, name).copy())
        found = {}
        for name, numbers in rows.items():
            own = np.stack(numbers)
            if (own != _numbers_of(self._model, name)).any():
                found[name] = own
        return found

    # --- worlds

    def _simulate(
        self, numbers: dict[str, Array], states: Array, commands: Array, every: bool
    ) -> tuple[Array, Array]:
        """Observations (W, L or 1, P) and last states of W worlds, in halves where memory ends."""
        try:
            return self._roll(numbers, states, commands, every)
        except (RuntimeError, MemoryError) as error:
            said = str(error).lower()
            of_memory = isinstance(error, MemoryError) or "alloc" in said or "memory" in said
            if len(states) == 1 or not of_memory:
                raise
        half = -(-len(states) // 2)
        self.worlds = min(self.worlds, half)
        sentence = f"{self.device} has no memory for {len(states)} worlds: going on with {half}."
        warnings.warn(sentence, DropoWarning, stacklevel=2)
        seen = []
        last = []
        for which in (slice(0, half), slice(half, None)):
            own = {name: array[which] for name, array in numbers.items()}
            found = self._simulate(own, states[which], commands[which], every)
            seen.append(found[0])
            last.append(found[1])
        return np.concatenate(seen), np.concatenate(last)

    def _roll(
        self, numbers: dict[str, Array], states: Array, commands: Array, every: bool
    ) -> tuple[Array, Array]:
        """As `_simulate`, all at once, with more room where a world has more contacts than held."""
        import mujoco_warp
        import warp as wp

        held = self._put({name: len(states) for name in numbers if not name.startswith(OPTION)})
        kinds = mujoco_warp.OverflowType
        full = kinds.NEFC | kinds.NJMAX_NNZ | kinds.BROADPHASE | kinds.NARROWPHASE
        room: dict[str, int] = {}
        with wp.ScopedDevice(self.device):
            for name, array in numbers.items():
                owner = held.opt if name.startswith(OPTION) else held
                field = name.removeprefix(OPTION)
                kind = getattr(owner, field).dtype
                setattr(owner, field, wp.array(array.astype(np.float32), dtype=kind))
            for _ in range(ROOM):
                data = mujoco_warp.make_data(self._model, nworld=len(states), **room)
                found = self._trace(held, data, states, commands, every)
                if not np.bitwise_or.reduce(data.overflow.numpy()) & full:
                    return found
                room = {"naconmax": 2 * data.naconmax, "njmax": 2 * data.njmax}
        raise Incompatible(f"Warp has no room for more than {data.njmax} constraints in a world.")

    def _trace(
        self, held: Any, data: Any, states: Array, commands: Array, every: bool
    ) -> tuple[Array, Array]:
        """Step worlds through their commands (W, L, nu), on a GPU an action a launch."""
        import mujoco_warp
        import warp as wp

        graph = None
        if wp.get_device(self.device).is_cuda:
            mujoco_warp.step(held, data)  # compiles what cannot be compiled while it is captured
            with wp.ScopedCapture() as capture:
                for _ in range(self.steps_per_action):
                    mujoco_warp.step(held, data)
            graph = capture.graph
            for array in (data.time, data.qacc_warmstart, data.overflow):
                array.zero_()
        model = self._model
        place = 1
        for field, size in (("qpos", model.nq), ("qvel", model.nv), ("act", model.na)):
            if size:
                getattr(data, field).assign(states[:, place : place + size].astype(np.float32))
            place += size
        observed = []
        for step in range(commands.shape[1]):
            if model.nu:
                data.ctrl.assign(commands[:, step].astype(np.float32))
            if graph is not None:
                wp.capture_launch(graph)
            for _ in range(0 if graph else self.steps_per_action):
                mujoco_warp.step(held, data)
            if not every and step < commands.shape[1] - 1:
                continue
            parts = [data.time.numpy()[:, None], data.qpos.numpy(), data.qvel.numpy()]
            parts.append(data.act.numpy().reshape(len(states), model.na))
            now = np.concatenate(parts, axis=1).astype(float)
            now[~(np.abs(now) < MAX_STATE).all(axis=1)] = np.nan
            sensors = None
            if self.cpu.layout.needs_sensors:
                mujoco_warp.forward(held, data)
                sensors = data.sensordata.numpy().astype(float)
            observed.append(self.cpu.layout.observe(now, sensors, model))
        return np.stack(observed, axis=1), now


def _numbers_of(model: mujoco.MjModel, name: str) -> Array:
    """The numbers of a field of a model or of its options; none where it has no such field."""
    owner = model.opt if name.startswith(OPTION) else model
    return np.asarray(getattr(owner, name.removeprefix(OPTION), np.empty(0)), dtype=float)


def _device(named: str | None) -> str:
    """The device, by default a GPU where there is one; Incompatible where there is no such."""
    need("warp", "mujoco_warp", extra="warp", caller="The simulator 'warp'")
    import warp as wp

    wp.config.log_level = max(wp.config.log_level, wp.LOG_ERROR)  # else it prints what it compiles
    there = [str(device) for device in wp.get_devices()]
    chosen = named or next((name for name in there if name.startswith("cuda")), "cpu")
    if chosen not in there:
        raise Incompatible(f"Warp finds no device {chosen!r}. It finds {', '.join(there)}.")
    if named is None and chosen == "cpu":
        warnings.warn(ON_THE_CPU, DropoWarning, stacklevel=3)
    return chosen
