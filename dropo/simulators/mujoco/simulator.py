"""MuJoCo in C batches on threads: any MJCF, any number of the model as a parameter."""

import copy
import os
import queue
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cached_property
from pathlib import Path
from typing import Any
from weakref import WeakKeyDictionary

import mujoco
import numpy as np
from numpy.typing import NDArray

from dropo.core.contracts.effect import ActiveEffects, EffectContext, EffectInstance, magnitudes_of
from dropo.core.records.parameters import ParameterSpace
from dropo.core.records.trajectories import Ints, Segments
from dropo.core.services.errors import BadArgument, Incompatible
from dropo.core.services.validation import Array, require
from dropo.mjmodel.contacts import touching
from dropo.mjmodel.fields import MOVES_FRAMES, Binding, FieldParameter, item_columns
from dropo.mjmodel.loading import load_model, specification
from dropo.mjmodel.names import element_names
from dropo.mjmodel.observation import Layout
from dropo.mjmodel.robot_simulator import RobotSimulator
from dropo.simulators.mujoco.layers import (
    by_time_profile,
    changes_commands,
    commands_of,
    curvatures_of,
    declared_values,
    lateness,
    seen_late,
    sensed,
    slopes_of,
    true_starts,
)
from dropo.simulators.mujoco.warnings import quiet
from dropo.simulators.mujoco.worker import Worker, clamps_itself

BUFFER = 1 << 25  # bytes of states that one call into C may return
HUGE = 1e10  # mjMAXVAL: beyond it MuJoCo itself calls a state divergent


