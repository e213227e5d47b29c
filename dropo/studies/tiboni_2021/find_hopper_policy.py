"""Finds the hopper's linear policy by augmented random search, and writes it as JSON.

`python -m dropo.studies.tiboni_2021.find_hopper_policy --out hopper_policy.json` takes about a
minute.

The search is that of `dropo.training.ars`, on trajectories with noise on the actions. It stops at
a semi-converged policy: one that collects data with noise on its actions and seldom falls.
"""

import argparse
import json
import sys
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import mujoco
import numpy as np
from numpy.random import Generator

from dropo.core.records.trajectories import Ints
from dropo.core.services.files.atomic_write import write_text
from dropo.core.services.validation import Array
from dropo.mjmodel.options import physics_step
from dropo.problems.hopper.data import HopperPolicy, healthy, observe, start_states
from dropo.problems.hopper.model import FRAME_SKIP, hopper_model
from dropo.simulators.mujoco.closed_loop import Rollouts, closed_loop
from dropo.training.ars import ARS, Search


@dataclass(frozen=True)
class Settings:
    """What the search plays, and when it ends.

    Attributes
    ----------
    steps : int
        Control steps of a trajectory.
    action_noise : float
        Standard deviation of the noise on the actions, in the search and in collecting data.
    minimum_return : float
        Return, with the bonus of 1 a step, from which a policy is semi-converged.
    minimum_lasting : float
        Fraction of the trajectories that must not fall.
    """

    steps: int = 500
    action_noise: float = 0.1
    minimum_return: float = 1200.0
    minimum_lasting: float = 0.97


SETTINGS = Settings()
ALGORITHM = ARS(updates=300, directions=16, best=8, step=0.02, size=0.03, trials=100, every=10)


def run(model: mujoco.MjModel, policy: HopperPolicy, n: int, rng: Generator) -> Rollouts:
    """Simulate trajectories from noisy starts.

    Parameters
    ----------
    model : mujoco.MjModel
        The hopper.
    policy : HopperPolicy
        Its weights may be (n, 3, 11), one policy a trajectory.
    n : int
        Number of trajectories.
    rng : numpy.random.Generator
        What starts and the noise on the actions are drawn from.

    Returns
    -------
    Rollouts
        Of n trajectories, each until the hopper falls or the settings' number of steps is reached.
    """
    noise = rng.standard_normal((n, SETTINGS.steps, model.nu))
    weights = np.broadcast_to(policy.weights, (n, 3, 11))

    def act(states: Array, ids: Ints, step: int) -> Array:
        return replace(policy, weights=weights[ids])(observe(states), noise[ids, step])

    starts = start_states(rng, n)
    return closed_loop(model, act, starts, SETTINGS.steps, frame_skip=FRAME_SKIP, alive=healthy)


def returns(model: mujoco.MjModel, runs: Rollouts) -> Array:
    """Compute Gymnasium's return without the bonus for being alive.

    Parameters
    ----------
    model : mujoco.MjModel
        The hopper.
    runs : Rollouts
        n trajectories.

    Returns
    -------
    (n,) array
        Distance in the units of a control step, less 0.001 of the squared actions.
    """
    ends = runs.states[np.arange(len(runs.lengths)), runs.lengths, 0]
    speed = (ends - runs.states[:, 0, 0]) / (FRAME_SKIP * physics_step(model))
    gains: Array = speed - 1e-3 * np.nansum(runs.actions**2, axis=(1, 2))
    return gains


def search(model: mujoco.MjModel, rng: Generator) -> Iterator[HopperPolicy]:
    """Search for a policy by augmented random search, without end.

    Parameters
    ----------
    model : mujoco.MjModel
        The hopper.
    rng : numpy.random.Generator
        What random numbers come from.

    Yields
    ------
    HopperPolicy
        The policy after each update.

    References
    ----------
    Mania, Guy and Recht, Simple random search of static linear policies is competitive for
    reinforcement learning, NeurIPS 2018.
    """
    state = Search.new(3, 11)
    while True:
        tried, both = ALGORITHM.perturb(state, rng)
        policies = HopperPolicy(both, state.mean, state.deviation, SETTINGS.action_noise)
        runs = run(model, policies, 2 * ALGORITHM.directions, rng)
        ALGORITHM.improve(state, tried, returns(model, runs).reshape(2, ALGORITHM.directions))
        visited = runs.states[:, :-1].reshape(-1, 12)
        state.add_observations(observe(visited[np.isfinite(visited).all(axis=1)]))
        yield HopperPolicy(state.weights, state.mean, state.deviation, SETTINGS.action_noise)


