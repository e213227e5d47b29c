"""MuJoCo Warp: worlds in single precision side by side, on a GPU or, for checks, on the CPU."""

import copy
import dataclasses
import warnings
from collections.abc import Sequence
from functools import cached_property

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
from dropo.simulators.mujoco.simulator import MujocoSimulator
from dropo.simulators.mujoco.worker import Worker
from dropo.simulators.warp.worlds import Room, Worlds, put_model

KEPT = 4
"""Of how many sizes worlds are kept for the next prediction."""

AHEAD = 3
"""How many sets of worlds a GPU simulates, or has simulated, while another is prepared."""

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

    def __init__(self, cpu: Simulator, *, device: str | None = None, worlds: int = 32_768):
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
        self._made: dict[tuple[int, int], list[Worlds]] = {}
        self._room = Room()
        self._worker = Worker(cpu.simulated, cpu.bindings)
        batched = self._fields_by_world()
        for binding in cpu.bindings:
            for field, _, _ in binding.entries(cpu.model):
                if field not in batched:
                    raise Incompatible(
                        f"Parameter {binding.parameter.name!r}: in Warp all worlds share one"
                        f" {field!r}. Use the simulator 'mujoco', or leave that parameter out."
                    )
        self._moved = self._moved_by_parameters(batched)

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
        task = _Task(self, values, segments, offsets)
        for level in segments.levels:
            for length in np.unique(segments.lengths[level]):
                own = level[segments.lengths[level] == length]
                self._fill(task, slice(0, len(values)), own)
            while task.begun:
                self._finish(task)
        return task.by_row.transpose(2, 0, 1)

    def _fill(self, task: "_Task", draws: slice, own: Ints) -> None:
        """Begin some segments of one length with some of the values, in halves where needed."""
        values = draws.stop - draws.start
        count = values * len(own)
        if count <= self.worlds:
            try:
                return self._begin(task, draws, own)
            except (RuntimeError, MemoryError) as error:
                said = str(error).lower()
                of_memory = isinstance(error, MemoryError) or "alloc" in said or "memory" in said
                if count == 1 or not of_memory:
                    raise
            self._made.clear()
            self.worlds = -(-count // 2)
            sentence = f"{self.device} has no memory for {count} worlds: going on with"
            warnings.warn(f"{sentence} {self.worlds}.", DropoWarning, stacklevel=2)
        if values > 1:
            middle = draws.start - (-values // 2)
            self._fill(task, slice(draws.start, middle), own)
            self._fill(task, slice(middle, draws.stop), own)
        else:
            middle = -(-len(own) // 2)
            self._fill(task, draws, own[:middle])
            self._fill(task, draws, own[middle:])

    def _begin(self, task: "_Task", draws: slice, own: Ints) -> None:
        """As `_fill`, all at once: world w has the w % K-th of the K values."""
        segments = task.segments
        fields = task.fields_of(draws)
        worlds = self._worlds_for(fields, draws.stop - draws.start, len(own))
        worlds.begin(
            fields,
            task.start_states(draws, own),
            task.commands[own, : segments.lengths[own[0]]],
            every=segments.every_step,
            sensors=self.cpu.layout.needs_sensors,
        )
        task.begun.append((worlds, draws, own))
        if len(task.begun) > AHEAD:
            self._finish(task)

    def _finish(self, task: "_Task") -> None:
        """Keep what the first of those found that have begun."""
        worlds, draws, own = task.begun.pop(0)
        task.keep(draws, own, *worlds.end())
        self._made.setdefault((draws.stop - draws.start, len(own)), []).append(worlds)

    def _worlds_for(self, fields: dict[str, Array], values: int, segments: int) -> Worlds:
        """Worlds for so many values and segments, from before where there are such."""
        waiting = self._made.get((values, segments))
        if waiting:
            return waiting.pop()
        if len(self._made) > KEPT:
            del self._made[next(iter(self._made))]
        count = values * segments
        return Worlds(self._model, fields, count, self.device, self.steps_per_action, self._room)

    # --- the model in Warp

    def _fields_by_world(self) -> list[str]:
        """Fields of the model of which every world may have its own numbers."""
        held = put_model(self._model, self.device, {})
        found = []
        for prefix, part in (("", held), (OPTION, held.opt)):
            for field in dataclasses.fields(part):
                spec = getattr(field.type, "shape", None)
                if spec and spec[0] == "*":
                    ours = np.shape(_numbers_of(self._model, prefix + field.name))
                    theirs = getattr(part, field.name).numpy().shape[1:]
                    found += [prefix + field.name] * (ours == theirs and 0 not in ours)
        return found

    def _moved_by_parameters(self, fields: Sequence[str]) -> list[str]:
        """Those of the fields that are not the model's own under some values of the parameters."""
        probes = np.array([0.0, 0.4, 1.0])[:, None] * np.ones(len(self.space))
        numbers = self._numbers(self.space.from_unit(probes), fields)
        own = {name: _numbers_of(self._model, name) for name in fields}
        return [name for name, rows in numbers.items() if (rows != own[name]).any()]

    def _numbers(self, values: Array, fields: Sequence[str]) -> dict[str, Array]:
        """The numbers (K, ...) of fields under each parameter vector."""
        worker = self._worker
        found = {
            name: np.empty((len(values), *_numbers_of(self._model, name).shape)) for name in fields
        }
        for row, value in enumerate(values):
            worker.set(value)
            for name in fields:
                found[name][row] = _numbers_of(worker.model, name)
        return found


class _Task:
    """What a prediction is made of: numbers by value, starts, commands, and what is found."""

    def __init__(
        self, simulator: WarpSimulator, values: Array, segments: Segments, offsets: Array | None
    ):
        self.segments = segments
        self._simulator = simulator
        self._values = values
        self._fields: dict[tuple[int, int], dict[str, Array]] = {}
        self.commands = simulator.cpu.commands_of(segments.actions)
        # The values side by side, as moments over them are computed fastest.
        self.by_row = np.empty((len(segments.rows[0]), len(simulator.signals), len(values)))
        self._layout = simulator.cpu.layout
        self._model = simulator.cpu.model
        self._offsets = offsets
        self._targets = segments.targets
        self.begun: list[tuple[Worlds, slice, Ints]] = []
        self._first_row = np.searchsorted(segments.rows[0], np.arange(len(segments)))
        size = 1 + self._model.nq + self._model.nv + self._model.na
        chained = len(segments.levels) > 1
        self._ends = np.empty((len(values), len(segments), size)) if chained else None

    def fields_of(self, draws: slice) -> dict[str, Array]:
        """The numbers (K, ...) by field of some of the values; computed when first asked for."""
        simulator = self._simulator
        key = (draws.start, draws.stop)
        if key not in self._fields:
            self._fields[key] = simulator._numbers(self._values[draws], simulator._moved)
        return self._fields[key]

    @cached_property
    def _measured(self) -> Array:
        """Physics states (N, 1 + nq + nv + na) at the measured starts of all segments."""
        return self._layout.full_states(self.segments.starts, self._model)

    def start_states(self, draws: slice, own: Ints) -> Array:
        """Physics states (N, K, s), or (N, 1, s) where the same for all values, in which segments
        start: the measured ones, or where others ended.
        """
        segments = self.segments
        before = segments.previous[own]
        goes_on = self._ends is not None and before[0] >= 0
        if self._offsets is None and not goes_on:
            return self._measured[own][:, None]
        values = draws.stop - draws.start
        starts = np.repeat(segments.starts[own], values, axis=0)
        if self._offsets is not None:
            starts = self._layout.move(starts, _by_segment(self._offsets, draws, own))
        if self._ends is None or not goes_on:
            states = self._layout.full_states(starts, self._model)
        else:
            states = _by_segment(self._ends, draws, before)
            states[:, 0] = 0.0
            self._layout.write_start(states, starts, segments.set_columns, self._model)
        return states.reshape(len(own), values, -1)

    def keep(self, draws: slice, own: Ints, states: Array, sensors: Array | None) -> None:
        """Write the states (W, L or 1, s) and sensor data of W worlds where they belong."""
        seen = self._layout.observe(states, sensors, self._model)
        rows = self._first_row[own, None] + np.arange(seen.shape[1])
        values = draws.stop - draws.start
        shape = (len(own), values, *seen.shape[1:])
        measured = self._targets[rows][:, None]
        found = self._layout.coordinates(seen.reshape(shape), measured).transpose(0, 2, 3, 1)
        self.by_row[rows.ravel(), :, draws] = found.reshape(rows.size, -1, values)
        if self._ends is not None:
            self._ends[draws, own] = states[:, -1].reshape(len(own), values, -1).swapaxes(0, 1)


def _by_segment(rows: Array, draws: slice, own: Ints) -> Array:
    """Rows (N K, s) of some values and segments, of all (V, M, s): values vary fastest."""
    return rows[draws][:, own].swapaxes(0, 1).reshape(-1, rows.shape[-1])


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
