"""Episodes side by side: simulations that begin anew at any time, each with its own parameters."""

import copy
import math
from collections import deque
from collections.abc import Sequence

import mujoco
import numpy as np
from mujoco.batch import Batch
from numpy.typing import NDArray

from dropo.core.contracts.effect import ActiveEffects, EffectInstance, magnitudes_of
from dropo.core.records.trajectories import Ints
from dropo.core.services.errors import Incompatible
from dropo.core.services.validation import Array
from dropo.mjmodel.warnings import suppress_mujoco_warnings
from dropo.simulators.mujoco.closed_loop import advance
from dropo.simulators.mujoco.layers import (
    change_commands,
    changes_commands,
    declared_values,
    measured_signals,
    total_delays,
)
from dropo.simulators.mujoco.simulator import MAX_STATE, MujocoSimulator
from dropo.simulators.mujoco.worker import (
    Reaction,
    Worker,
    acts_after_clamp,
    constant_wrenches,
    react,
    reacting_effects,
)

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
"""The fields from which a simulation is continued."""


class Episodes:
    """Simulations stepped together in C, each of which can begin an episode at any time.

    An episode has its own parameter vector (d,), in the order of the simulator's `space`, and the
    simulator's fixed effects. Effects on commands see them from the beginning of the episode; a
    late sensor shows the start until something else arrives; an effect that sets in at some time of
    the data holds as at their end. The numbers are the same, bit for bit, whatever else the batch
    holds and for any number of threads.

    Parameters
    ----------
    simulator : MujocoSimulator
        The model, its parameters and effects.
    count : int
        The number of simulations.
    threads : int
        The number of threads; 0 for all cores.
    flags : int, optional
        `disableflags` of mjOption, in place of the simulator's.
    whole : bool
        Whether all of MuJoCo's data are kept, for `give`.

    Raises
    ------
    Incompatible
        If an effect belongs to recorded motion alone.
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
        general = any(instance.general for instance in instances)
        # what is given to others has the size of their model
        own = simulator.model if whole else simulator.simulated
        if general:
            own = (simulator.whole_general if whole else simulator.general) or own
        model = copy.copy(own)
        disabled = model.opt.disableflags if flags is None else flags
        model.opt.disableflags = disabled | mujoco.mjtDisableBit.mjDSBL_AUTORESET
        self.simulator = simulator
        self.count = count
        self.frame_skip = simulator.frame_skip
        self.batch = Batch(model, count, threads, persistent=whole)
        self._workers = [Worker(model, simulator.bindings) for _ in range(count)]
        self._layers = [_Layers([], worker, simulator) for worker in self._workers]
        self._live = {name: self.batch.bind(name) for name in STATE}
        self._sensors = self.batch.bind("sensordata") if simulator.layout.needs_sensors else None
        self.batch.set_models([worker.model for worker in self._workers])

    def set(self, ids: Ints, values: Array) -> NDArray[np.bool_]:
        """Set the parameters of the next episodes of some simulations.

        Parameters
        ----------
        ids : (m,) array of int
            The simulations.
        values : (m, d) array
            Their parameters.

        Returns
        -------
        (m,) array of bool
            For which of them MuJoCo accepts the model.
        """
        fields = len(self.simulator.bindings)
        accepted = np.ones(len(ids), dtype=bool)
        with suppress_mujoco_warnings():
            for k, (i, value) in enumerate(zip(ids.tolist(), values, strict=True)):
                free = magnitudes_of(self.simulator.effects, value[fields:])
                active = [*self.simulator.fixed, *free]
                try:
                    self._workers[i].set(declared_values(value[:fields], active), active)
                except (mujoco.FatalError, ValueError):
                    accepted[k] = False
                self._layers[i] = _Layers(active, self._workers[i], self.simulator)
        self.batch.set_models([worker.model for worker in self._workers])
        return accepted

    def reset(self, ids: Ints, states: Array) -> None:
        """Begin episodes in start states; everything else is as in a new simulation.

        Parameters
        ----------
        ids : (m,) array of int
            The simulations.
        states : (m, nq + nv) array
            Positions, then velocities.
        """
        nq = self.batch.models[0].nq
        self.batch.reset(ids, stage=mujoco.mjtStage.mjSTAGE_NONE)
        self._live["qpos"][ids] = states[:, :nq]
        self._live["qvel"][ids] = states[:, nq:]
        self._start(ids)

    def take(self, i: int, data: mujoco.MjData) -> None:
        """Begin an episode of one simulation in a state of MuJoCo's.

        Parameters
        ----------
        i : int
            The simulation.
        data : MjData
            Its state, which is copied.
        """
        for name, live in self._live.items():
            if live[i].size:
                live[i] = getattr(data, name)
        self._start(np.array([i]))

    def give(
        self, i: int, model: mujoco.MjModel | None = None, data: mujoco.MjData | None = None
    ) -> None:
        """Write the model or data of simulation `i`, as after its last step, into the given ones.

        Parameters
        ----------
        i : int
            The simulation.
        model : MjModel, optional
            Is changed in place.
        data : MjData, optional
            Is changed in place.
        """
        if model is not None:
            self.batch.get_model(i, model)
        if data is not None:
            self.batch.get_data(i, data)

    def _start(self, ids: Ints) -> None:
        """Begins the effects of some simulations in their present states."""
        rows = self.rows(ids)
        for i, row in zip(ids.tolist(), rows, strict=True):
            self._live["xfrc_applied"][i] += self._layers[i].reset(row)

    def states(self, ids: Ints) -> Array:
        """Read positions and velocities of some simulations.

        Parameters
        ----------
        ids : (m,) array of int
            The simulations.

        Returns
        -------
        (m, nq + nv) array
            Positions, then velocities, in the model's units.
        """
        return np.hstack([self._live["qpos"][ids], self._live["qvel"][ids]])

    def step(self, ids: Ints, commands: Array, steps: int | None = None) -> NDArray[np.bool_]:
        """Advance some simulations under commands that are held.

        Parameters
        ----------
        ids : (m,) array of int
            The simulations.
        commands : (m, nu) array
            Their commands.
        steps : int, optional
            Physics steps; by default those of an action.

        Returns
        -------
        (m,) array of bool
            Which of them have not diverged.
        """
        count = self.frame_skip if steps is None else steps
        layers = [self._layers[i] for i in ids.tolist()]
        if any(layer.active for layer in layers):
            failed = self._step_with_effects(ids, layers, commands, count)
        else:
            self._live["ctrl"][ids] = commands
            failed = advance(self.batch, ids, count)
        finite = (np.abs(self.states(ids)) < MAX_STATE).all(axis=1)  # also False for NaN
        valid: NDArray[np.bool_] = ~failed & finite
        return valid

    def _step_with_effects(
        self, ids: Ints, layers: "list[_Layers]", commands: Array, count: int
    ) -> NDArray[np.bool_]:
        """Advances through the layers around the physics; (m,) which of them failed.

        It makes one physics step at a time where something changes within the action.
        """
        changed = []
        for layer, command in zip(layers, commands, strict=True):
            changed.append(layer.commands(command, count))
        frames = np.stack(changed)  # (m, count, nu)
        constant = (frames == frames[:, :1]).all()
        at_once = not any(layer.needs_every_step for layer in layers) and constant
        failed = np.zeros(len(ids), dtype=bool)
        for k in range(1 if at_once else count):
            self._live["ctrl"][ids] = frames[:, k]
            for i, layer in zip(ids.tolist(), layers, strict=True):
                if layer.reacting:
                    state = self._full(np.array([i]))
                    reaction = layer.react(state, self._live["ctrl"][[i]])
                    self._live["ctrl"][i] = reaction.commands[0]
                    self._live["qfrc_applied"][i] = reaction.forces[0]
            failed |= advance(self.batch, ids, count if at_once else 1)
            for i, layer in zip(ids.tolist(), layers, strict=True):
                if layer.delay_line is not None:
                    layer.delay_line.push(self.rows(np.array([i]))[0])
        return failed

    def _full(self, ids: Ints) -> Array:
        """(m, 1 + nq + nv + na) states as MuJoCo orders them."""
        time = self._live["time"][ids][:, None]
        state = [self._live[name][ids] for name in ("qpos", "qvel", "act")]
        return np.concatenate([time, *state], axis=1)

    def rows(self, ids: Ints) -> Array:
        """Observe the true states of some simulations.

        Parameters
        ----------
        ids : (m,) array of int
            The simulations.

        Returns
        -------
        (m, P) array
            Observation rows before sensors change them; see `measured`.
        """
        sensors = None
        if self._sensors is not None:
            with suppress_mujoco_warnings():
                self.batch.forward(ids)
            sensors = self._sensors[ids]
        return self.simulator.layout.observe(self._full(ids), sensors, self.simulator.model)

    def measured(self, ids: Ints, rows: Array) -> Array:
        """Turn true observation rows into those that the sensors give: late, biased, scaled.

        Parameters
        ----------
        ids : (m,) array of int
            The simulations.
        rows : (m, P) array
            Observation rows of their true states, see `rows`.

        Returns
        -------
        (m, P) array
        """
        out = rows.copy()
        for k, i in enumerate(ids.tolist()):
            out[k] = self._layers[i].measure(rows[k])
        return out


def _refuse_recorded(instances: Sequence[EffectInstance]) -> None:
    """Refuses effects that are known for recorded motion alone."""
    recorded = [instance.label for instance in instances if instance.applied_force is not None]
    if recorded:
        raise Incompatible(
            f"{recorded[0]} is known for recorded motion alone and cannot act in new "
            "episodes. Leave it out."
        )


class _Layers:
    """The effects around one simulation's physics, from the beginning of its episode.

    reacting: those that depend on the state; needs_every_step: whether some effect must see every
    physics step; delay_line: the observations that late sensors need, None without such.
    """

    def __init__(self, active: ActiveEffects, worker: Worker, simulator: MujocoSimulator):
        self.active = active
        self._worker = worker
        self._simulator = simulator
        self.reacting = reacting_effects(active)
        delays = simulator.layout.by_column(total_delays(active, len(simulator.signals)))
        self._delays = delays / worker.model.opt.timestep  # physics steps
        self._history: _CommandHistory | None = None
        if changes_commands(active) or acts_after_clamp(active):
            self._history = _CommandHistory(active, worker.model)
        self._measures = any(instance.measurement is not None for instance, _ in active)
        self.delay_line: _DelayLine | None = None
        self.needs_every_step = bool(self.reacting) or bool(self._delays.any())
        self._own_friction = worker.model.dof_frictionloss.copy()
        self._step = 0
        self._memory: dict[object, object] = {}

    def reset(self, row: Array) -> Array:
        """Begins an episode in a state with that observation row (P,).

        Returns the constant forces and torques of the effects, (nbody, 6).
        """
        self._step = 0
        self._memory = {}
        self.delay_line = _DelayLine(self._delays, row) if self._delays.any() else None
        if self._history is not None:
            self._history.clear()
        return constant_wrenches(self.active, self._worker.model.nbody)

    def commands(self, command: Array, count: int) -> Array:
        """(count, nu) a command as the effects change it, one a physics step."""
        if self._history is None:
            return np.repeat(command[None], count, axis=0)
        return self._history.next(command, count)

    def react(self, state: Array, commands: Array) -> Reaction:
        """What follows from a state (1, s) and a command (1, nu); friction is set at once."""
        model = self._worker.model
        found = react(model, state, commands, self._step, self.reacting, self._memory)
        self._worker.model.dof_frictionloss[:] = self._own_friction + found.friction[0]
        self._step += 1
        return found

    def measure(self, row: Array) -> Array:
        """(P,) an observation row as the sensors give it."""
        if self.delay_line is not None:
            row = self.delay_line.delayed(row)
        if not self._measures:
            return row
        layout = self._simulator.layout
        true = row[None]
        signals = layout.coordinates(true, true)
        offsets = measured_signals(signals, self.active) - signals
        measured: Array = layout.move(true, offsets)[0]
        return measured


class _CommandHistory:
    """An episode's commands from its beginning, which delays, lags and play need."""

    def __init__(self, active: ActiveEffects, model: mujoco.MjModel):
        self._active = active
        self._model = model
        self._given = np.empty((64, model.nu))  # grows with the episode
        self._count = 0

    def clear(self) -> None:
        """Forgets all commands."""
        self._count = 0

    def next(self, command: Array, count: int) -> Array:
        """(count, nu) the next command (nu,) as the effects change it, one a physics step."""
        if self._count == len(self._given):
            self._given = np.concatenate([self._given, np.empty_like(self._given)])
        self._given[self._count] = command
        self._count += 1
        given = self._given[: self._count]
        return change_commands(given, self._model, count, self._active)[-count:]


class _DelayLine:
    """Observation columns that are late by `delays` (P,) [physics steps].

    Before the start they had the values of the start.
    """

    def __init__(self, delays: Array, start: Array):
        self._columns = np.flatnonzero(delays > 0)
        self._behind = np.ceil(delays[self._columns]).astype(int)
        self._newer_part = self._behind - delays[self._columns]
        size = math.ceil(delays.max()) + 1
        self._past: deque[Array] = deque([start] * size, maxlen=size)

    def push(self, row: Array) -> None:
        """Takes the row (P,) after one more physics step."""
        self._past.append(row)

    def delayed(self, row: Array) -> Array:
        """The present row (P,) with the late columns as they were."""
        out = row.copy()
        past = np.array(self._past)
        older = past[-1 - self._behind, self._columns]
        newer = past[-self._behind, self._columns]
        out[self._columns] = (1 - self._newer_part) * older + self._newer_part * newer
        return out
