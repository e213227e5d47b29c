"""Hopper transitions like the published ones, in any number.

A hopping policy with exploration noise, on a hopper whose masses may vary.
"""

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from importlib.resources import files
from itertools import cycle, islice
from typing import Any

import mujoco
import numpy as np
from numpy.random import Generator
from numpy.typing import ArrayLike, NDArray

from dropo.core.records.trajectories import Ints, Trajectories
from dropo.core.services.errors import SimulationFailed
from dropo.core.services.validation import Array, float_array, require
from dropo.mjmodel.bodies import body_masses
from dropo.mjmodel.names import element_id
from dropo.problems.hopper.model import BODIES, FRAME_SKIP, TRUTH, hopper_model
from dropo.simulators.mujoco.closed_loop import Rollouts, closed_loop

Masses = Callable[[Generator, int], ArrayLike]
"""Draws the four masses [kg] of a number of blocks, (blocks, 4): masses(rng, blocks)."""

START_NOISE = 5e-3  # [m, rad, m/s, rad/s] Gymnasium's hopper starts within it
UPRIGHT = np.array([0, 1.25, *[0] * 10])  # qpos, qvel


@dataclass(frozen=True, eq=False)
class HopperPolicy:
    """A linear policy of the hopper, of normalized observations, with noise on its actions.

    Attributes
    ----------
    weights : (3, 11) array
        Actions per normalized observation.
    mean, deviation : (11,) arrays
        Mean and standard deviation by which observations are normalized.
    action_noise : float
        Standard deviation of the noise on each action while data are collected.

    Notes
    -----
    action = clip(weights ((observation - mean) / deviation) + noise, -1, 1).
    """

    weights: Array
    mean: Array
    deviation: Array
    action_noise: float

    def __call__(self, observations: Array, noise: Array) -> Array:
        """Actions for observations and standard normal numbers.

        Parameters
        ----------
        observations : (m, 11) array
            Observations as `observe` gives them.
        noise : (m, 3) array
            Standard normal numbers, scaled by `action_noise`.

        Returns
        -------
        (m, 3) array
            Actions within -1 and 1.
        """
        scaled = (observations - self.mean) / self.deviation
        commands: Array = (self.weights * scaled[:, None]).sum(axis=-1) + self.action_noise * noise
        return commands.clip(-1, 1)


@cache
def hopper_policy() -> HopperPolicy:
    """Read the stored hopping policy, found by augmented random search (`hopper_policy.json`).

    Returns
    -------
    HopperPolicy
        The policy, with the noise under which it was found.

    Raises
    ------
    BadArgument
        If the file's numbers have other shapes, or are not finite.
    """
    text = (files("dropo.problems.hopper") / "hopper_policy.json").read_text()
    stored: dict[str, Any] = json.loads(text)
    shapes = {"weights": (3, 11), "mean": (11,), "deviation": (11,)}
    arrays = {
        name: float_array(name, stored[name], shape, "hopper_policy.json")
        for name, shape in shapes.items()
    }
    return HopperPolicy(**arrays, action_noise=float(stored["action_noise"]))


def observe(states: Array) -> Array:
    """Give Gymnasium's observations, without clipping.

    They are all components of the states but the first, the distance travelled.

    Parameters
    ----------
    states : (..., 12) array
        States, `qpos` then `qvel`.

    Returns
    -------
    (..., 11) array
        Observations, a view of the states.
    """
    return states[..., 1:]


def healthy(states: Array) -> NDArray[np.bool_]:
    """Tell which states have not fallen.

    Gymnasium's rule: the torso is higher than 0.7 m and tilted by less than 0.2 rad.

    Parameters
    ----------
    states : (m, 12) array
        States, `qpos` then `qvel`.

    Returns
    -------
    (m,) bool array
    """
    return (states[:, 1] > 0.7) & (np.abs(states[:, 2]) < 0.2)


def start_states(rng: Generator, n: int) -> Array:
    """Draw start states: upright at rest, within Gymnasium's noise, nothing travelled yet.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of the noise.
    n : int
        Number of states.

    Returns
    -------
    (n, 12) array
        States, `qpos` then `qvel`.
    """
    states = UPRIGHT + rng.uniform(-START_NOISE, START_NOISE, (n, 12))
    states[:, 0] = 0
    return states


