"""MuJoCo in C batches on threads: any MJCF, any number of the model as a parameter."""

import copy
import os
import queue
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any
from weakref import WeakKeyDictionary

import mujoco
import numpy as np
from numpy.typing import NDArray

from dropo.core.contracts.effect import (
    ActiveEffects,
    EffectContext,
    EffectInstance,
    RecordedPast,
    magnitudes_of,
)
from dropo.core.records.parameters import ParameterSpace
from dropo.core.records.trajectories import Ints, Segments
from dropo.core.services.errors import BadArgument, Incompatible
from dropo.core.services.validation import Array, require
from dropo.mjmodel.dynamics.contacts import touching
from dropo.mjmodel.dynamics.dry_friction import FrictionKind, set_friction_kind
from dropo.mjmodel.fields import MOVES_FRAMES, Binding, FieldParameter, item_columns
from dropo.mjmodel.files.loading import load_model, specification
from dropo.mjmodel.held_joints import can_hold, free_joints, hold_joints
from dropo.mjmodel.names import element_names
from dropo.mjmodel.observation import Layout
from dropo.mjmodel.robot_simulator import RobotSimulator
from dropo.mjmodel.timers import without_timers
from dropo.mjmodel.visuals import without_visuals
from dropo.mjmodel.warnings import suppress_mujoco_warnings
from dropo.simulators.mujoco.layers import (
    changes_commands,
    commands_per_physics_step,
    declared_values,
    delay_columns,
    measured_signals,
    split_by_time_profile,
    start_curvatures,
    start_speeds,
    total_delays,
    true_starts,
)
from dropo.simulators.mujoco.worker import Worker, acts_after_clamp, reacting_effects

MAX_BYTES = 1 << 25
"""The bytes of states that one call into C may return; no result depends on it."""
MAX_STATE = 1e10
"""mjMAXVAL: beyond it MuJoCo itself calls a state divergent."""


