"""Rollouts of policies: whole episodes in a batch of environments."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from dropo.core.records.trajectories import Ints
from dropo.core.services.errors import SimulationFailed
from dropo.core.services.validation import Array
from dropo.training.batched_env import BatchedEnv, Bools

Act = Callable[[Array, Ints], Array]
"""Actions (m, q) from observations (m, o) of the environments (m,)."""


@dataclass(frozen=True, eq=False)
class Rollout:
    """The results of n episodes.

    Attributes
    ----------
    returns : (n,) array
        Sums of the rewards, with the bonus.
    bonus : (n,) array
        The bonus for being alive within the returns.
    lengths : (n,) int array
        Steps of each episode.
    observations : (S, o) array
        Observations that the policy acted on, in a reproducible order; empty if not kept.
    """

    returns: Array
    bonus: Array
    lengths: Ints
    observations: Array


def rollout(batched_env: BatchedEnv, act: Act, seeds: Ints) -> Rollout:
    """Run an episode for each seed; those whose simulation diverges are run again from new draws.

    Parameters
    ----------
    batched_env : BatchedEnv
        Environments, at least as many as seeds.
    act : callable
        The policy: actions (m, q) from observations (m, o) of the environments (m,).
    seeds : (n,) int array
        Seeds of the episodes.

    Returns
    -------
    Rollout
        The episodes in the order of their seeds, with their observations.

    Raises
    ------
    SimulationFailed
        If the simulation of an episode diverges `batched_env.redraws` times in a row.
    """
    n = len(seeds)
    returns = np.zeros(n)
    bonus = np.zeros(n)
    lengths = np.zeros(n, dtype=np.int64)
    observations = []
    seeds = np.array(seeds)
    todo = np.arange(n)
    for _ in range(batched_env.redraws):
        found, broken = _run_once(batched_env, act, todo, seeds[todo])
        finished = todo[~broken]
        returns[finished] = found.returns[~broken]
        bonus[finished] = found.bonus[~broken]
        lengths[finished] = found.lengths[~broken]
        observations.append(found.observations)
        if not broken.any():
            return Rollout(returns, bonus, lengths, np.concatenate(observations))
        todo = todo[broken]
        seeds[todo] = [_next_seed(seed) for seed in seeds[todo].tolist()]
    where = batched_env.describe(int(todo[0]))
    raise SimulationFailed(
        f"The simulation diverged in {batched_env.redraws} episodes in a row, the last under "
        f"{where}."
    )


def _next_seed(seed: int) -> int:
    """Returns the seed with which an episode is run again."""
    return int(np.random.default_rng([seed, 1]).integers(2**62))


def _run_once(batched_env: BatchedEnv, act: Act, ids: Ints, seeds: Ints) -> tuple[Rollout, Bools]:
    """Runs an episode in each of the environments `ids` (n,).

    Returns the rollout, with the observations of the episodes that did not diverge, and which ones
    did (n,).
    """
    count = batched_env.count
    returns = np.zeros(count)
    bonus = np.zeros(count)
    lengths = np.zeros(count, dtype=np.int64)
    broken = np.zeros(count, dtype=bool)
    observations: list[Array] = []
    owners: list[Ints] = []
    running = ids
    observed = batched_env.reset(ids, seeds.tolist())
    while len(running):
        observations.append(observed.copy())
        owners.append(running)
        outcome = batched_env.step(running, act(observed, running))
        returns[running] += outcome.rewards
        bonus[running] += outcome.bonus
        lengths[running] += 1
        broken[running] = outcome.broken
        observed = outcome.observations[~outcome.ended]
        running = running[~outcome.ended]
    kept = np.concatenate(observations)[~broken[np.concatenate(owners)]]
    return Rollout(returns[ids], bonus[ids], lengths[ids], kept), broken[ids]


def rollout_many(batched_env: BatchedEnv, act: Act, seeds: Ints) -> Rollout:
    """Run an episode for each of any number of seeds, in blocks; observations are not kept.

    Parameters
    ----------
    batched_env : BatchedEnv
        Environments, as many as a block has episodes.
    act : callable
        The policy: actions (m, q) from observations (m, o) of the environments (m,).
    seeds : (n,) int array
        Seeds of the episodes.

    Returns
    -------
    Rollout
        The episodes in the order of their seeds.

    Raises
    ------
    SimulationFailed
        If the simulation of an episode diverges `batched_env.redraws` times in a row.
    """
    parts = []
    for first in range(0, len(seeds), batched_env.count):
        parts.append(rollout(batched_env, act, seeds[first : first + batched_env.count]))
    return Rollout(
        returns=np.concatenate([part.returns for part in parts]),
        bonus=np.concatenate([part.bonus for part in parts]),
        lengths=np.concatenate([part.lengths for part in parts]),
        observations=np.zeros((0, batched_env.observations)),
    )


def draw_seeds(rng: np.random.Generator, n: int) -> Ints:
    """Draw seeds of episodes.

    Parameters
    ----------
    rng : numpy.random.Generator
        What random numbers come from.
    n : int
        Number of seeds.

    Returns
    -------
    (n,) int array
        Between 0 and 2^62.
    """
    return rng.integers(2**62, size=n)
