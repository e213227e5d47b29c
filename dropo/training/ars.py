"""Augmented random search for a linear policy, on batched simulation."""

import math
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.random import Generator

from dropo.core.records.trajectories import Ints
from dropo.core.services.files.atomic_write import write_npz
from dropo.core.services.files.saved_files import read_npz, require_shapes
from dropo.core.services.validation import Array, require
from dropo.training.batched_env import BatchedEnv
from dropo.training.policy import LinearPolicy, linear
from dropo.training.rollouts import draw_seeds, rollout, rollout_many
from dropo.training.setup import Progress, TrainingSetup

STATE_FILE = "ars.npz"
"""The file from which an interrupted search goes on."""
STATE = {
    "weights": "finite q o",
    "count": "whole",
    "mean": "finite o",
    "square": "finite o",
    "best": "finite q o",
    "best_mean": "finite o",
    "best_deviation": "finite o",
    "best_return": "number",
    "history": "finite n 4",
    "update": "whole",
    "steps": "whole",
    "failures": "whole",
}
"""The arrays of that file with their kinds and axes."""
CONSTANT_BELOW = 1e-8
"""Standard deviation below which an observation counts as constant."""


@dataclass
class Search:
    """The state of a search, from which an interrupted one goes on.

    Attributes
    ----------
    weights : (q, o) array
        Weights of the present policy.
    count : int
        Number of observations made so far.
    mean, square : (o,) array
        Mean of these observations, and sum of their squared deviations from it.
    best, best_mean, best_deviation : (q, o), (o,), (o,) array
        Weights and normalisation of the policy with the highest return in a trial.
    best_return : float
        That return.
    history : (n, 4) array
        For each trial: updates, control steps, mean return and its standard error.
    update : int
        Number of updates made.
    steps : int
        Number of control steps made.
    failures : int
        Number of simulations that diverged.
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
        """Begin a search.

        Parameters
        ----------
        actions, observations : int
            Numbers q and o of actions and observations.

        Returns
        -------
        Search
            The state before the first update, with weights (q, o) of 0.
        """
        return cls(
            weights=np.zeros((actions, observations)),
            count=0,
            mean=np.zeros(observations),
            square=np.zeros(observations),
            best=np.zeros((actions, observations)),
            best_mean=np.zeros(observations),
            best_deviation=np.ones(observations),
            best_return=-math.inf,
            history=np.zeros((0, 4)),
        )

    @property
    def deviation(self) -> Array:
        """The standard deviation of the observations (o,); 1 where an observation is constant."""
        deviation = np.sqrt(self.square / max(self.count, 1))
        return np.where(deviation > CONSTANT_BELOW, deviation, 1.0)

    def add_observations(self, values: Array) -> None:
        """Update count, mean and square by more observations.

        Parameters
        ----------
        values : (m, o) array
            The observations.

        References
        ----------
        Chan, Golub and LeVeque (1983), "Algorithms for computing the sample variance", The American
        Statistician 37.
        """
        m = len(values)
        total = self.count + m
        shift = values.mean(axis=0) - self.mean
        within = values.var(axis=0) * m
        between = shift**2 * self.count * m / total
        self.square = self.square + within + between
        self.mean = self.mean + shift * m / total
        self.count = total

    def save(self, folder: Path) -> None:
        """Write the state into a folder, whole or not at all.

        Parameters
        ----------
        folder : Path
            Where the file `STATE_FILE` is written.
        """
        write_npz(folder / STATE_FILE, asdict(self))

    @classmethod
    def load(cls, folder: Path, actions: int, observations: int) -> Self:
        """Read the state that `save` wrote into a folder.

        Parameters
        ----------
        folder : Path
            Where it was written.
        actions, observations : int
            Numbers of them, which the state must have too.

        Returns
        -------
        Search

        Raises
        ------
        BadFile
            If the file cannot be read or is no state of a search.
        """
        path = folder / STATE_FILE
        what = "a search that was interrupted"
        kept = read_npz(path, what)
        require_shapes(path, kept, STATE, {"q": actions, "o": observations})
        state: dict[str, Any] = {name: kept[name] for name in STATE}
        return cls(**{name: a if a.ndim else a.item() for name, a in state.items()})


@dataclass(frozen=True, kw_only=True)
class ARS:
    """Augmented random search V2-t for a linear policy.

    Observations are normalised by those made so far, and steps are scaled by the standard deviation
    of the returns. The two senses of a direction share draw, start and noise. The bonus for being
    alive does not count in updates, as it rewards standing still; it does in trials. Every `every`
    updates the policy runs `trials` episodes, always with the same draws at the distribution's full
    width, and the best policy is kept.

    Attributes
    ----------
    updates : int
        Number of updates of the policy.
    directions : int
        Number N of random directions in an update, each tried in both senses, one episode each.
    best : int
        Number b of directions with the highest returns, which an update uses.
    step : float
        Step size alpha.
    size : float
        Standard deviation nu of the perturbed weights.
    trials : int
        Number of episodes in a trial.
    every : int
        Number of updates between trials.

    Raises
    ------
    BadArgument
        If a number is below 1, `best` exceeds `directions`, or `step` or `size` is not positive.

    References
    ----------
    Mania, Guy and Recht (2018), "Simple random search of static linear policies is competitive for
    reinforcement learning", NeurIPS, Algorithm 1.
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
        names = "updates, directions, best, trials, every"
        require(min(counts) >= 1, names, "at least 1", counts, "ARS")
        rule = f"at most directions = {self.directions}"
        require(self.best <= self.directions, "best", rule, self.best, "ARS")
        sizes = (self.step, self.size)
        require(min(sizes) > 0, "step, size", "positive", sizes, "ARS")

    def train(
        self, setup: TrainingSetup, rng: Generator, folder: Path | None, progress: Progress
    ) -> LinearPolicy:
        """Searches for the best policy.

        Parameters
        ----------
        setup : TrainingSetup
            The environments.
        rng : numpy.random.Generator
            Source of all random numbers. Each update has a child of its own.
        folder : Path or None
            Where the state is kept after each update. A search goes on from the state that is
            there, to the same result.
        progress : callable
            Called with the fraction done and a text, after every update.

        Returns
        -------
        LinearPolicy
            The best policy of all trials.

        Raises
        ------
        BadFile
            If the state in the folder cannot be read.
        SimulationFailed
            If an episode diverges again and again.
        """
        batched_env = setup.batched_env(2 * self.directions)
        trial_env = setup.batched_env(self.trials, at_full_width=True)
        sizes = (batched_env.limits.shape[1], batched_env.observations)
        if folder is not None and (folder / STATE_FILE).is_file():
            search = Search.load(folder, *sizes)
        else:
            search = Search.new(*sizes)
        seeds = draw_seeds(rng.spawn(1)[0], self.trials)
        rng.spawn(search.update)  # the children of the updates that are already made
        batched_env.steps = search.steps
        batched_env.failures = search.failures
        while search.update < self.updates:
            self._update(search, batched_env, rng.spawn(1)[0])
            if search.update % self.every == 0 or search.update == self.updates:
                self._run_trial(search, trial_env, seeds)
            if folder is not None:
                search.save(folder)
            text = f"{search.steps:,} steps, best return {search.best_return:.0f}"
            progress(search.update / self.updates, text)
        batched_env.close()
        trial_env.close()
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
        """Makes one update of Algorithm 1."""
        # rollouts of the perturbed policies, both senses with the same seeds
        n = self.directions
        tried, both = self.perturb(search, rng)
        mean = search.mean
        deviation = search.deviation

        def act(observations: Array, ids: Ints) -> Array:
            return linear(both[ids], mean, deviation, batched_env.limits, observations)

        found = rollout(batched_env, act, np.tile(draw_seeds(rng, n), 2))
        # a step along the best directions
        self.improve(search, tried, (found.returns - found.bonus).reshape(2, n))
        search.add_observations(found.observations)
        search.update += 1
        search.steps = batched_env.steps
        search.failures = batched_env.failures

    def _run_trial(self, search: Search, batched_env: BatchedEnv, seeds: Ints) -> None:
        """Evaluates the present policy, and keeps it where it is the best so far."""
        policy = LinearPolicy(search.weights, search.mean, search.deviation, batched_env.limits)
        returns = rollout_many(
            batched_env, lambda observations, ids: policy(observations), seeds
        ).returns
        error = returns.std(ddof=1) / math.sqrt(len(returns)) if len(returns) > 1 else 0.0
        row = [search.update, search.steps, returns.mean(), error]
        search.history = np.vstack([search.history, row])
        if returns.mean() > search.best_return:
            search.best = policy.weights
            search.best_mean = policy.mean
            search.best_deviation = policy.deviation
            search.best_return = float(returns.mean())