def rounded(policy: HopperPolicy) -> HopperPolicy:
    """Round a policy to six digits, as its JSON keeps it.

    Parameters
    ----------
    policy : HopperPolicy
        The policy.

    Returns
    -------
    HopperPolicy
        With rounded weights, means and deviations.
    """
    six = np.vectorize(lambda value: float(f"{value:.6g}"), otypes=[float])
    return HopperPolicy(
        six(policy.weights),
        six(policy.mean),
        six(policy.deviation),
        policy.action_noise,
    )


def found(model: mujoco.MjModel, seed: int, updates: int) -> tuple[HopperPolicy, dict[str, float]]:
    """Find the first semi-converged policy, else the last; prints its figures as it goes.

    Parameters
    ----------
    model : mujoco.MjModel
        The hopper.
    seed : int
        Seed of the search and of the trials.
    updates : int
        Largest number of updates.

    Returns
    -------
    policy : HopperPolicy
        The policy, rounded.
    figures : dict of str to float
        The seed, the number of updates, the mean return of the trials, and the fraction of them
        that do not fall.

    Raises
    ------
    AssertionError
        If the search ends, which it never does.
    """
    search_rng, trial_rng = np.random.default_rng(seed).spawn(2)
    for update, policy in enumerate(search(model, search_rng), 1):
        if update % ALGORITHM.every and update < updates:
            continue
        kept = rounded(policy)
        runs = run(model, kept, ALGORITHM.trials, trial_rng)
        value = float((returns(model, runs) + runs.lengths).mean())
        lasting = float((runs.lengths == SETTINGS.steps).mean())
        text = f"{lasting:.0%} of {ALGORITHM.trials} trajectories do not fall"
        print(f"update {update}: return {value:.0f}, {text}", file=sys.stderr, flush=True)
        converged = value >= SETTINGS.minimum_return and lasting >= SETTINGS.minimum_lasting
        if update >= updates or converged:
            figures = {"seed": seed, "updates": update, "return": round(value), "lasting": lasting}
            return kept, figures
    raise AssertionError("the search has no end")


def as_json(policy: HopperPolicy, figures: dict[str, float]) -> str:
    """Write a policy with its figures as JSON, one line a key.

    Parameters
    ----------
    policy : HopperPolicy
        The policy.
    figures : dict of str to float
        How it was found, which stands under "found".

    Returns
    -------
    str
        The text, which ends with a new line.
    """
    values = {name: np.asarray(value).tolist() for name, value in asdict(policy).items()}
    values["found"] = figures
    lines = [f"  {json.dumps(name)}: {json.dumps(value)}" for name, value in values.items()]
    return "{\n" + ",\n".join(lines) + "\n}\n"


def main() -> None:
    """Search, and write the best policy as JSON."""
    parser = argparse.ArgumentParser(
        description="Finds the hopper's policy by augmented random search.",
    )
    parser.add_argument(
        "--seed",
        type=int,
        default=3,
        help="the same seed finds the same policy on the same machine",
    )
    parser.add_argument(
        "--updates",
        type=int,
        default=ALGORITHM.updates,
        help="how many updates at most",
    )
    parser.add_argument(
        "--out",
        type=Path,
        help="the JSON file to write; the standard output without it",
    )
    options = parser.parse_args()
    text = as_json(*found(hopper_model(), options.seed, options.updates))
    if options.out is None:
        print(text, end="")
    else:
        write_text(options.out, text)


if __name__ == "__main__":
    main()
