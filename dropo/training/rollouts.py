"""Policies played in an arena: whole episodes, side by side."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from dropo.core.records.trajectories import Ints
from dropo.core.services.errors import SimulationFailed
from dropo.core.services.validation import Array
from dropo.training.batched_env import REDRAWS, BatchedEnv

Act = Callable[[Array, Ints], Array]
"""Actions (m, q) from observations (m, o) of the episodes `ids` (m,)."""


@dataclass(frozen=True, eq=False)
class Rollout:
    """n episodes: returns (n,) with the bonus, bonus (n,) that is in them, lengths (n,) in steps,
    observations (S, o) that were acted on, in an order that is always the same.
    """

    returns: Array
    bonus: Array
    lengths: Ints
    observations: Array


def rollout(batched_env: BatchedEnv, act: Act, seeds: Ints) -> Rollout:
    """An episode for each seed (n,), n at most the arena's count; those whose simulation diverges
    are played again from another draw.
    """
    n = len(seeds)
    returns = np.zeros(n)
    bonus = np.zeros(n)
    lengths = np.zeros(n, dtype=np.int64)
    seen = []
    todo = np.arange(n)
    now = np.array(seeds)
    for _ in range(REDRAWS):
        gained, extra, made, broken, observed = _once(batched_env, act, todo, now[todo])
        whole = ~broken
        returns[todo[whole]], bonus[todo[whole]], lengths[todo[whole]] = (
            gained[whole],
            extra[whole],
            made[whole],
        )
        seen.append(observed)
        if whole.all():
            return Rollout(returns, bonus, lengths, np.concatenate(seen))
        todo = todo[broken]
        now[todo] = [
            int(np.random.default_rng([seed, 1]).integers(2**62)) for seed in now[todo].tolist()
        ]
    where = batched_env.describe(int(todo[0]))
    raise SimulationFailed(
        f"The simulation diverged in {REDRAWS} episodes in a row, the last under {where}."
    )


def _once(
    batched_env: BatchedEnv, act: Act, todo: Ints, seeds: Ints
) -> tuple[Array, Array, Ints, np.ndarray, Array]:
    """Returns, bonus, lengths and whether they broke, of episodes `todo`, and the observations of
    those that did not.
    """
    n = batched_env.count
    returns = np.zeros(n)
    bonus = np.zeros(n)
    lengths = np.zeros(n, dtype=np.int64)
    broken = np.zeros(n, dtype=bool)
    seen: list[Array] = []
    owners: list[Ints] = []
    ids = todo
    observed = batched_env.reset(todo, seeds.tolist())
    while len(ids):
        seen.append(observed.copy())
        owners.append(ids)
        found = batched_env.step(ids, act(observed, ids))
        returns[ids] += found.rewards
        bonus[ids] += found.bonus
        lengths[ids] += 1
        broken[ids] = found.broken
        going = ~found.ended
        ids = ids[going]
        observed = found.observations[going]
    kept = np.concatenate(seen)[~broken[np.concatenate(owners)]]
    return returns[todo], bonus[todo], lengths[todo], broken[todo], kept


def rollout_many(batched_env: BatchedEnv, act: Act, seeds: Ints) -> Rollout:
    """The same for any number of seeds, in blocks of the arena's count; the observations are not
    kept.
    """
    parts = [
        rollout(batched_env, act, seeds[first : first + batched_env.count])
        for first in range(0, len(seeds), batched_env.count)
    ]
    returns, bonus, lengths = (
        np.concatenate([getattr(part, name) for part in parts])
        for name in ("returns", "bonus", "lengths")
    )
    return Rollout(returns, bonus, lengths, np.zeros((0, batched_env.observations)))


def seeds_from(rng: np.random.Generator, n: int) -> Ints:
    """(n,) seeds of episodes."""
    return rng.integers(2**62, size=n)
