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
"""Commands (E, q) from measurements (E, p) and standard normal numbers (E, q)."""


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
    """Record closed-loop trajectories of a simulated robot.

    The controller acts on the noisy measurements, as on a real robot. Delayed sensors show the
    start until something else arrives.

    Parameters
    ----------
    simulator : MujocoSimulator
        The robot without the effects.
    effects : sequence of (EffectInstance, array)
        Effects that act on it or on its sensors, each with its magnitudes.
    values : (d,) array
        Parameters of the simulator.
    starts : (E, p) array
        True signals at which the E trajectories start.
    controller : callable
        Commands (E, q) from measurements (E, p) and standard normal numbers (E, q).
    steps : int
        Maximum number of control steps of a trajectory.
    actions : int
        Number of commands, q.
    noise : float or (p,) array
        Standard deviation of the sensors' noise, in each signal's unit.
    alive : callable
        True signals (E, p) -> (E,) bool; a trajectory ends with the step before the one after which
        it is False.
    rng : numpy.random.Generator
        Source of the noise and of the controller's random numbers.
    memory : float
        Correlation of the controller's random numbers from one control step to the next.

    Returns
    -------
    Trajectories
        All trajectories that last at least one control step.

    Raises
    ------
    SimulationFailed
        If no trajectory lasts a control step.
    """
    count, p = starts.shape
    noise_rng, controller_rng = rng.spawn(2)
    motion = _TrueMotion(simulator, effects, values)
    sensors = _Sensors(simulator, effects, values)
    # True states, measurements and commands of all trajectories; NaN behind a trajectory's end.
    states = np.empty((count, steps + 1, p))
    states[:, 0] = starts
    errors = noise * noise_rng.standard_normal(states.shape)
    measured = np.full(states.shape, np.nan)
    measured[:, 0] = sensors.at_rest(starts) + errors[:, 0]
    commands = np.zeros((count, steps, actions))
    living = np.ones(count, dtype=bool)
    lengths = np.zeros(count, dtype=np.int64)
    random = controller_rng.standard_normal((count, actions))
    for t in range(steps):
        commands[:, t] = controller(np.nan_to_num(measured[:, t]), random)
        fresh = controller_rng.standard_normal((count, actions))
        random = memory * random + np.sqrt(1 - memory**2) * fresh
        # One control step of the trajectories that still live, from the last rows of the past.
        past = _past(states[:, : t + 1], commands[:, : t + 1])
        rows = np.flatnonzero(living) * (t + 1) + t
        states[:, t + 1] = np.nan
        states[living, t + 1] = motion.step(past, rows)
        shown = states[living, t + 1] if sensors.direct else sensors.measure(past, rows, t)
        measured[living, t + 1] = shown + errors[living, t + 1]
        # Trajectories that diverge or fall end here.
        finite = np.isfinite(states[:, t + 1]).all(axis=1)
        upright = alive(np.nan_to_num(states[:, t + 1]))
        living = living & finite & upright
        lengths[living] += 1
        if not living.any():
            break
    if not lengths.any():
        raise SimulationFailed(
            f"None of {count} trajectories lasts a control step: the machine falls or its "
            "simulation diverges at once."
        )
    return _trajectories(measured, commands, lengths)


def _trajectories(measured: Array, commands: Array, lengths: Ints) -> Trajectories:
    """The trajectories that last at least a control step, each cut at its length."""
    before = []
    acted = []
    after = []
    ends = []
    for i, length in enumerate(lengths):
        if length == 0:
            continue
        before.append(measured[i, :length])
        acted.append(commands[i, :length])
        after.append(measured[i, 1 : 1 + length])
        ends.append(np.arange(length) == length - 1)
    return Trajectories(
        np.concatenate(before), np.concatenate(acted), np.concatenate(after), np.concatenate(ends)
    )


class _TrueMotion:
    """The robot's true motion: with the effects that act on it, without those of its sensors."""

    def __init__(self, simulator: MujocoSimulator, effects: ActiveEffects, values: Array):
        acting = [
            (instance, magnitudes) for instance, magnitudes in effects if not _senses(instance)
        ]
        self.simulator = simulator.with_effects((), acting)
        self.values = values

    def step(self, past: Trajectories, rows: Ints) -> Array:
        """True signals (n, p) a control step behind the rows of the past."""
        return np.asarray(self.simulator.predict(self.values[None], past.from_rows(rows))[0])


class _Sensors:
    """What is measured of a robot whose true states are known.

    `direct` is True if its sensors show the true signals as they are.
    """

    def __init__(self, simulator: MujocoSimulator, effects: ActiveEffects, values: Array):
        self.direct = not any(_senses(instance) for instance, _ in effects)
        steady = [(replace(instance, start=None), magnitudes) for instance, magnitudes in effects]
        self.simulator = simulator.with_effects((), steady)
        self.values = values
        delay = total_delays(self.simulator.fixed, len(simulator.signals)).max()
        self.horizon = 1 + int(np.ceil(delay / simulator.control_step))

    def at_rest(self, starts: Array) -> Array:
        """What sensors show (n, p) of robots that have stood still at `starts` (n, p)."""
        return measured_signals(starts, self.simulator.fixed)

    def measure(self, past: Trajectories, rows: Ints, t: int) -> Array:
        """What sensors show (n, p) a control step behind the rows, the t-th of each trajectory."""
        horizon = min(self.horizon, t + 1)
        segments = past.from_rows(rows - horizon + 1, horizon)
        return np.asarray(self.simulator.predict(self.values[None], segments)[0])


def _senses(instance: EffectInstance) -> bool:
    """Whether the effect is one of a sensor."""
    return instance.measurement is not None or instance.sensor_delay is not None


def _past(states: Array, commands: Array) -> Trajectories:
    """Trajectories of true states (E, t, p) and commands (E, t, q).

    What follows the last row is not known, so that row stands for its own end.
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