class MujocoSimulator(RobotSimulator):
    """Replays segments in MuJoCo.

    State components that are not observed start at the model's qpos0 or zero. Results do not depend
    on the number of threads, bit for bit. Warm starts are off, since they make a result depend on
    what ran before it.

    Parameters
    ----------
    model : str, Path, MjSpec or MjModel
        The path of an MJCF file, a specification or a compiled model.
    parameters : sequence of FieldParameter
        The declared parameters.
    observation : sequence of str
        The columns of observation rows, as slices or elements of qpos, qvel, act and sensordata.
    action : sequence of str
        The columns of action rows, as slices or elements of ctrl.
    frame_skip : int
        Physics steps for which an action is held.
    threads : int
        The number of threads; 0 for all cores.
    effects : sequence of EffectInstance
        What the model may lack: the magnitudes are parameters, behind the declared ones.
    fixed : sequence of (EffectInstance, (q,) array)
        Effects that the simulation has, with their magnitudes.

    Attributes
    ----------
    observation, action : tuple of str
        As given.
    threads : int
        The number of threads in use.

    Raises
    ------
    BadArgument
        If `frame_skip` or `threads` is out of its range, an item of `observation` or `action` is
        outside of its field, an actuator is named twice, or a parameter needs an index or element.
    UnknownName
        If there is no such field or element; with the nearest valid name.
    BadFile
        If there is no such file, or the model does not compile.
    Incompatible
        If an effect needs bodies to be compiled anew, and a compiled model is given.

    Notes
    -----
    One C call is made for each parameter vector and block of segments, on Python threads: MuJoCo
    releases the interpreter's lock.
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
        rule = "0 (all cores) or a number of threads"
        require(threads >= 0, "threads", rule, threads, "MujocoSimulator")
        self._source = model
        self.observation = tuple(observation)
        self.action = tuple(action)
        self.model = load_model(model, [p.field for p in parameters])
        self.simulated = without_visuals(self.model)
        self.bindings = [Binding(p, self.model) for p in parameters]
        self._changes: tuple[Callable[[mujoco.MjModel], None], ...] = ()
        self._set_effects(effects, fixed)
        self.layout = Layout(self.model, observation)
        self.signals = self.layout.signals
        self.controls = action_columns(self.model, action)
        self.frame_skip = self.steps_per_action = frame_skip
        self.control_step = float(self.model.opt.timestep) * frame_skip
        self.threads = threads or os.cpu_count() or 1
        self._start_threads()

    def _set_effects(self, effects: Sequence[EffectInstance], fixed: ActiveEffects) -> None:
        """Takes the effects, and makes the space of all parameters and their nominal values."""
        self.effects = tuple(effects)
        self.fixed = tuple(fixed)
        every = [*effects, *(instance for instance, _ in fixed)]
        need_general = [instance.label for instance in every if instance.general]
        if need_general and self.general is None:
            raise Incompatible(
                f"{need_general[0]} needs a model whose bodies are compiled with simple='false', "
                "and a compiled MjModel was given."
                " Make the simulator from an MJCF file or an MjSpec, or leave that effect out."
            )
        declared = [binding.parameter for binding in self.bindings]
        magnitudes = [parameter for instance in effects for parameter in instance.parameters]
        self.space = ParameterSpace((*declared, *magnitudes))
        nominal = [binding.nominal() for binding in self.bindings]
        self.nominal = np.concatenate([nominal, np.zeros(len(magnitudes))])

    def with_effects(
        self, effects: Sequence[EffectInstance] = (), fixed: ActiveEffects = ()
    ) -> "MujocoSimulator":
        added = (*effects, *(instance for instance, _ in fixed))
        if any(instance.general for instance in added):
            self.general  # noqa: B018 - compiled here, once for all that are made of this one
        out = copy.copy(self)
        out.steps = 0
        out.failures = 0
        out._set_effects((*self.effects, *effects), (*self.fixed, *fixed))
        return out

    def with_fitted(self, effects: Sequence[EffectInstance]) -> "MujocoSimulator":
        out = self.with_effects(effects)
        kept = dict(enumerate(self.fixed))
        for effect in effects:
            own = [i for i, (instance, _) in kept.items() if instance.label == effect.label]
            del kept[max(own)]
        out._set_effects(out.effects, tuple(kept.values()))
        return out

    def with_finer_steps(self, times: int) -> "MujocoSimulator":
        finer = self._with_model(partial(_shorten_step, times))
        finer.frame_skip = finer.steps_per_action = times * self.frame_skip
        return finer

    def with_integrator(self, name: str) -> "MujocoSimulator":
        return self._with_model(partial(_integrate_by, name))

    def without_parameters(self) -> "MujocoSimulator":
        out = copy.copy(self)
        out.steps = 0
        out.failures = 0
        out.bindings = []
        out._start_threads()
        out._set_effects(self.effects, self.fixed)
        return out

    def with_friction(self, kind: FrictionKind) -> "MujocoSimulator":
        return self._with_model(partial(set_friction_kind, kind=kind))

    def with_held_joints(self, values: Mapping[int, float]) -> "MujocoSimulator | None":
        """Make the same simulator with hinges and slides that stay where they are.

        Parameters
        ----------
        values : mapping of int to float
            By the joints' numbers in the model, where each stays [rad, m]; states that do not
            observe it begin there.

        Returns
        -------
        MujocoSimulator or None
            None where one of them moves a body behind another joint of that body.
        """
        if not all(can_hold(self.model, joint, value) for joint, value in values.items()):
            return None
        return self._with_model(partial(hold_joints, values))

    def with_joints_of(self, other: "MujocoSimulator") -> "MujocoSimulator":
        """Make the same simulator with joints that are as free as another's.

        Parameters
        ----------
        other : MujocoSimulator
            Of the same robot.

        Returns
        -------
        MujocoSimulator
            A new one, whose counts of steps and failures begin at 0.
        """
        return self._with_model(partial(free_joints, other.model))

    def _with_model(self, change: Callable[[mujoco.MjModel], None]) -> "MujocoSimulator":
        """The same simulator with other numbers in its model, which `change` writes."""
        out = copy.copy(self)
        out.model = copy.copy(self.model)
        change(out.model)
        out.simulated = out.model
        if self.simulated is not self.model:
            out.simulated = copy.copy(self.simulated)
            change(out.simulated)
        out._changes = (*self._changes, change)
        general = out.__dict__.pop("general", None)
        out.__dict__.pop("whole_general", None)
        if general is not None and general is not self.simulated:
            out.general = copy.copy(general)
            change(out.general)
        out.steps = 0
        out.failures = 0
        out._start_threads()
        return out

    def observing(self, observation: Sequence[str]) -> "MujocoSimulator":
        """Make the same simulator for data with other observed columns.

        Parameters
        ----------
        observation : sequence of str
            The columns of observation rows.

        Returns
        -------
        MujocoSimulator
            A new one, whose counts of steps and failures begin at 0.

        Raises
        ------
        BadArgument
            If an item is outside of its field.
        UnknownName
            If there is no such field or element.
        """
        out = copy.copy(self)
        out.observation = tuple(observation)
        out.layout = Layout(self.model, observation)
        out.steps = 0
        out.failures = 0
        out.signals = out.layout.signals
        return out

    def observing_state(self) -> tuple["MujocoSimulator", Array]:
        """Make the same simulator for data that hold qpos, qvel and act whole.

        Returns
        -------
        simulator : MujocoSimulator
            Itself where they do; else one whose missing columns follow those of the data.
        columns : (c,) array
            What is not observed starts at qpos0, or rests.
        """
        missing = self.layout.missing_state(self.model)
        if not missing:
            return self, np.zeros(0)
        items = [f"{column.field}[{column.place}]" for column in missing]
        whole = self.observing([*self.observation, *items])
        rest = [self.model.qpos0[c.place] if c.field == "qpos" else 0.0 for c in missing]
        return whole, np.array(rest)

    @property
    def state_coordinates(self) -> NDArray[np.bool_]:
        """Which start coordinates (s,) are of qpos, qvel or act, and not of sensor data."""
        return self.layout.of_state

    def spec(self) -> mujoco.MjSpec:
        """Make an editable specification of the model, without its parameters and effects.

        Raises
        ------
        BadArgument
            If the model was given compiled.
        """
        return specification(self._source)

    def model_of(self, values: Array, active: ActiveEffects = ()) -> mujoco.MjModel:
        general = any(instance.general for instance, _ in active)
        worker = Worker(self.whole_general if general else self.model, self.bindings)
        numbers = [pair for pair in active if pair[0].model is not None]
        worker.set(declared_values(values[: len(self.bindings)], active), numbers)
        return worker.model

    def _start_threads(self) -> None:
        """Makes what one process alone has: threads, their copies of the model, cached arrays.

        All that are made of this simulator with the same model and parameters share the first two.
        """
        self._workers: tuple[queue.SimpleQueue[Worker], ...] = (
            queue.SimpleQueue(),
            queue.SimpleQueue(),
        )
        self._pool = ThreadPoolExecutor(self.threads, thread_name_prefix="mujoco")
        self._start_caches()

    def _start_caches(self) -> None:
        """Makes the cached arrays, which depend on columns and effects."""
        self._commands: WeakKeyDictionary[Segments, Array] = WeakKeyDictionary()
        self._curvatures: WeakKeyDictionary[Segments, Array] = WeakKeyDictionary()
        self._pasts: WeakKeyDictionary[Segments, RecordedPast] = WeakKeyDictionary()

    @cached_property
    def general(self) -> mujoco.MjModel | None:
        """The model for effects that need bodies compiled with simple="false".

        None where that takes the source of a model that was given compiled. Meshes and textures
        that are only seen are not in it.
        """
        if not self.model.body_simple[1:].any():
            return self.simulated
        if isinstance(self._source, mujoco.MjModel):
            return None
        return without_visuals(self._compile_general())

    @cached_property
    def whole_general(self) -> mujoco.MjModel | None:
        """The same with what is only seen, to be written or shown.

        That of a simulator of another process is without it.
        """
        if not self.model.body_simple[1:].any():
            return self.model
        if isinstance(self._source, mujoco.MjModel):
            return self.general
        return self._compile_general()

    def _compile_general(self) -> mujoco.MjModel:
        """The model of the source, with bodies of simple="false"."""
        model = load_model(self.spec(), MOVES_FRAMES)
        for change in self._changes:
            change(model)
        return model

    def _worker(self, general: bool) -> Worker:
        """A worker that is free, else a new one; there are never more of them than threads."""
        try:
            return self._workers[general].get_nowait()
        except queue.Empty:
            return Worker(self.general if general else self.simulated, self.bindings)

    def __copy__(self) -> "MujocoSimulator":
        out = object.__new__(type(self))
        out.__dict__.update(self.__dict__)
        out._start_caches()
        return out

    def __getstate__(self) -> dict[str, Any]:
        self.general  # noqa: B018 - compiled while the source is at hand
        of_process = ("_workers", "_pool", "_commands", "_curvatures", "_pasts", "_source")
        left_out = (*of_process, "whole_general")
        state = {name: value for name, value in vars(self).items() if name not in left_out}
        # What is only seen stays where the model can be written.
        return {**state, "model": self.simulated}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._source = self.model
        self._start_threads()

    def targets(self, segments: Segments) -> Array:
        """(R, p) the measured signals at every compared row; rotations are 0."""
        return self.layout.coordinates(segments.targets, segments.targets)

    def in_contact(self, segments: Segments) -> NDArray[np.bool_]:
        """(N,) whether bodies overlap in each segment's measured start."""
        everything = np.arange(len(segments))
        states = self._start_states(segments, everything, segments.starts, {})
        return touching(self.model, states)

    def extra_start_sd(self, value: Array, segments: Segments) -> Array:
        """Estimate how far off true starts may be because signals are measured late.

        Parameters
        ----------
        value : (d,) array
            The parameters.
        segments : Segments
            N segments.

        Returns
        -------
        (N, p) array
            Half of how far a change of speed from one step to the next takes a signal in the time
            of its delay; over more than a step, how far a change that goes on does.
        """
        magnitudes = value[len(self.bindings) :]
        active = [*self.fixed, *magnitudes_of(self.effects, magnitudes)]
        delay = total_delays(active, len(self.signals))
        if not delay.any():
            return super().extra_start_sd(value, segments)
        if segments not in self._curvatures:
            curvatures = start_curvatures(segments, self.layout, self.control_step)
            self._curvatures[segments] = curvatures
        steps = np.maximum(1.0, delay / self.control_step)
        return np.asarray(0.5 * delay * steps * self._curvatures[segments])

    @property
    def effect_context(self) -> EffectContext:
        return EffectContext(
            self.model,
            tuple((signal.name, signal.unit) for signal in self.signals),
            self.control_step,
            tuple(binding.parameter for binding in self.bindings),
            not isinstance(self._source, mujoco.MjModel) or self.general is not None,
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
        held = self._held_commands(segments)
        targets = segments.targets
        speeds = None
        if self.effects or self.fixed:
            speeds = start_speeds(segments, self.layout, self.control_step)
        counts = np.bincount(segments.rows[0], minlength=len(segments))
        first_row = np.concatenate([[0], np.cumsum(counts)])
        fields = len(self.bindings)

        def simulate(k: int, part: Ints, active: ActiveEffects) -> None:
            """Writes the predictions of one parameter vector for a part of the segments."""
            starts = segments.starts[part]
            if offsets is not None:
                starts = self.layout.move(starts, offsets[k, part])
            if speeds is not None:
                starts = true_starts(starts, speeds[part], self.layout, active)
            commands = held
            if changes_commands(active) or acts_after_clamp(active):
                commands = self._changed_commands(segments, part, active)
            value = declared_values(values[k, :fields], active)
            observed = self._replay(value, active, segments, part, starts, commands)
            rows = part
            if segments.every_step:
                rows = np.concatenate([np.arange(first_row[i], first_row[i + 1]) for i in part])
            signals = self.layout.coordinates(observed, targets[rows])
            out[k, rows] = measured_signals(signals, active)

        parts = self._parts(segments, len(values))
        tasks = []
        for k, value in enumerate(values):
            active = [*self.fixed, *magnitudes_of(self.effects, value[fields:])]
            for part in parts:
                for own, present in split_by_time_profile(active, segments, part):
                    tasks.append((k, own, present))
        # One thread is the caller's own, whose time then holds that of the simulations.
        run: Any = map if self.threads == 1 else self._pool.map
        with suppress_mujoco_warnings(), without_timers():
            for _ in run(lambda task: simulate(*task), tasks):
                pass
        return out

    def _parts(self, segments: Segments, draws: int) -> list[Ints]:
        """Blocks of segments for one C call each.

        They are small enough for memory, and enough to keep the threads busy.
        """
        everything = np.arange(len(segments))
        if len(segments.levels) > 1:  # chains stay together
            return [everything]
        numbers = 1 + self.model.nq + self.model.nv + self.model.na
        per_segment = int(segments.lengths.max()) * self.frame_skip * 8 * numbers
        for_memory = -(-len(segments) * per_segment // MAX_BYTES)
        for_threads = -(-2 * self.threads // draws) if draws < 2 * self.threads else 1
        blocks = max(1, for_memory, for_threads)
        return np.array_split(everything, min(blocks, len(segments)))

    def _held_commands(self, segments: Segments) -> Array:
        """(N, L, nu) commands without effects, made once for each set of segments."""
        if segments not in self._commands:
            self._commands[segments] = self.commands_of(segments.actions)
        return self._commands[segments]

    def _changed_commands(self, segments: Segments, part: Ints, active: ActiveEffects) -> Array:
        """(N, L frame_skip, nu) commands as the effects change them, for a part of the segments."""
        commands = self.commands_of(segments.trajectories.actions)
        return commands_per_physics_step(
            segments, part, commands, self.model, self.frame_skip, active
        )

    def commands_of(self, actions: Array) -> Array:
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
        """Observations at the compared rows of a part of the segments, in their order.

        The commands are (N, L or L frame_skip, nu).
        """
        general = any(instance.general for instance, _ in active)
        chained = len(segments.levels) > 1
        per_action = commands.shape[1] // segments.steps.shape[1]
        worker = self._worker(general)
        try:
            worker.set(value, active)
            ends: dict[int, Array] = {}  # last states, from which chained segments go on
            found: dict[int, Array] = {}
            for level in segments.levels if chained else [part]:
                for length in np.unique(segments.lengths[level]):
                    block = level[segments.lengths[level] == length]
                    own_starts = starts[np.searchsorted(part, block)]
                    states = self._start_states(segments, block, own_starts, ends)
                    own = commands[block, : length * per_action]
                    held = np.repeat(own, self.frame_skip // per_action, axis=1)
                    past = None
                    if reacting_effects(active):
                        past = self.recorded_past(segments, block)
                        states[:, 0] = past.states[past.start, 0]
                    every = segments.every_step
                    observed, last = self._roll(worker, active, states, held, every, past)
                    if len(block) == len(part):
                        return observed.reshape(-1, observed.shape[2])
                    found.update(zip(block.tolist(), observed, strict=True))
                    if chained:
                        ends.update(zip(block.tolist(), last, strict=True))
        finally:
            self._workers[general].put(worker)
        return np.concatenate([found[i] for i in part.tolist()])

    def recorded_past(self, segments: Segments, block: Ints) -> RecordedPast:
        if segments not in self._pasts:
            data = segments.trajectories
            first, last = np.array(data.spans).T
            states = self.layout.full_states(data.observations, self.model)
            rows = np.arange(len(states)) - np.repeat(first, last - first)
            states[:, 0] = self.control_step * rows
            commands = self.commands_of(data.actions)
            self._pasts[segments] = RecordedPast(states, commands, segments.steps[:, 0], {})
        whole = self._pasts[segments]
        return replace(whole, start=whole.start[block])

    def _start_states(
        self, segments: Segments, block: Ints, starts: Array, ends: dict[int, Array]
    ) -> Array:
        """Full physics states at the starts of a block of segments, chained ones from `ends`."""
        size = mujoco.mj_stateSize(self.model, mujoco.mjtState.mjSTATE_FULLPHYSICS)
        states = np.zeros((len(block), size))
        states[:, 1 : 1 + self.model.nq] = self.model.qpos0
        chosen = np.ones(len(self.layout), dtype=bool)
        before = segments.previous[block]
        if ends and before[0] >= 0:
            states[:] = np.stack([ends[i] for i in before.tolist()])
            states[:, 0] = 0.0
            chosen = segments.set_columns
        self.layout.write_start(states, starts, chosen, self.model)
        return states

    def _roll(
        self,
        worker: Worker,
        active: ActiveEffects,
        states: Array,
        commands: Array,
        every: bool,
        past: RecordedPast | None,
    ) -> tuple[Array, Array]:
        """Observations (n, L or 1, P) after every action or the last one, and last states (n, s).

        The commands are (n, L frame_skip, nu), one a physics step. NaN where MuJoCo stopped early.
        """
        trace, _ = worker.roll(states, commands, active, past)
        skip = self.frame_skip
        actions = commands.shape[1] // skip
        first = 0 if every else actions - 1
        after = trace[:, skip - 1 :: skip][:, first:]
        observed = self._observe(worker, active, after, commands[:, ::skip][:, first:])
        delays = self.layout.by_column(total_delays(active, len(self.signals)))
        delays = delays / worker.model.opt.timestep  # physics steps
        if delays.any():
            late = delays > 0
            whole = np.concatenate([states[:, None], trace], axis=1)
            held = np.concatenate([commands[:, :1], commands], axis=1)
            signals = self._observe(worker, active, whole, held)[:, :, late]
            delayed = delay_columns(signals, delays[late])
            observed[:, :, late] = delayed[:, skip - 1 :: skip][:, first:]
        # MuJoCo halts a rollout at its first warning and repeats the state: its clock stands still
        clock = (np.arange(first + 1, actions + 1) * skip - 0.5) * worker.model.opt.timestep
        stopped = after[:, :, 0] - states[:, :1] < clock
        bad = stopped | ~(np.abs(after) < MAX_STATE).all(axis=2)
        observed[bad] = np.nan
        last = after[:, -1].copy()
        last[bad[:, -1]] = np.nan
        return observed, last

    def _observe(
        self, worker: Worker, active: ActiveEffects, states: Array, commands: Array
    ) -> Array:
        """Observation rows (n, J, P) of states (n, J, s) under commands (n, J, nu).

        Sensor data are computed by one more step each: a step reports those of the state before it.
        """
        sensors = None
        if self.layout.needs_sensors:
            flat = states.reshape(-1, states.shape[2])
            held = commands.reshape(len(flat), 1, self.model.nu)
            _, found = worker.roll(flat, held, active)
            sensors = found.reshape(*states.shape[:2], -1)
        return self.layout.observe(states, sensors, self.model)


def _shorten_step(times: int, model: mujoco.MjModel) -> None:
    """So many physics steps in the place of one."""
    model.opt.timestep /= times


def _integrate_by(name: str, model: mujoco.MjModel) -> None:
    """An integrator by its name in MJCF."""
    model.opt.integrator = getattr(mujoco.mjtIntegrator, f"mjINT_{name.upper()}")


def action_columns(model: mujoco.MjModel, items: Sequence[str]) -> NDArray[np.int64]:
    """Find the place in ctrl of each action column.

    Parameters
    ----------
    model : MjModel
        The compiled model.
    items : sequence of str
        Slices or elements of ctrl.

    Returns
    -------
    (q,) array of int
        Empty for a model without actuators.

    Raises
    ------
    BadArgument
        If an item is outside of ctrl, or an actuator is named twice.
    UnknownName
        If there is no such field or actuator; with the nearest valid name.
    """
    names = {"ctrl": {name: (i, 1) for name, i in element_names(model, "actuator").items()}}
    places: list[int] = []
    if model.nu:
        for item in items:
            places += item_columns(item, {"ctrl": model.nu}, names)[1]
    if len(set(places)) < len(places):
        raise BadArgument(f"The action items {list(items)} name an actuator twice.")
    return np.array(places, dtype=np.int64)
