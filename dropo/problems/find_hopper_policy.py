"""Finds the hopper's linear policy by augmented random search, and writes it as JSON.

`python -m dropo.problems.find_hopper_policy --out hopper_policy.json` takes about a minute.

ARS V2 of Mania, Guy and Recht, "Simple random search of static linear policies is competitive for
reinforcement learning", 2018, Algorithm 1, on batched simulation. The bonus for being alive is left
out of the search, which else settles for standing still. The search stops at a semi-converged
policy: one that collects data with noise on its actions and seldom falls.
"""

import argparse
import json
import sys
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

import mujoco
import numpy as np
from numpy.random import Generator

from dropo.core.services.validation import Array
from dropo.problems.hopper.data import LinearPolicy, healthy, observe, start_states
from dropo.problems.hopper.model import FRAME_SKIP, hopper_model
from dropo.simulators.mujoco.closed_loop import Runs, closed_loop

STEPS = 500  # control steps of a trajectory
# N, b, alpha, nu of Algorithm 1
DIRECTIONS = 16
BEST = 8
STEP = 0.02
SIZE = 0.03
ACTION_NOISE = 0.1  # standard deviation, in training and in collecting
# trajectories of an evaluation; updates between two
TRIALS = 100
EVERY = 10
# semi-converged: the return with the bonus of 1 a step, the share that must not fall
RETURN = 1200
LASTING = 0.97
SEED = 3


@dataclass
class Moments:
    """Running mean and spread of the observations seen, (11,)."""

    count: int = 0
    mean: Array = field(default_factory=lambda: np.zeros(11))
    square: Array = field(default_factory=lambda: np.zeros(11))  # sum of squared deviations

    def add(self, values: Array) -> None:
        """Takes in values (m, 11), by the update of Chan, Golub and LeVeque (1983)."""
        total = self.count + len(values)
        shift = values.mean(axis=0) - self.mean
        self.square = (
            self.square
            + values.var(axis=0) * len(values)
            + shift**2 * self.count * len(values) / total
        )
        self.mean = self.mean + shift * len(values) / total
        self.count = total

    @property
    def deviation(self) -> Array:
        """(11,) the standard deviation; 1 before anything was seen."""
        return np.sqrt(self.square / self.count) if self.count else np.ones(11)


def run(model: mujoco.MjModel, policy: LinearPolicy, n: int, rng: Generator) -> Runs:
    """n trajectories from noisy starts; the policy's weights may be (n, 3, 11), one policy a
    trajectory.
    """
    noise = rng.standard_normal((n, STEPS, model.nu))
    weights = np.broadcast_to(policy.weights, (n, 3, 11))
    act = lambda states, ids, step: replace(policy, weights=weights[ids])(
        observe(states), noise[ids, step]
    )
    return closed_loop(
        model, act, start_states(rng, n), STEPS, frame_skip=FRAME_SKIP, alive=healthy
    )


def returns(model: mujoco.MjModel, runs: Runs) -> Array:
    """(n,) Gymnasium's return without the bonus for being alive: distance per second, less 0.001 of
    the squared actions.
    """
    travelled = runs.states[np.arange(len(runs.lengths)), runs.lengths, 0] - runs.states[:, 0, 0]
    gains: Array = travelled / (FRAME_SKIP * model.opt.timestep) - 1e-3 * np.nansum(
        runs.actions**2, axis=(1, 2)
    )
    return gains


def search(model: mujoco.MjModel, rng: Generator) -> Iterator[LinearPolicy]:
    """The policy after each update, for ever: Algorithm 1 of Mania et al. 2018, V2-t."""
    weights = np.zeros((3, 11))
    seen = Moments()
    while True:
        tried = rng.standard_normal((DIRECTIONS, 3, 11))
        both = weights + SIZE * np.concatenate([tried, -tried])
        runs = run(
            model, LinearPolicy(both, seen.mean, seen.deviation, ACTION_NOISE), 2 * DIRECTIONS, rng
        )
        gains = returns(model, runs).reshape(2, DIRECTIONS)
        best = np.argsort(-gains.max(axis=0))[:BEST]
        change = ((gains[0] - gains[1])[best, None, None] * tried[best]).sum(axis=0)
        weights = weights + STEP / (BEST * gains[:, best].std()) * change
        states = runs.states[:, :-1].reshape(-1, 12)
        seen.add(observe(states[np.isfinite(states).all(axis=1)]))
        yield LinearPolicy(weights, seen.mean, seen.deviation, ACTION_NOISE)


def rounded(policy: LinearPolicy) -> LinearPolicy:
    """The policy to six digits, as its JSON keeps it."""
    six = np.vectorize(lambda value: float(f"{value:.6g}"), otypes=[float])
    return LinearPolicy(
        six(policy.weights), six(policy.mean), six(policy.deviation), policy.action_noise
    )


def found(model: mujoco.MjModel, seed: int, updates: int) -> tuple[LinearPolicy, dict[str, float]]:
    """The first semi-converged policy, else the last, and its figures; prints them as it goes."""
    search_rng, trial_rng = np.random.default_rng(seed).spawn(2)
    for update, policy in enumerate(search(model, search_rng), 1):
        if update % EVERY and update < updates:
            continue
        kept = rounded(policy)
        runs = run(model, kept, TRIALS, trial_rng)
        value = float((returns(model, runs) + runs.lengths).mean())
        lasting = float((runs.lengths == STEPS).mean())
        print(
            (
                f"update {update}: return {value:.0f}, {lasting:.0%} of {TRIALS} trajectories "
                "do not fall"
            ),
            file=sys.stderr,
            flush=True,
        )
        if update >= updates or (value >= RETURN and lasting >= LASTING):
            return kept, {
                "seed": seed,
                "updates": update,
                "return": round(value),
                "lasting": lasting,
            }
    raise AssertionError("the search has no end")


def as_json(policy: LinearPolicy, figures: dict[str, float]) -> str:
    """One line a key."""
    values = {name: np.asarray(value).tolist() for name, value in asdict(policy).items()} | {
        "found": figures
    }
    return (
        "{\n"
        + ",\n".join(f"  {json.dumps(name)}: {json.dumps(value)}" for name, value in values.items())
        + "\n}\n"
    )


def main() -> None:
    parser = argparse.ArgumentParser(
        description="Finds the hopper's policy by augmented random search."
    )
    parser.add_argument(
        "--seed",
        type=int,
        default=SEED,
        help="the same seed finds the same policy on the same machine",
    )
    parser.add_argument("--updates", type=int, default=300, help="how many updates at most")
    parser.add_argument(
        "--out", type=Path, help="the JSON file to write; the standard output without it"
    )
    options = parser.parse_args()
    text = as_json(*found(hopper_model(), options.seed, options.updates))
    if options.out is None:
        print(text, end="")
    else:
        options.out.write_text(text)


if __name__ == "__main__":
    main()
