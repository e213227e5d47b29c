"""MuJoCo in C batches on threads: any MJCF, any number of the model as a parameter."""

import os
import queue
import threading
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from weakref import WeakKeyDictionary

import mujoco
import mujoco.rollout
import numpy as np
from numpy.typing import NDArray

from dropo.core.checks import Array, require
from dropo.core.data import Ints, Segments
from dropo.core.errors import BadArgument, BadFile
from dropo.core.parameters import ParameterSpace
from dropo.core.simulator import Simulator
from dropo.simulators.fields import MOVES_FRAMES, Binding, FieldParameter, element_names, item_columns
from dropo.simulators.observation import Layout

BUFFER = 1 << 25  # bytes of states that one call into C may return
HUGE = 1e10  # mjMAXVAL: beyond it MuJoCo itself calls a state divergent


class MujocoSimulator(Simulator):
    """Replays segments in MuJoCo, one C call for each parameter vector and block of segments, on Python threads.

    model: the path of an MJCF file, an MjSpec or an MjModel; parameters: FieldParameters; observation, action: the columns
    of the data's rows as slices of MuJoCo's fields; frame_skip: physics steps for which an action is held; threads:
    0 for all cores. State components that are not observed start at the model's qpos0 or zero. Results do not depend on
    the number of threads, bit for bit. Warm starts are off, since they make a result depend on what ran before it.
    """

    def __init__(
        self, model: str | Path | mujoco.MjSpec | mujoco.MjModel, parameters: Sequence[FieldParameter], *,
        observation: Sequence[str] = ("qpos", "qvel"), action: Sequence[str] = ("ctrl",), frame_skip: int = 1, threads: int = 0,
    ):  # fmt: skip
        require(frame_skip >= 1, "frame_skip", "at least 1", frame_skip, "MujocoSimulator")
        require(threads >= 0, "threads", "0 (all cores) or a number of threads", threads, "MujocoSimulator")
        self.space = ParameterSpace(tuple(parameters))
        self.model = load_model(model, [p.field for p in parameters])
        self.bindings = [Binding(p, self.model) for p in parameters]
        self.nominal = np.array([binding.nominal() for binding in self.bindings])
        self.layout = Layout(self.model, observation)
        self.signals = self.layout.signals
        self.controls = action_columns(self.model, action)
        self.frame_skip = self.steps_per_action = frame_skip
        self.threads = threads or os.cpu_count() or 1
        self._workers: queue.SimpleQueue[_Worker] = queue.SimpleQueue()
        for _ in range(self.threads):
            self._workers.put(_Worker(self.model, self.bindings))
        self._pool = ThreadPoolExecutor(self.threads, thread_name_prefix="mujoco")
        self._commands: WeakKeyDictionary[Segments, Array] = WeakKeyDictionary()

    @property
    def control_step(self) -> float:
        """Seconds for which one action is held."""
        return float(self.model.opt.timestep) * self.frame_skip

    def targets(self, segments: Segments) -> Array:
        return self.layout.coordinates(segments.targets, segments.targets)

    def _predict(self, values: Array, segments: Segments, offsets: Array | None) -> Array:
        require(segments.starts.shape[1] == len(self.layout), "segments", f"of {len(self.layout)} observed columns",
                segments.starts.shape[1], "MujocoSimulator.predict")  # fmt: skip
        out = np.empty((len(values), len(segments.rows[0]), len(self.signals)))
        commands, targets = self._command(segments), segments.targets
        row_of = np.concatenate([[0], np.cumsum(np.bincount(segments.rows[0], minlength=len(segments)))])

        def job(k: int, part: Ints) -> None:
            starts = segments.starts[part]
            if offsets is not None:
                starts = self.layout.move(starts, offsets[k, part])
            observed = self._replay(values[k], segments, part, starts, commands)  # one row a compared row of the part
            rows = np.concatenate([np.arange(row_of[i], row_of[i + 1]) for i in part]) if segments.every_step else part
            out[k, rows] = self.layout.coordinates(observed, targets[rows])

        parts = self._parts(segments, len(values))
        with quiet():
            for _ in self._pool.map(lambda task: job(*task), [(k, part) for k in range(len(values)) for part in parts]):
                pass
        return out

    def _parts(self, segments: Segments, draws: int) -> list[Ints]:
        """Blocks of segments for one C call each: small enough for memory, enough of them to keep the threads busy."""
        everything = np.arange(len(segments))
        if len(segments.levels) > 1:  # chains stay together
            return [everything]
        per_segment = int(segments.lengths.max()) * self.frame_skip * 8 * (1 + self.model.nq + self.model.nv + self.model.na)
        blocks = max(1, -(-len(segments) * per_segment // BUFFER), -(-2 * self.threads // draws) if draws < 2 * self.threads else 1)
        return np.array_split(everything, min(blocks, len(segments)))

    def _command(self, segments: Segments) -> Array:
        """(N, L, nu) commands, made once for each set of segments."""
        if segments not in self._commands:
            actions = segments.actions
            require(
                actions.shape[2] == len(self.controls),
                "segments",
                f"of {len(self.controls)} action columns",
                actions.shape[2],
                "MujocoSimulator",
            )
            commands = np.zeros((*actions.shape[:2], self.model.nu))
            commands[..., self.controls] = actions
            self._commands[segments] = commands
        return self._commands[segments]

    def _replay(self, value: Array, segments: Segments, part: Ints, starts: Array, commands: Array) -> Array:
        """Observations at the compared rows of a part of the segments, in their order."""
        worker = self._workers.get()
        try:
            worker.set(value)
            ends: dict[int, Array] = {}
            found: dict[int, Array] = {}
            for level in segments.levels if len(segments.levels) > 1 else [part]:
                for length in np.unique(segments.lengths[level]):
                    block = level[segments.lengths[level] == length]
                    states = self._start_states(segments, block, starts[np.searchsorted(part, block)], ends)
                    observed, last = self._roll(worker, states, commands[block, :length], segments.every_step)
                    found.update(zip(block.tolist(), observed, strict=True))
                    if len(segments.levels) > 1:
                        ends.update(zip(block.tolist(), last, strict=True))
        finally:
            self._workers.put(worker)
        return np.concatenate([found[i] for i in part.tolist()])

    def _start_states(self, segments: Segments, block: Ints, starts: Array, ends: dict[int, Array]) -> Array:
        states = np.zeros((len(block), mujoco.mj_stateSize(self.model, mujoco.mjtState.mjSTATE_FULLPHYSICS)))
        states[:, 1 : 1 + self.model.nq] = self.model.qpos0
        every = np.ones(len(self.layout), dtype=bool)
        before = segments.previous[block]
        if ends and before[0] >= 0:
            states[:] = np.stack([ends[i] for i in before.tolist()])
            states[:, 0] = 0.0
            every = segments.set_columns
        self.layout.write_start(states, starts, every, self.model)
        return states

    def _roll(self, worker: "_Worker", states: Array, commands: Array, every: bool) -> tuple[Array, Array]:
        """Observations (n, L or 1, P) after every action or the last, and the last states (n, s); NaN where MuJoCo stopped early."""
        trace, _ = worker.roll(states, np.repeat(commands, self.frame_skip, axis=1))
        first = 0 if every else commands.shape[1] - 1
        after = trace[:, self.frame_skip - 1 :: self.frame_skip][:, first:]
        sensors = self._sensors(worker, after, commands[:, first:]) if self.layout.needs_sensors else None
        observed = self.layout.observe(after, sensors, self.model)
        # MuJoCo halts a rollout at its first warning and repeats the state: its clock stands still.
        late = after[:, :, 0] < (np.arange(first + 1, commands.shape[1] + 1) * self.frame_skip - 0.5) * worker.model.opt.timestep
        bad = late | ~(np.abs(after) < HUGE).all(axis=2)
        observed[bad] = np.nan
        last = after[:, -1].copy()
        last[bad[:, -1]] = np.nan
        return observed, last

    def _sensors(self, worker: "_Worker", after: Array, commands: Array) -> Array:
        """Sensor data (n, J, m) of the states after an action, still under it: a step reports those of the state before it."""
        states = after.reshape(-1, after.shape[2])
        return worker.roll(states, commands.reshape(len(states), 1, self.model.nu))[1].reshape(*after.shape[:2], -1)


class _Worker:
    """One thread's own copy of the model and its data."""

    def __init__(self, model: mujoco.MjModel, bindings: Sequence[Binding]):
        self.model = _copy(model)
        self.data = mujoco.MjData(self.model)
        self.bindings = bindings

    def set(self, value: Array) -> None:
        """Writes a parameter vector (d,); mj_setConst follows those that want it, and leaves the others as written."""
        follow = [(b, v) for b, v in zip(self.bindings, value, strict=True) if b.parameter.derived]
        keep = [(b, v) for b, v in zip(self.bindings, value, strict=True) if not b.parameter.derived]
        for binding, _ in keep:  # else derived constants would depend on what this copy simulated before
            binding.set(self.model, binding.nominal())
        for binding, number in follow:
            binding.set(self.model, number)
        if follow:
            mujoco.mj_setConst(self.model, self.data)
        for binding, number in keep:
            binding.set(self.model, number)

    def roll(self, states: Array, controls: Array) -> tuple[Array, Array]:
        """States (n, steps, s) and sensor data (n, steps, m) from start states (n, s) under controls (n, steps, nu)."""
        control = controls if self.model.nu else None
        return mujoco.rollout.rollout(self.model, [self.data], states, control, nstep=controls.shape[1])


def _copy(model: mujoco.MjModel) -> mujoco.MjModel:
    import copy

    return copy.copy(model)


def load_model(model: str | Path | mujoco.MjSpec | mujoco.MjModel, fields: Sequence[str] = ()) -> mujoco.MjModel:
    """A model ready for fitting: warm start and automatic reset off, bodies compiled so that the fields may be edited."""
    if isinstance(model, mujoco.MjModel):
        moved = sorted(set(fields) & set(MOVES_FRAMES))
        require(not moved, "model", f"an MJCF file or an MjSpec where {moved} is fitted", "an MjModel", "MujocoSimulator")
        compiled = _copy(model)
    else:
        compiled = _compile(model, fields)
    compiled.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_WARMSTART | mujoco.mjtDisableBit.mjDSBL_AUTORESET
    return compiled


def _compile(model: str | Path | mujoco.MjSpec, fields: Sequence[str]) -> mujoco.MjModel:
    spec = model
    try:
        if not isinstance(spec, mujoco.MjSpec):
            if not Path(spec).is_file():
                raise BadFile(spec, "", "an MJCF file", "no such file")
            spec = mujoco.MjSpec.from_file(str(spec))
        if set(fields) & set(MOVES_FRAMES):
            for body in spec.bodies:
                body.simple = False
        return spec.compile()
    except (ValueError, RuntimeError) as error:
        if isinstance(error, BadFile):
            raise
        source = "the model" if isinstance(model, mujoco.MjSpec) else model
        raise BadFile(source, "", "a model that compiles", str(error).strip().replace("\n", "; ")) from None


def action_columns(model: mujoco.MjModel, items: Sequence[str]) -> NDArray[np.int64]:
    """(q,) the place in ctrl of each action column."""
    names = {"ctrl": {name: (i, 1) for name, i in element_names(model, "actuator").items()}}
    places = [i for item in items for i in item_columns(item, {"ctrl": model.nu}, names)[1]] if model.nu else []
    if len(set(places)) < len(places):
        raise BadArgument(f"The action items {list(items)} name an actuator twice.")
    return np.array(places, dtype=np.int64)


_LOCK = threading.Lock()
_handlers: list[Any] = []  # what was set when each `quiet` now open began; the first is the user's own


@contextmanager
def quiet() -> Iterator[None]:
    """Keeps MuJoCo from writing MUJOCO_LOG.TXT into the working directory; failures are found in the states.

    The handler is the whole process's: of overlapping ones on several threads, the last to end puts the user's own back.
    """
    with _LOCK:
        _handlers.append(mujoco.get_mju_user_warning())
        mujoco.set_mju_user_warning(lambda message: None)
    try:
        yield
    finally:
        with _LOCK:
            mujoco.set_mju_user_warning(_handlers.pop())
