"""Episodes side by side: a batch of simulations that begin anew at any time, each with its own
parameters and effects.
"""

import copy
import math
from collections import deque
from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np
from mujoco.batch import Batch
from numpy.typing import NDArray

from dropo.core.contracts.effect import ActiveEffects, magnitudes_of
from dropo.core.records.trajectories import Ints
from dropo.core.services.errors import Incompatible
from dropo.core.services.validation import Array
from dropo.simulators.mujoco.closed_loop import advance
from dropo.simulators.mujoco.layers import (
    changed,
    changes_commands,
    declared_values,
    lateness,
    sensed,
)
from dropo.simulators.mujoco.simulator import HUGE, MujocoSimulator
from dropo.simulators.mujoco.warnings import quiet
from dropo.simulators.mujoco.worker import Worker, clamps_itself

STATE = (
    "time",
    "qpos",
    "qvel",
    "act",
    "qacc_warmstart",
    "ctrl",
    "qfrc_applied",
    "xfrc_applied",
    "eq_active",
    "mocap_pos",
    "mocap_quat",
    "userdata",
)
"""What a simulation is continued from."""


class Episodes:
    """`count` simulations of a MujocoSimulator, of any of which an episode can begin at any time;
    stepped together, in C.

    An episode is one under its own parameter vector (d,), in the order of the simulator's `space`,
    with the simulator's fixed effects. Effects on commands see them from the episode's beginning; a
    late sensor shows the start until something else arrives; an effect that sets in at some time of
    the data is there as at their end. flags: of mjOption, in place of the simulator's. whole: keep
    all of MuJoCo's data, for `give`. The numbers are the same, bit for bit, whatever else the batch
    holds and for any number of `threads`, 0 for all cores.
    """

    def __init__(
        self,
        simulator: MujocoSimulator,
        count: int,
        *,
        threads: int = 1,
        flags: int | None = None,
        whole: bool = False,
    ):
        instances = [*simulator.effects, *(instance for instance, _ in simulator.fixed)]
        _refuse_recorded(instances)
        general = simulator.general if any(instance.general for instance in instances) else None
        model = copy.copy(general or simulator.model)
        model.opt.disableflags = (
            model.opt.disableflags if flags is None else flags
        ) | mujoco.mjtDisableBit.mjDSBL_AUTORESET
        self.simulator = simulator
        self.count = count
        self.frame_skip = simulator.frame_skip
        self.batch = Batch(model, count, threads, persistent=whole)
        self._workers = [Worker(model, simulator.bindings) for _ in range(count)]
        self._layers = [_Layers([], self._workers[i], simulator) for i in range(count)]
        self._live = {name: self.batch.bind(name) for name in STATE}
        self._sensors = self.batch.bind("sensordata") if simulator.layout.needs_sensors else None
        self.batch.set_models([worker.model for worker in self._workers])

    def set(self, ids: Ints, values: Array) -> NDArray[np.bool_]:
        """Gives simulations the parameters (m, d) of their next episode; (m,) in which of them
        MuJoCo takes the model.
        """
        fields = len(self.simulator.bindings)
        taken = np.ones(len(ids), dtype=bool)
        with quiet():
            for k, (i, value) in enumerate(zip(ids.tolist(), values, strict=True)):
                active = [
                    *self.simulator.fixed,
                    *magnitudes_of(self.simulator.effects, value[fields:]),
                ]
                try:
                    self._workers[i].set(declared_values(value[:fields], active), active)
                except (mujoco.FatalError, ValueError):
                    taken[k] = False
                self._layers[i] = _Layers(active, self._workers[i], self.simulator)
        self.batch.set_models([worker.model for worker in self._workers])
        return taken

    def reset(self, ids: Ints, states: Array) -> None:
        """Puts simulations into start states (m, nq + nv); everything else is as in a new one."""
        nq = self.batch.models[0].nq
        self.batch.reset(ids, stage=mujoco.mjtStage.mjSTAGE_NONE)
        self._live["qpos"][ids], self._live["qvel"][ids] = states[:, :nq], states[:, nq:]
        self._start(ids)

    def take(self, i: int, data: mujoco.MjData) -> None:
        """Puts simulation i into the state of `data`."""
        for name, live in self._live.items():
            if live[i].size:
                live[i] = getattr(data, name)
        self._start(np.array([i]))

    def give(
        self, i: int, model: mujoco.MjModel | None = None, data: mujoco.MjData | None = None
    ) -> None:
        """Writes simulation i's model or data, as after its last step, into the caller's."""
        if model is not None:
            self.batch.get_model(i, model)
        if data is not None:
            self.batch.get_data(i, data)

    def _start(self, ids: Ints) -> None:
        rows = self.rows(ids)
        for i, row in zip(ids.tolist(), rows, strict=True):
            self._live["xfrc_applied"][i] += self._layers[i].reset(row)

    def states(self, ids: Ints) -> Array:
        """(m, nq + nv) positions and velocities."""
        return np.hstack([self._live["qpos"][ids], self._live["qvel"][ids]])

    def step(self, ids: Ints, commands: Array, steps: int | None = None) -> NDArray[np.bool_]:
        """Holds commands (m, nu) for so many physics steps, by default an action's; (m,) which
        simulations are still sound.
        """
        count = self.frame_skip if steps is None else steps
        layers = [self._layers[i] for i in ids.tolist()]
        if any(layer.active for layer in layers):
            failed = self._changed_step(ids, layers, commands, count)
        else:
            self._live["ctrl"][ids] = commands
            failed = advance(self.batch, ids, count)
        sound: NDArray[np.bool_] = ~failed & (np.abs(self.states(ids)) < HUGE).all(
            axis=1
        )  # also False for NaN
        return sound

    def _changed_step(
        self, ids: Ints, layers: "list[_Layers]", commands: Array, count: int
    ) -> NDArray[np.bool_]:
        """A step through the layers around the physics: one physics step at a time where something
        changes within it.
        """
        frames = np.stack(
            [
                layer.commands(command, count)
                for layer, command in zip(layers, commands, strict=True)
            ]
        )  # (m, count, nu)
        whole = not any(layer.watches for layer in layers) and (frames == frames[:, :1]).all()
        failed = np.zeros(len(ids), dtype=bool)
        for k in range(1 if whole else count):
            self._live["ctrl"][ids] = frames[:, k]
            for i, layer in zip(ids.tolist(), layers, strict=True):
                if layer.acting:
                    self._live["ctrl"][i], self._live["qfrc_applied"][i] = layer.react(
                        self._full(np.array([i])), self._live["ctrl"][[i]]
                    )
            failed |= advance(self.batch, ids, count if whole else 1)
            for i, layer in zip(ids.tolist(), layers, strict=True):
                if layer.late is not None:
                    layer.late.push(self.rows(np.array([i]))[0])
        return failed

    def _full(self, ids: Ints) -> Array:
        """(m, 1 + nq + nv + na) states as MuJoCo orders them."""
        return np.concatenate(
            [
                self._live["time"][ids][:, None],
                *(self._live[name][ids] for name in ("qpos", "qvel", "act")),
            ],
            axis=1,
        )

    def rows(self, ids: Ints) -> Array:
        """(m, P) observation rows of the true states."""
        if self._sensors is not None:
            with quiet():
                self.batch.forward(ids)
        return self.simulator.layout.observe(
            self._full(ids),
            None if self._sensors is None else self._sensors[ids],
            self.simulator.model,
        )

    def measured(self, ids: Ints, rows: Array) -> Array:
        """(m, P) the rows (m, P) as the sensors give them: late, biased, scaled."""
        out = rows.copy()
        for k, i in enumerate(ids.tolist()):
            out[k] = self._layers[i].measure(rows[k])
        return out