class MujocoSimulator(RobotSimulator):
    """Replays segments in MuJoCo, one C call for each parameter vector and block of segments, on
    Python threads.

    model: the path of an MJCF file, an MjSpec or an MjModel; parameters: FieldParameters;
    observation, action: the columns of the data's rows as slices of MuJoCo's fields; frame_skip:
    physics steps for which an action is held; threads: 0 for all cores; effects: what the model may
    lack, whose sizes are parameters behind the fields; fixed: effects that it has, with their
    sizes. State components that are not observed start at the model's qpos0 or zero. Results do not
    depend on the number of threads, bit for bit. Warm starts are off, since they make a result
    depend on what ran before it.
    """

    def __init__(
        self,
        model: str | Path | mujoco.MjSpec | mujoco.MjModel,
        parameters: Sequence[FieldParameter],
        *,
        observation: Sequence[str] = ("qpos", "qvel"),
        action: Sequence[str] = ("ctrl",),
        frame_skip: int = 1,
        threads: int = 0,
        effects: Sequence[EffectInstance] = (),
        fixed: ActiveEffects = (),
    ):
        require(frame_skip >= 1, "frame_skip", "at least 1", frame_skip, "MujocoSimulator")
        require(
            threads >= 0,
            "threads",
            "0 (all cores) or a number of threads",
            threads,
            "MujocoSimulator",
        )
        self._source = model
        self.observation = tuple(observation)
        self.action = tuple(action)
        self.model = load_model(model, [p.field for p in parameters])
        self.bindings = [Binding(p, self.model) for p in parameters]
        self._take(effects, fixed)
        self.layout = Layout(self.model, observation)
        self.signals = self.layout.signals
        self.controls = action_columns(self.model, action)
        self.frame_skip = self.steps_per_action = frame_skip
        self.control_step = float(self.model.opt.timestep) * frame_skip
        self.threads = threads or os.cpu_count() or 1
        self._hire()

    def _take(self, effects: Sequence[EffectInstance], fixed: ActiveEffects) -> None:
        self.effects = tuple(effects)
        self.fixed = tuple(fixed)
        tied = [
            instance.label
            for instance in (*effects, *(instance for instance, _ in fixed))
            if instance.general
        ]
        if tied and self.general is None:
            raise Incompatible(
                f"{tied[0]} needs a model whose bodies are compiled with simple='false', "
                "and a compiled MjModel was given."
                " Make the simulator from an MJCF file or an MjSpec, or leave that effect out."
            )
        own = [binding.parameter for binding in self.bindings]
        self.space = ParameterSpace(
            (*own, *(p for instance in effects for p in instance.parameters))
        )
        self.nominal = np.concatenate(
            [[b.nominal() for b in self.bindings], np.zeros(len(self.space) - len(own))]
        )

    def with_effects(
        self, effects: Sequence[EffectInstance] = (), fixed: ActiveEffects = ()
    ) -> "MujocoSimulator":
        """The same simulator with more effects beside those it has: free ones, whose sizes are
        parameters, and fixed ones.
        """
        out = copy.copy(self)
        out._source = self._source
        out.steps = 0
        out.failures = 0
        out._take((*self.effects, *effects), (*self.fixed, *fixed))
        return out

    def observing(self, observation: Sequence[str]) -> "MujocoSimulator":
        """The same simulator of data with other observed columns."""
        out = copy.copy(self)
        out.observation = tuple(observation)
        out.layout = Layout(self.model, observation)
        out.steps = 0
        out.failures = 0
        out.signals = out.layout.signals
        return out

    def spec(self) -> mujoco.MjSpec:
        """The model as an editable specification, without parameters and effects written into it."""
        return specification(self._source)

    def _hire(self) -> None:
        """What lives in one process alone: threads, their own copies of the model, and commands
        already made.
        """
        self._workers: tuple[queue.SimpleQueue[Worker], ...] = (
            queue.SimpleQueue(),
            queue.SimpleQueue(),
        )
        self._pool = ThreadPoolExecutor(self.threads, thread_name_prefix="mujoco")
        self._commands: WeakKeyDictionary[Segments, Array] = WeakKeyDictionary()
        self._bends: WeakKeyDictionary[Segments, Array] = WeakKeyDictionary()

    @cached_property
    def general(self) -> mujoco.MjModel | None:
        """The model for effects that need bodies compiled as not simple; None where that takes a
        source which is not there.
        """
        if not self.model.body_simple[1:].any():
            return self.model
        return (
            None
            if isinstance(self._source, mujoco.MjModel)
            else load_model(self.spec(), MOVES_FRAMES)
        )

    def _worker(self, general: bool) -> Worker:
        """A worker that is free, else a new one; there are never more of them than threads."""
        try:
            return self._workers[general].get_nowait()
        except queue.Empty:
            return Worker(self.general if general else self.model, self.bindings)

    def __getstate__(self) -> dict[str, Any]:
        self.general  # noqa: B018 - compiled while the source is at hand
        return {
            name: value
            for name, value in vars(self).items()
            if name not in ("_workers", "_pool", "_commands", "_bends", "_source")
        }

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._source = self.model
        self._hire()

    def targets(self, segments: Segments) -> Array:
        return self.layout.coordinates(segments.targets, segments.targets)

    def in_contact(self, segments: Segments) -> NDArray[np.bool_]:
        """(N,) whether bodies overlap in each segment's measured start."""
        return touching(
            self.model, self._start_states(segments, np.arange(len(segments)), segments.starts, {})
        )

    def extra_start_sd(self, value: Array, segments: Segments) -> Array:
        """(N, p) under the value (d,): of signals seen late, half of how far a change of speed from
        one step to the next takes them in that time; over more than a step, how far a change
        that goes on does.
        """
        late = lateness(
            [*self.fixed, *magnitudes_of(self.effects, value[len(self.bindings) :])],
            len(self.signals),
        )
        if not late.any():
            return super().extra_start_sd(value, segments)
        if segments not in self._bends:
            self._bends[segments] = curvatures_of(segments, self.layout, self.control_step)
        return np.asarray(
            0.5 * late * np.maximum(1.0, late / self.control_step) * self._bends[segments]
        )

    @property
    def effect_context(self) -> EffectContext:
        """What effects are offered for."""
        signals = tuple((signal.name, signal.unit) for signal in self.signals)
        source = not isinstance(self._source, mujoco.MjModel) or self.general is not None
        return EffectContext(
            self.model,
            signals,
            self.control_step,
            tuple(b.parameter for b in self.bindings),
            source,
        )

    def _predict(self, values: Array, segments: Segments, offsets: Array | None) -> Array:
        require(
            segments.starts.shape[1] == len(self.layout),
            "segments",
            f"of {len(self.layout)} observed columns",
            segments.starts.shape[1],
            "MujocoSimulator.predict",
        )
        out = np.empty((len(values), len(segments.rows[0]), len(self.signals)))
        held = self._command(segments)
        targets = segments.targets
        slopes = (
            slopes_of(segments, self.layout, self.control_step)
            if self.effects or self.fixed
            else None
        )
        row_of = np.concatenate(
            [[0], np.cumsum(np.bincount(segments.rows[0], minlength=len(segments)))]
        )
        fields = len(self.bindings)

        def job(k: int, part: Ints, active: ActiveEffects) -> None:
            starts = segments.starts[part]
            if offsets is not None:
                starts = self.layout.move(starts, offsets[k, part])
            if slopes is not None:
                starts = true_starts(starts, slopes[part], self.layout, active)
            commands = (
                self._changed_commands(segments, part, active)
                if changes_commands(active) or clamps_itself(active)
                else held
            )
            observed = self._replay(
                declared_values(values[k, :fields], active),
                active,
                segments,
                part,
                starts,
                commands,
            )  # one row a compared row of the part
            rows = (
                np.concatenate([np.arange(row_of[i], row_of[i + 1]) for i in part])
                if segments.every_step
                else part
            )
            out[k, rows] = sensed(self.layout.coordinates(observed, targets[rows]), active)

        there = [[*self.fixed, *magnitudes_of(self.effects, value[fields:])] for value in values]
        parts = self._parts(segments, len(values))
        tasks = [
            (k, own, now)
            for k in range(len(values))
            for part in parts
            for own, now in by_time_profile(there[k], segments, part)
        ]
        with quiet():
            for _ in self._pool.map(lambda task: job(*task), tasks):
                pass
        return out

    def _parts(self, segments: Segments, draws: int) -> list[Ints]:
        """Blocks of segments for one C call each: small enough for memory, enough of them to keep
        the threads busy.
        """
        everything = np.arange(len(segments))
        if len(segments.levels) > 1:  # chains stay together
            return [everything]
        per_segment = (
            int(segments.lengths.max())
            * self.frame_skip
            * 8
            * (1 + self.model.nq + self.model.nv + self.model.na)
        )
        blocks = max(
            1,
            -(-len(segments) * per_segment // BUFFER),
            -(-2 * self.threads // draws) if draws < 2 * self.threads else 1,
        )
        return np.array_split(everything, min(blocks, len(segments)))

    def _command(self, segments: Segments) -> Array:
        """(N, L, nu) commands, made once for each set of segments."""
        if segments not in self._commands:
            self._commands[segments] = self._controls(segments.actions)
        return self._commands[segments]

    def _changed_commands(self, segments: Segments, part: Ints, active: ActiveEffects) -> Array:
        """(N, L frame_skip, nu) commands as the effects leave them, for a part of the segments."""
        return commands_of(
            segments,
            part,
            self._controls(segments.trajectories.actions),
            self.model,
            self.frame_skip,
            active,
        )

    def _controls(self, actions: Array) -> Array:
        """Commands (..., nu) from actions (..., q)."""
        require(
            actions.shape[-1] == len(self.controls),
            "segments",
            f"of {len(self.controls)} action columns",
            actions.shape[-1],
            "MujocoSimulator",
        )
        commands = np.zeros((*actions.shape[:-1], self.model.nu))
        commands[..., self.controls] = actions
        return commands

    def _replay(
        self,
        value: Array,
        active: ActiveEffects,
        segments: Segments,
        part: Ints,
        starts: Array,
        commands: Array,
    ) -> Array:
        """Observations at the compared rows of a part of the segments, in their order; commands (N,
        L or L frame_skip, nu).
        """
        general = any(instance.general for instance, _ in active)
        worker = self._worker(general)
        per_action = commands.shape[1] // segments.steps.shape[1]
        try:
            worker.set(value, active)
            ends: dict[int, Array] = {}
            found: dict[int, Array] = {}
            for level in segments.levels if len(segments.levels) > 1 else [part]:
                for length in np.unique(segments.lengths[level]):
                    block = level[segments.lengths[level] == length]
                    states = self._start_states(
                        segments, block, starts[np.searchsorted(part, block)], ends
                    )
                    held = np.repeat(
                        commands[block, : length * per_action],
                        self.frame_skip // per_action,
                        axis=1,
                    )
                    observed, last = self._roll(worker, active, states, held, segments.every_step)
                    found.update(zip(block.tolist(), observed, strict=True))
                    if len(segments.levels) > 1:
                        ends.update(zip(block.tolist(), last, strict=True))
        finally:
            self._workers[general].put(worker)
        return np.concatenate([found[i] for i in part.tolist()])

    def _start_states(
        self, segments: Segments, block: Ints, starts: Array, ends: dict[int, Array]
    ) -> Array:
        states = np.zeros(
            (len(block), mujoco.mj_stateSize(self.model, mujoco.mjtState.mjSTATE_FULLPHYSICS))
        )
        states[:, 1 : 1 + self.model.nq] = self.model.qpos0
        every = np.ones(len(self.layout), dtype=bool)
        before = segments.previous[block]
        if ends and before[0] >= 0:
            states[:] = np.stack([ends[i] for i in before.tolist()])
            states[:, 0] = 0.0
            every = segments.set_columns
        self.layout.write_start(states, starts, every, self.model)
        return states

    def _roll(
        self, worker: Worker, active: ActiveEffects, states: Array, commands: Array, every: bool
    ) -> tuple[Array, Array]:
        """Observations (n, L or 1, P) after every action or the last, and the last states (n, s);
        NaN where MuJoCo stopped early.

        commands: (n, L frame_skip, nu), one a physics step.
        """
        trace, _ = worker.roll(states, commands, active)
        actions = commands.shape[1] // self.frame_skip
        first = 0 if every else actions - 1
        after = trace[:, self.frame_skip - 1 :: self.frame_skip][:, first:]
        sensors = (
            self._sensors(worker, active, after, commands[:, :: self.frame_skip][:, first:])
            if self.layout.needs_sensors
            else None
        )
        observed = self.layout.observe(after, sensors, self.model)
        late = (
            self.layout.by_column(lateness(active, len(self.signals))) / worker.model.opt.timestep
        )
        if late.any():
            whole = np.concatenate([states[:, None], trace], axis=1)
            held = np.concatenate([commands[:, :1], commands], axis=1)
            sensors = (
                self._sensors(worker, active, whole, held) if self.layout.needs_sensors else None
            )
            whole = self.layout.observe(whole, sensors, self.model)[:, :, late > 0]
            observed[:, :, late > 0] = seen_late(whole, late[late > 0])[
                :, self.frame_skip - 1 :: self.frame_skip
            ][:, first:]
        # MuJoCo halts a rollout at its first warning and repeats the state: its clock stands still.
        stopped = (
            after[:, :, 0]
            < (np.arange(first + 1, actions + 1) * self.frame_skip - 0.5)
            * worker.model.opt.timestep
        )
        bad = stopped | ~(np.abs(after) < HUGE).all(axis=2)
        observed[bad] = np.nan
        last = after[:, -1].copy()
        last[bad[:, -1]] = np.nan
        return observed, last

    def _sensors(
        self, worker: Worker, active: ActiveEffects, after: Array, commands: Array
    ) -> Array:
        """Sensor data (n, J, m) of the states after an action, still under it: a step reports those
        of the state before it.
        """
        states = after.reshape(-1, after.shape[2])
        return worker.roll(states, commands.reshape(len(states), 1, self.model.nu), active)[
            1
        ].reshape(*after.shape[:2], -1)


def action_columns(model: mujoco.MjModel, items: Sequence[str]) -> NDArray[np.int64]:
    """(q,) the place in ctrl of each action column."""
    names = {"ctrl": {name: (i, 1) for name, i in element_names(model, "actuator").items()}}
    places = (
        [i for item in items for i in item_columns(item, {"ctrl": model.nu}, names)[1]]
        if model.nu
        else []
    )
    if len(set(places)) < len(places):
        raise BadArgument(f"The action items {list(items)} name an actuator twice.")
    return np.array(places, dtype=np.int64)
