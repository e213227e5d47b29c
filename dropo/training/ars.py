"""Augmented random search for a linear policy, on batched simulation."""

import math
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.random import Generator

from dropo.core.services.atomic_write import write_npz
from dropo.core.services.errors import BadFile
from dropo.core.services.validation import Array, require
from dropo.training.batched_env import BatchedEnv
from dropo.training.policy import LinearPolicy, linear
from dropo.training.rollouts import rollout, rollout_many, seeds_from
from dropo.training.setup import Progress, TrainingSetup

KEPT = "ars.npz"
LEAST = 1e-8  # an observation that varies less counts as constant


@dataclass
class Search:
    """How far a search has come: what an interrupted one goes on from.

    weights: (q, o); count, mean (o,), square (o,): the observations seen, with the sum of their
    squared deviations; best, best_mean,
    best_deviation: the policy of the highest trial, best_return its return; history: (trials, 4)
    updates, control steps, return, standard error; update, steps, failures: made so far.
    """

    weights: Array
    count: int
    mean: Array
    square: Array
    best: Array
    best_mean: Array
    best_deviation: Array
    best_return: float
    history: Array
    update: int = 0
    steps: int = 0
    failures: int = 0

    @classmethod
    def new(cls, actions: int, observations: int) -> Self:
        """From nothing."""
        zero = np.zeros((actions, observations))
        none = np.zeros(observations)
        one = np.ones(observations)
        return cls(zero, 0, none, none, zero, none, one, -math.inf, np.zeros((0, 4)))

    @property
    def deviation(self) -> Array:
        """(o,) the standard deviation of what was seen; 1 where nothing varied."""
        spread = np.sqrt(self.square / max(self.count, 1))
        return np.where(spread > LEAST, spread, 1.0)

    def see(self, values: Array) -> None:
        """Takes in observations (m, o), by the update of Chan, Golub and LeVeque (1983)."""
        total = self.count + len(values)
        shift = values.mean(axis=0) - self.mean
        self.square = (
            self.square
            + values.var(axis=0) * len(values)
            + shift**2 * self.count * len(values) / total
        )
        self.mean = self.mean + shift * len(values) / total
        self.count = total

    def save(self, folder: Path) -> None:
        """Writes it whole or not at all."""
        write_npz(folder / KEPT, asdict(self))

    @classmethod
    def load(cls, folder: Path) -> Self:
        """What `save` wrote."""
        try:
            with np.load(folder / KEPT, allow_pickle=False) as kept:
                return cls(
                    **{
                        name: kept[name] if kept[name].ndim else kept[name].item()
                        for name in kept.files
                    }
                )
        except (OSError, ValueError, TypeError, KeyError) as error:
            raise BadFile(
                folder / KEPT,
                "",
                "a search that was interrupted",
                f"{type(error).__name__}: {error}",
            ) from None