def _refuse_recorded(instances: Any) -> None:
    recorded = [instance.label for instance in instances if instance.applied_force is not None]
    if recorded:
        raise Incompatible(
            f"{recorded[0]} is known for recorded motion alone and cannot act in new "
            "episodes. Leave it out."
        )


class _Layers:
    """The effects around one simulation's physics, from the beginning of its episode.

    watches: whether they must see every physics step.
    """

    def __init__(self, active: ActiveEffects, worker: Worker, simulator: MujocoSimulator):
        self.active = active
        self._worker = worker
        self._simulator = simulator
        self.acting = [
            (instance, magnitudes)
            for instance, magnitudes in active
            if instance.command_feedback is not None or instance.force is not None
        ]
        self._delays = (
            simulator.layout.by_column(lateness(active, len(simulator.signals)))
            / worker.model.opt.timestep
        )  # physics steps
        self._line = (
            _Line(active, worker.model)
            if changes_commands(active) or clamps_itself(active)
            else None
        )
        self._senses = any(instance.measurement is not None for instance, _ in active)
        self.late: _Late | None = None
        self.watches = bool(self.acting) or bool(self._delays.any())
        self._step = 0

    def reset(self, row: Array) -> Array:
        """An episode begins in a state with that observation row (P,); the constant forces (nbody,
        6) of the effects.
        """
        self._step = 0
        self.late = _Late(self._delays, row) if self._delays.any() else None
        if self._line is not None:
            self._line.clear()
        force = np.zeros((self._worker.model.nbody, 6))
        for body, wrench in (
            instance.wrench(magnitudes)
            for instance, magnitudes in self.active
            if instance.wrench is not None
        ):
            force[body] += wrench
        return force

    def commands(self, command: Array, count: int) -> Array:
        """(count, nu) a command as it arrives, one a physics step."""
        return (
            np.repeat(command[None], count, axis=0)
            if self._line is None
            else self._line.next(command, count)
        )

    def react(self, state: Array, commands: Array) -> tuple[Array, Array]:
        """A command (nu,) and generalised forces (nv,) that follow from the state (1, s)."""
        changed_commands, forces = self._worker.reaction(state, commands, self._step, self.acting)
        self._step += 1
        return changed_commands[0], forces[0]

    def measure(self, row: Array) -> Array:
        """(P,) as it is seen."""
        if self.late is not None:
            row = self.late.seen(row)
        if not self._senses:
            return row
        layout = self._simulator.layout
        one = row[None]
        signals = layout.coordinates(one, one)
        seen: Array = layout.move(one, sensed(signals, self.active) - signals)[0]
        return seen


