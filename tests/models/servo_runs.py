"""Runs of servos under sums of sines, from rest at 0, as a log has them."""

from collections.abc import Sequence

import numpy as np

from dropo.core.records.trajectories import Trajectories
from dropo.core.services.validation import Array
from dropo.simulators.mujoco.simulator import MujocoSimulator

STEP = 0.01  # [s]


def goals_of(amplitudes: Sequence[float], runs: int, count: int, rng: np.random.Generator) -> Array:
    """(runs * count, nu) commands: sines of these amplitudes, which swell within a second."""
    time = STEP * np.arange(count)[:, None]
    goals = np.zeros((runs, count, len(amplitudes)))
    for frequency in (0.3, 0.7, 1.1, 1.5):
        phase = rng.uniform(0, 2 * np.pi, (runs, 1, len(amplitudes)))
        goals += amplitudes * np.sin(2 * np.pi * frequency * time + phase)
    return (goals * np.minimum(1.0, time)).reshape(-1, len(amplitudes))


def simulated(machine: MujocoSimulator, goals: Array, runs: int) -> Array:
    """(runs, count + 1, p) what a machine shows, from rest on."""
    count = len(goals) // runs
    rest = np.zeros((len(goals), len(machine.signals)))
    segments = Trajectories(rest, goals, rest, _ends(len(goals), count)).segments(
        count, every_step=True
    )
    after = machine.predict(np.zeros((1, 0)), segments)[0].reshape(runs, count, -1)
    return np.concatenate([np.zeros_like(after[:, :1]), after], axis=1)


def logged(measured: Array, goals: Array) -> Trajectories:
    """The log of what was measured (runs, count + 1, p) under commands (runs * count, nu)."""
    _, rows, p = measured.shape
    before = measured[:, :-1].reshape(-1, p)
    after = measured[:, 1:].reshape(-1, p)
    return Trajectories(before, goals, after, _ends(len(goals), rows - 1))


def _ends(total: int, count: int) -> Array:
    """Whether each row is the last of its run."""
    return np.arange(total) % count == count - 1