@dataclass(frozen=True, kw_only=True)
class ARS:
    """Augmented random search V2-t of Mania, Guy and Recht, "Simple random search of static linear
    policies is competitive for reinforcement learning", 2018, Algorithm 1: observations
    normalised by what was seen, steps scaled by the spread of returns.

    updates: of the policy; directions: N, tried in both senses, one episode each; best: b, those
    that count; step: alpha;
    size: nu. The two senses of a direction share draw, start and noise. The bonus for being alive
    does not count, as it rewards standing still; it does in trials: every `every` updates the
    policy plays `trials` episodes of the same draws, at the law's full width, and the best one is
    kept.
    """

    updates: int = 200
    directions: int = 16
    best: int = 8
    step: float = 0.02
    size: float = 0.03
    trials: int = 32
    every: int = 10
    name = "ars"

    def __post_init__(self) -> None:
        counts = (self.updates, self.directions, self.best, self.trials, self.every)
        require(
            min(counts) >= 1,
            "updates, directions, best, trials, every",
            "at least 1",
            counts,
            "ARS",
        )
        require(
            self.best <= self.directions,
            "best",
            f"at most directions = {self.directions}",
            self.best,
            "ARS",
        )
        require(
            min(self.step, self.size) > 0, "step, size", "positive", (self.step, self.size), "ARS"
        )

    def train(
        self, setup: TrainingSetup, rng: Generator, folder: Path | None, progress: Progress
    ) -> LinearPolicy:
        """The best policy of the search on a stage; with a folder, it goes on from what is there,
        to the same result.

        progress: called with the share done and a text, after every update.
        """
        batched_env = setup.batched_env(2 * self.directions)
        trial = setup.batched_env(self.trials, whole=True)
        q = batched_env.limits.shape[1]
        going_on = folder is not None and (folder / KEPT).is_file()
        search = (
            Search.load(folder)
            if going_on and folder is not None
            else Search.new(q, batched_env.observations)
        )
        seeds = seeds_from(rng.spawn(1)[0], self.trials)
        rng.spawn(
            search.update
        )  # each update has a child of its own: those of the updates made are passed over
        batched_env.steps = search.steps
        batched_env.failures = search.failures
        while search.update < self.updates:
            self._update(search, batched_env, rng.spawn(1)[0])
            if search.update % self.every == 0 or search.update == self.updates:
                self._try(search, trial, seeds)
            if folder is not None:
                search.save(folder)
            progress(
                search.update / self.updates,
                f"{search.steps:,} steps, best return {search.best_return:.0f}",
            )
        batched_env.close()
        trial.close()
        about = {
            "history": search.history.tolist(),
            "control_steps": search.steps,
            "failed_simulations": search.failures,
        }
        return LinearPolicy(
            search.best, search.best_mean, search.best_deviation, batched_env.limits, about
        )

    def perturb(self, search: Search, rng: Generator) -> tuple[Array, Array]:
        """Draw the directions of one update, and the weights to try along them.

        Parameters
        ----------
        search : Search
            The search, with weights (q, o).
        rng : Generator
            Draws the directions.

        Returns
        -------
        tried : Array, shape (directions, q, o)
            The directions.
        both : Array, shape (2 * directions, q, o)
            The weights: all in the one sense, then all in the other.
        """
        tried = rng.standard_normal((self.directions, *search.weights.shape))
        both = search.weights + self.size * np.concatenate([tried, -tried])
        return tried, both

    def improve(self, search: Search, tried: Array, gains: Array) -> None:
        """Step along the best directions, scaled by the spread of their returns.

        Parameters
        ----------
        search : Search
            The search; its weights are changed.
        tried : Array, shape (directions, q, o)
            The directions.
        gains : Array, shape (2, directions)
            The returns in both senses.
        """
        best = np.argsort(-gains.max(axis=0), kind="stable")[: self.best]
        change = ((gains[0] - gains[1])[best, None, None] * tried[best]).sum(axis=0)
        spread = float(gains[:, best].std()) or 1.0
        search.weights = search.weights + self.step / (self.best * spread) * change

    def _update(self, search: Search, batched_env: BatchedEnv, rng: Generator) -> None:
        """One step of Algorithm 1."""
        n = self.directions
        tried, both = self.perturb(search, rng)
        mean = search.mean
        deviation = search.deviation
        found = rollout(
            batched_env,
            lambda seen, ids: linear(both[ids], mean, deviation, batched_env.limits, seen),
            np.tile(seeds_from(rng, n), 2),
        )
        gains = (found.returns - found.bonus).reshape(2, n)
        self.improve(search, tried, gains)
        search.see(found.observations)
        search.update = search.update + 1
        search.steps = batched_env.steps
        search.failures = batched_env.failures

    def _try(self, search: Search, batched_env: BatchedEnv, seeds: Any) -> None:
        """Keeps the policy where it is the best so far."""
        weights = search.weights
        mean = search.mean
        deviation = search.deviation
        returns = rollout_many(
            batched_env,
            lambda seen, ids: linear(weights, mean, deviation, batched_env.limits, seen),
            seeds,
        ).returns
        error = returns.std(ddof=1) / math.sqrt(len(returns)) if len(returns) > 1 else 0.0
        search.history = np.vstack(
            [search.history, [search.update, search.steps, returns.mean(), error]]
        )
        if returns.mean() > search.best_return:
            search.best = weights
            search.best_mean = mean
            search.best_deviation = deviation
            search.best_return = float(returns.mean())