class _Line:
    """An episode's commands from its beginning, which delays, lags and play need."""

    def __init__(self, active: ActiveEffects, model: mujoco.MjModel):
        self._change: Callable[[Array, int], Array] = lambda commands, count: changed(
            commands, model, count, active
        )
        self._given = np.empty((64, model.nu))
        self._count = 0

    def clear(self) -> None:
        """Forgets them."""
        self._count = 0

    def next(self, command: Array, count: int) -> Array:
        """(count, nu) what arrives of the next command (nu,)."""
        if self._count == len(self._given):
            self._given = np.concatenate([self._given, np.empty_like(self._given)])
        self._given[self._count] = command
        self._count += 1
        return self._change(self._given[: self._count], count)[-count:]


class _Late:
    """Observation columns that are seen late by `delays` (P,) [physics steps]; before the start
    they stood as in it.
    """

    def __init__(self, delays: Array, start: Array):
        self._columns = np.flatnonzero(delays > 0)
        self._behind = np.ceil(delays[self._columns]).astype(int)
        self._share = self._behind - delays[self._columns]
        length = math.ceil(delays.max()) + 1
        self._past: deque[Array] = deque([start] * length, maxlen=length)

    def push(self, row: Array) -> None:
        """The row (P,) after one more physics step."""
        self._past.append(row)

    def seen(self, row: Array) -> Array:
        """The present row (P,) with the late columns as they were."""
        out = row.copy()
        past = np.array(self._past)
        older = past[-1 - self._behind, self._columns]
        newer = past[-self._behind, self._columns]
        out[self._columns] = (1 - self._share) * older + self._share * newer
        return out
