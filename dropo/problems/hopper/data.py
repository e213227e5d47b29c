"""Hopper transitions like the published ones, in any number: a hopping policy, exploration noise,
masses that may vary.
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
from dropo.problems.hopper.model import BODIES, FRAME_SKIP, TRUTH, hopper_model
from dropo.simulators.mujoco.closed_loop import Rollouts, closed_loop

Masses = Callable[[Generator, int], ArrayLike]
"""Draws the four masses [kg] of so many blocks, (blocks, 4): masses(rng, blocks)."""

START_NOISE = 5e-3  # [m, rad, m/s, rad/s] Gymnasium's hopper starts within it
UPRIGHT = np.array([0, 1.25, *[0] * 10])  # qpos, qvel


@dataclass(frozen=True, eq=False)
class LinearPolicy:
    """action = clip(weights ((observation - mean) / deviation) + noise, -1, 1).

    weights: (3, 11); mean, deviation: (11,); action_noise: the standard deviation of the noise
    while it collects data.
    """

    weights: Array
    mean: Array
    deviation: Array
    action_noise: float

    def __call__(self, observations: Array, noise: Array) -> Array:
        """Actions (m, 3) for observations (m, 11) and standard normal noise (m, 3)."""
        scaled = (observations - self.mean) / self.deviation
        commands: Array = (self.weights * scaled[:, None]).sum(axis=-1) + self.action_noise * noise
        return commands.clip(-1, 1)


@cache
def hopper_policy() -> LinearPolicy:
    """The policy of `hopper_policy.json`, which `python -m
    dropo.studies.tiboni_2021.find_hopper_policy` found.
    """
    kept: dict[str, Any] = json.loads(
        (files("dropo.problems.hopper") / "hopper_policy.json").read_text()
    )
    shapes = {"weights": (3, 11), "mean": (11,), "deviation": (11,)}
    arrays = {
        name: float_array(name, kept[name], shape, "hopper_policy.json")
        for name, shape in shapes.items()
    }
    return LinearPolicy(**arrays, action_noise=float(kept["action_noise"]))


def observe(states: Array) -> Array:
    """Gymnasium's observation (..., 11), without its clipping, of states (..., 12): all but the
    distance travelled.
    """
    return states[..., 1:]


def healthy(states: Array) -> NDArray[np.bool_]:
    """(m,) which of the states (m, 12) have not fallen: Gymnasium's rule of height [m] and torso
    angle [rad].
    """
    return (states[:, 1] > 0.7) & (np.abs(states[:, 2]) < 0.2)


def start_states(rng: Generator, n: int) -> Array:
    """(n, 12) upright at rest, within Gymnasium's start noise; nothing travelled yet."""
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
    policy: LinearPolicy | None = None,
    threads: int = 1,
) -> tuple[Trajectories, Array]:
    """Transitions of the hopper under the policy, and the masses [kg] behind each group of them,
    (G, 4).

    A trajectory that falls ends there, and others are started until there are trajectories *
    transitions_per_trajectory transitions. masses: None for the true ones; four; (B, 4), one row a
    block in the order of the trajectories, and from the first again behind the last; or what draws
    them. block: the control steps of a block, None for whole trajectories; it is a group of the
    data. As in the thesis, masses change `body_mass` alone, and inertias and derived constants
    stay. noise_variance: of Gaussian noise on all `next_observations`, and on them only (the
    thesis' noisy set).
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
    motion, noise = np.random.default_rng(rng).spawn(2)
    hold = block or transitions_per_trajectory
    data, drawn = _collect(
        _Hopper(hopper_model(), policy or hopper_policy(), _sampler(masses), hold, threads),
        transitions_per_trajectory,
        transitions_per_trajectory * trajectories,
        motion,
    )
    noisy = data.next_observations + np.sqrt(noise_variance) * noise.standard_normal(
        data.next_observations.shape
    )
    return replace(data, next_observations=noisy), drawn


@dataclass(frozen=True, eq=False)
class _Hopper:
    """What moves: the model, its policy, what draws masses, and for how many control steps they
    hold.
    """

    model: mujoco.MjModel
    policy: LinearPolicy
    masses: Masses
    hold: int
    threads: int

    def run(self, n: int, steps: int, rng: Generator) -> tuple[Rollouts, Array]:
        """n trajectories of up to so many control steps, and the masses of their blocks (n, B, 4)."""
        blocks = -(-steps // self.hold)
        masses = float_array(
            "masses",
            self.masses(rng, n * blocks),
            (n * blocks, len(BODIES)),
            "hopper_data.simulate",
        )
        require(
            bool((masses > 0).all()), "masses", "positive", masses.min(), "hopper_data.simulate"
        )
        masses = masses.reshape(n, blocks, len(BODIES))
        body_mass = np.broadcast_to(self.model.body_mass, (n, blocks, self.model.nbody)).copy()
        body_mass[:, :, [self.model.body(body).id for body in BODIES]] = masses
        starts = start_states(rng, n)
        noise = rng.standard_normal((n, steps, self.model.nu))
        act = lambda states, ids, step: self.policy(observe(states), noise[ids, step])
        fields = {"body_mass": body_mass}
        runs = closed_loop(
            self.model,
            act,
            starts,
            steps,
            frame_skip=FRAME_SKIP,
            alive=healthy,
            fields=fields,
            hold=self.hold,
            threads=self.threads,
        )
        return runs, masses


def _sampler(masses: Masses | ArrayLike | None) -> Masses:
    if callable(masses):
        return masses
    rows = list(TRUTH.values()) if masses is None else masses
    endless = cycle(np.atleast_2d(np.asarray(rows, dtype=float)))
    return lambda rng, blocks: np.array(list(islice(endless, blocks)))


def _collect(hopper: _Hopper, steps: int, total: int, rng: Generator) -> tuple[Trajectories, Array]:
    """`total` transitions in trajectories of up to so many steps, and the masses of their groups
    (G, 4).
    """
    parts: list[tuple[Array, Array, Ints, Array]] = []
    missing = total
    while missing > 0:
        runs, masses = hopper.run(-(-missing // steps), steps, rng)
        if not runs.lengths.any():
            raise SimulationFailed(
                "The hopper diverges in its first step: are the masses possible ones?"
            )
        parts += [
            _part(runs, masses[i], i, hopper.hold) for i in np.flatnonzero(runs.lengths).tolist()
        ]
        missing = total - sum(len(part[1]) for part in parts)
    firsts = np.cumsum([0, *(len(part[3]) for part in parts)])
    groups = np.concatenate([first + part[2] for first, part in zip(firsts, parts, strict=False)])
    data = Trajectories(
        np.concatenate([observe(states[:-1]) for states, *_ in parts]),
        np.concatenate([actions for _, actions, *_ in parts]),
        np.concatenate([observe(states[1:]) for states, *_ in parts]),
        np.concatenate([np.arange(len(part[1])) == len(part[1]) - 1 for part in parts]),
        group=groups,
    ).head(total)
    return data, np.concatenate([part[3] for part in parts])[: groups[total - 1] + 1]


def _part(runs: Rollouts, masses: Array, i: int, hold: int) -> tuple[Array, Array, Ints, Array]:
    """One run's states (L + 1, 12), actions (L, 3), blocks (L,) from 0, and their masses (blocks,
    4).
    """
    length = runs.lengths[i]
    block = np.arange(length) // hold
    return runs.states[i, : length + 1], runs.actions[i, :length], block, masses[: block[-1] + 1]
