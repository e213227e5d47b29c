"""Closed-loop data of a simulator, as a robot would record them."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from dropo.core.checks import Array
from dropo.core.data import Trajectories
from dropo.core.simulator import Simulator

Controller = Callable[[Array, Array], Array]
"""Actions (E, q) from what the sensors give (E, p) and standard normal numbers (E, q)."""


def record(
    simulator: Simulator, values: Array, starts: Array, controller: Controller, steps: int, *, actions: int, noise: Array | float,
    alive: Callable[[Array], NDArray[np.bool_]], rng: np.random.Generator, memory: float = 0.0,
) -> Trajectories:  # fmt: skip
    """Trajectories of up to so many control steps from start observations (E, p), under parameters (d,), with sensor noise (p,) sd.

    The controller acts on the noisy measurements, as on a machine; a trajectory ends where `alive` (E, p) -> (E,) says no.
    memory: the correlation of the controller's random numbers from one step to the next.
    """
    count, p = starts.shape
    sense, drive = rng.spawn(2)
    states, commands = np.empty((count, steps + 1, p)), np.zeros((count, steps, actions))
    states[:, 0] = starts
    errors = noise * sense.standard_normal(states.shape)
    living, lengths = np.ones(count, dtype=bool), np.zeros(count, dtype=np.int64)
    push = drive.standard_normal((count, actions))
    for t in range(steps):
        commands[:, t] = controller(np.nan_to_num(states[:, t] + errors[:, t]), push)
        push = memory * push + np.sqrt(1 - memory**2) * drive.standard_normal((count, actions))
        states[:, t + 1] = _step(simulator, values, states[:, : t + 1], commands[:, : t + 1], living)
        whole = np.isfinite(states[:, t + 1]).all(axis=1)
        living = np.logical_and.reduce([living, whole, alive(np.nan_to_num(states[:, t + 1]))])
        lengths[living] += 1
        if not living.any():
            break
    kept = [i for i in range(count) if lengths[i] > 0]
    measured = states + errors
    ends = np.concatenate([np.arange(lengths[i]) == lengths[i] - 1 for i in kept])
    before, acted, after = (
        [array[i, first : first + lengths[i]] for i in kept] for array, first in ((measured, 0), (commands, 0), (measured, 1))
    )
    return Trajectories(np.concatenate(before), np.concatenate(acted), np.concatenate(after), ends)


def _step(simulator: Simulator, values: Array, states: Array, commands: Array, living: Array) -> Array:
    """(E, p) one control step on, with the commands (E, t, q) so far behind it."""
    count, t, p = states.shape
    out = np.full((count, p), np.nan)
    ends = np.tile(np.arange(t) == t - 1, count)
    known = np.nan_to_num(states)
    ahead = np.concatenate([known[:, 1:], 2 * known[:, -1:] - known[:, -2:][:, :1]], axis=1)  # what a late sensor's slope is taken from
    so_far = Trajectories(known.reshape(-1, p), commands.reshape(count * t, -1), ahead.reshape(-1, p), ends)
    last = np.flatnonzero(ends)[living]
    out[living] = simulator.predict(values[None], so_far.from_rows(last))[0]
    return out
