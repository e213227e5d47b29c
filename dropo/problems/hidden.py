"""Closed-loop data of a simulator with effects hidden in it: what a robot would record that is not what its model says."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from dropo.core.catalogue import find
from dropo.core.checks import Array, known
from dropo.core.data import Segments, Trajectories
from dropo.core.effect import Atom
from dropo.core.errors import BadArgument
from dropo.core.problem import Problem
from dropo.core.simulator import Simulator
from dropo.problems.hopper import hopper_problem, hopper_simulator
from dropo.problems.hopper_data import healthy, hopper_policy, start_states
from dropo.simulators.mujoco import MujocoSimulator

RECORDED = ("hopper", "hopper-noisy")
"""Built-in problems whose data can be recorded anew, with something hidden in them."""
EPISODES, STEPS = 44, 60
NOISE = {"hopper": 1e-3, "hopper-noisy": 10**-2.5}  # sd of every sensor, in its unit

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


def hide(problem: str, effects: Sequence[str], *, seed: int = 0, threads: int = 0) -> Problem:
    """A built-in problem on data from a machine that has what its model lacks: effects as "EFFECT:TARGET=VALUE".

    The target may be left out where the effect is global, and be followed by ".variant"; values are in the effect's own units,
    several with commas between them.
    """
    known("problem to hide effects in", problem, RECORDED)
    base = hopper_simulator(threads)
    fixed = [_hidden(text, base) for text in effects]
    rng = np.random.default_rng(seed)
    policy, starts = hopper_policy(), start_states(rng, EPISODES)[:, 1:]
    data = record(
        base.with_effects((), fixed), np.asarray(base.nominal), starts, policy, STEPS, actions=base.model.nu, noise=NOISE[problem],
        alive=lambda rows: healthy(np.pad(rows, ((0, 0), (1, 0)))), rng=rng,
    )  # fmt: skip
    found = hopper_problem(problem, data, NOISE[problem] ** 2, threads)
    return replace(found, start_noise=True)


def _hidden(text: str, simulator: MujocoSimulator) -> tuple[Atom, Array]:
    """ "joint_damping:leg_joint=0.6" as an atom with its sizes."""
    name, _, values = text.partition("=")
    atoms = {atom.label: atom for effect in [name.split(":")[0].split(".")[0]] for atom in find("effects", effect)(simulator.robot)}
    atom = atoms[known("place of an effect", name, atoms)]
    try:
        sizes = np.array([float(value) for value in values.split(",")])
    except ValueError:
        sizes = np.zeros(0)
    if len(sizes) != len(atom.quantities):
        wanted = ", ".join(f"{q.name} [{q.unit}]" for q in atom.quantities)
        raise BadArgument(f"--hide {text!r} must give a number for {wanted} behind '='. Got {values!r}.")
    return atom, sizes


def _step(simulator: Simulator, values: Array, states: Array, commands: Array, living: Array) -> Array:
    """(E, p) one control step on, with the commands (E, t, q) so far behind it."""
    count, t, p = states.shape
    out = np.full((count, p), np.nan)
    ends = np.tile(np.arange(t) == t - 1, count)
    known = np.nan_to_num(states)
    ahead = np.concatenate([known[:, 1:], 2 * known[:, -1:] - known[:, -2:][:, :1]], axis=1)  # what a late sensor's slope is taken from
    so_far = Trajectories(known.reshape(-1, p), commands.reshape(count * t, -1), ahead.reshape(-1, p), ends)
    last = np.flatnonzero(ends)[living]
    segments = Segments(so_far, last[:, None], np.full(len(last), -1, dtype=np.int64), np.ones(p, dtype=bool), every_step=False)
    out[living] = simulator.predict(values[None], segments)[0]
    return out