def simulate(
    transitions_per_trajectory: int = 500,
    trajectories: int = 2,
    *,
    rng: Generator | int,
    masses: Masses | ArrayLike | None = None,
    block: int | None = None,
    noise_variance: float = 0.0,
    policy: HopperPolicy | None = None,
    threads: int = 1,
) -> tuple[Trajectories, Array]:
    """Simulate transitions of the hopper under a policy.

    A trajectory ends where the hopper falls; others are started until there are
    `trajectories * transitions_per_trajectory` transitions. As in the thesis, masses change
    `body_mass` alone; inertias and derived constants stay.

    Parameters
    ----------
    transitions_per_trajectory : int
        Maximum number of transitions of one trajectory.
    trajectories : int
        Number of trajectories if none falls.
    rng : numpy.random.Generator or int
        Source of all random numbers.
    masses : None, array or callable
        Masses [kg] of torso, thigh, leg and foot. None: the true ones. (4,): these. (B, 4): one row
        a block in the order of the trajectories, from the first row again behind the last.
        A callable `masses(rng, blocks)` draws them, (blocks, 4).
    block : int or None
        Control steps for which masses stay the same; None for whole trajectories. A block is a
        group of the data.
    noise_variance : float
        Variance of the Gaussian noise on `next_observations`, and on them only (as in the thesis'
        noisy set), in each signal's unit squared.
    policy : HopperPolicy or None
        What commands the hopper; None for the stored policy.
    threads : int
        Threads of the simulation; the numbers do not depend on them.

    Returns
    -------
    data : Trajectories
        The transitions.
    masses : (G, 4) array
        Masses [kg] behind each group of them.

    Raises
    ------
    BadArgument
        If a count or `block` is below 1, `noise_variance` is negative, or `masses` are not positive
        or not four numbers a block.
    SimulationFailed
        If no trajectory lasts one control step.
    """
    caller = "hopper_data.simulate"
    require(
        min(transitions_per_trajectory, trajectories) >= 1,
        "transitions, trajectories",
        "at least 1",
        0,
        caller,
    )
    require(block is None or block >= 1, "block", "None or at least 1", block, caller)
    require(noise_variance >= 0, "noise_variance", "at least 0", noise_variance, caller)
    motion_rng, noise_rng = np.random.default_rng(rng).spawn(2)
    hold = block or transitions_per_trajectory
    hopper = _Hopper(hopper_model(), policy or hopper_policy(), _sampler(masses), hold, threads)
    total = transitions_per_trajectory * trajectories
    data, drawn = _collect(hopper, transitions_per_trajectory, total, motion_rng)
    clean = data.next_observations
    noise = noise_rng.standard_normal(clean.shape)
    return replace(data, next_observations=clean + np.sqrt(noise_variance) * noise), drawn


@dataclass(frozen=True, eq=False)
class _Hopper:
    """The model, its policy, a sampler of masses, and the control steps for which masses hold."""

    model: mujoco.MjModel
    policy: HopperPolicy
    masses: Masses
    hold: int
    threads: int

    def run(self, n: int, steps: int, rng: Generator) -> tuple[Rollouts, Array]:
        """Rollouts n trajectories of up to `steps` control steps; with the masses of their blocks.

        The masses have the shape (n, B, 4), with B blocks a trajectory.
        """
        blocks = -(-steps // self.hold)
        masses = self._draw_masses(rng, n, blocks)
        own = body_masses(self.model)
        body_mass = np.broadcast_to(own, (n, blocks, len(own))).copy()
        body_mass[:, :, [element_id(self.model, "body", body) for body in BODIES]] = masses
        starts = start_states(rng, n)
        noise = rng.standard_normal((n, steps, self.model.nu))

        def act(states: Array, ids: Ints, step: int) -> Array:
            return self.policy(observe(states), noise[ids, step])

        runs = closed_loop(
            self.model,
            act,
            starts,
            steps,
            frame_skip=FRAME_SKIP,
            alive=healthy,
            fields={"body_mass": body_mass},
            hold=self.hold,
            threads=self.threads,
        )
        return runs, masses

    def _draw_masses(self, rng: Generator, n: int, blocks: int) -> Array:
        """Positive masses (n, blocks, 4) [kg]."""
        caller = "hopper_data.simulate"
        shape = (n * blocks, len(BODIES))
        masses = float_array("masses", self.masses(rng, n * blocks), shape, caller)
        require(bool((masses > 0).all()), "masses", "positive", masses.min(), caller)
        return masses.reshape(n, blocks, len(BODIES))


def _sampler(masses: Masses | ArrayLike | None) -> Masses:
    """The callable that draws masses, from any form in which `simulate` takes them."""
    if callable(masses):
        return masses
    rows = list(TRUTH.values()) if masses is None else masses
    endless = cycle(np.atleast_2d(np.asarray(rows, dtype=float)))
    return lambda rng, blocks: np.array(list(islice(endless, blocks)))


@dataclass(frozen=True, eq=False)
class _Trajectory:
    """States (L + 1, 12), actions (L, 3), each step's block (L,) from 0, and masses (blocks, 4)."""

    states: Array
    actions: Array
    block: Ints
    masses: Array


def _collect(hopper: _Hopper, steps: int, total: int, rng: Generator) -> tuple[Trajectories, Array]:
    """Collects `total` transitions in trajectories of up to `steps`, with their groups' masses."""
    parts: list[_Trajectory] = []
    missing = total
    while missing > 0:
        runs, masses = hopper.run(-(-missing // steps), steps, rng)
        if not runs.lengths.any():
            raise SimulationFailed(
                "The hopper diverges in its first step: are the masses possible ones?"
            )
        for i in np.flatnonzero(runs.lengths).tolist():
            parts.append(_trajectory(runs, masses[i], i, hopper.hold))
        missing = total - sum(len(part.actions) for part in parts)
    # Blocks are counted through all trajectories.
    groups = []
    first = 0
    for part in parts:
        groups.append(first + part.block)
        first += len(part.masses)
    group = np.concatenate(groups)
    data = Trajectories(
        np.concatenate([observe(part.states[:-1]) for part in parts]),
        np.concatenate([part.actions for part in parts]),
        np.concatenate([observe(part.states[1:]) for part in parts]),
        np.concatenate([_last_of(len(part.actions)) for part in parts]),
        group=group,
    ).head(total)
    masses = np.concatenate([part.masses for part in parts])
    return data, masses[: group[total - 1] + 1]


def _trajectory(runs: Rollouts, masses: Array, i: int, hold: int) -> _Trajectory:
    """The i-th run, as far as it lasted, with the masses of the blocks it saw."""
    length = runs.lengths[i]
    block = np.arange(length) // hold
    return _Trajectory(
        runs.states[i, : length + 1], runs.actions[i, :length], block, masses[: block[-1] + 1]
    )


def _last_of(length: int) -> NDArray[np.bool_]:
    """(length,) bool, True in the last place alone."""
    return np.arange(length) == length - 1
