"""Closed-loop data of a simulator, as a robot would record them."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from dropo.core.contracts.effect import ActiveEffects, EffectInstance
from dropo.core.records.trajectories import Ints, Trajectories
from dropo.core.services.errors import SimulationFailed
from dropo.core.services.validation import Array
from dropo.simulators.mujoco.layers import measured_signals, total_delays
from dropo.simulators.mujoco.simulator import MujocoSimulator

Controller = Callable[[Array, Array], Array]
"""Actions (E, q) from what the sensors give (E, p) and standard normal numbers (E, q)."""


def record(
    simulator: MujocoSimulator,
    effects: ActiveEffects,
    values: Array,
    starts: Array,
    controller: Controller,
    steps: int,
    *,
    actions: int,
    noise: Array | float,
    alive: Callable[[Array], NDArray[np.bool_]],
    rng: np.random.Generator,
    memory: float = 0.0,
) -> Trajectories:
    """Trajectories of up to so many control steps from true start signals (E, p), of a machine with
    effects of those sizes under parameters (d,), with sensor noise (p,) sd.

    The controller acts on the noisy measurements, as on a machine; a trajectory ends where `alive`
    (E, p) -> (E,) says no of the true signals. Late sensors show the start until something else
    arrives.
    memory: the correlation of the controller's random numbers from one step to the next.

    Raises SimulationFailed where no trajectory lasts a control step.
    """
    count, p = starts.shape
    sense, drive = rng.spawn(2)
    states = np.empty((count, steps + 1, p))
    commands = np.zeros((count, steps, actions))
    states[:, 0] = starts
    machine = _Machine(simulator, effects, values)
    sensors = _Sensors(simulator, effects, values)
    errors = noise * sense.standard_normal(states.shape)
    measured = np.full(states.shape, np.nan)
    measured[:, 0] = sensors.at_once(starts) + errors[:, 0]
    living = np.ones(count, dtype=bool)
    lengths = np.zeros(count, dtype=np.int64)
    push = drive.standard_normal((count, actions))
    for t in range(steps):
        commands[:, t] = controller(np.nan_to_num(measured[:, t]), push)
        push = memory * push + np.sqrt(1 - memory**2) * drive.standard_normal((count, actions))
        so_far = _so_far(states[:, : t + 1], commands[:, : t + 1])
        now = np.flatnonzero(living) * (t + 1) + t
        states[:, t + 1], states[living, t + 1] = np.nan, machine.step(so_far, now)
        measured[living, t + 1] = (
            states[living, t + 1] if sensors.prompt else sensors.seen(so_far, now, t)
        ) + errors[living, t + 1]
        whole = np.isfinite(states[:, t + 1]).all(axis=1)
        living = np.logical_and.reduce([living, whole, alive(np.nan_to_num(states[:, t + 1]))])
        lengths[living] += 1
        if not living.any():
            break
    kept = [i for i in range(count) if lengths[i] > 0]
    if not kept:
        raise SimulationFailed(
            f"None of {count} trajectories lasts a control step: the machine falls or its "
            "simulation diverges at once."
        )
    ends = np.concatenate([np.arange(lengths[i]) == lengths[i] - 1 for i in kept])
    before, acted, after = (
        [array[i, first : first + lengths[i]] for i in kept]
        for array, first in ((measured, 0), (commands, 0), (measured, 1))
    )
    return Trajectories(np.concatenate(before), np.concatenate(acted), np.concatenate(after), ends)


class _Machine:
    """What moves: with the effects that act on it, without those of its sensors."""

    def __init__(self, simulator: MujocoSimulator, effects: ActiveEffects, values: Array):
        self.simulator = simulator.with_effects(
            (),
            [(instance, magnitudes) for instance, magnitudes in effects if not _senses(instance)],
        )
        self.values = values

    def step(self, so_far: Trajectories, now: Ints) -> Array:
        """(n, p) true signals a control step behind the rows."""
        return np.asarray(self.simulator.predict(self.values[None], so_far.from_rows(now))[0])


class _Sensors:
    """What is measured of a machine whose true states are known. prompt: its sensors show them as
    they are.
    """

    def __init__(self, simulator: MujocoSimulator, effects: ActiveEffects, values: Array):
        self.prompt = not any(_senses(instance) for instance, _ in effects)
        self.simulator = simulator.with_effects(
            (), [(replace(instance, start=None), magnitudes) for instance, magnitudes in effects]
        )
        self.values = values
        late = total_delays(self.simulator.fixed, len(simulator.signals)).max()
        self.reach = 1 + int(np.ceil(late / simulator.control_step))

    def at_once(self, starts: Array) -> Array:
        """(n, p) what they show of a machine that has stood still."""
        return measured_signals(starts, self.simulator.fixed)

    def seen(self, so_far: Trajectories, now: Ints, t: int) -> Array:
        """(n, p) what they show a control step behind the rows, the t-th of their trajectories."""
        reach = min(self.reach, t + 1)
        return np.asarray(
            self.simulator.predict(self.values[None], so_far.from_rows(now - reach + 1, reach))[0]
        )


def _senses(instance: EffectInstance) -> bool:
    return instance.measurement is not None or instance.sensor_delay is not None


def _so_far(states: Array, commands: Array) -> Trajectories:
    """Trajectories of true states (E, t, p) and commands (E, t, q); what follows the last row is
    not known.
    """
    count, t, p = states.shape
    known = np.nan_to_num(states)
    after = np.concatenate([known[:, 1:], known[:, -1:]], axis=1)
    return Trajectories(
        known.reshape(-1, p),
        commands.reshape(count * t, -1),
        after.reshape(-1, p),
        np.tile(np.arange(t) == t - 1, count),
    )
