"""Evaluates policies: returns of independent episodes on a target."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from dropo.core.contracts.problem import Problem
from dropo.core.records.trajectories import Ints
from dropo.core.services.errors import SimulationFailed
from dropo.core.services.tables import Report, Table, number
from dropo.core.services.validation import Array, require
from dropo.training.batched_env import BatchedEnv
from dropo.training.distributions import ParameterDistribution, Point, full_width
from dropo.training.environments import Target, batched_env, resolve
from dropo.training.policy import Policy
from dropo.training.rollouts import draw_seeds, rollout_many


@dataclass(frozen=True, eq=False, repr=False)
class Returns(Report):
    """Returns of independent episodes, with their mean and its standard error.

    Attributes
    ----------
    target : str
        Name of the target.
    returns : (n,) array
        Return of each episode.
    lengths : (n,) int array
        Steps of each episode.
    steps : int
        Steps of a whole episode.
    failures : int
        Number of draws that broke the simulation and were drawn again.
    """

    target: str
    returns: Array
    lengths: Ints
    steps: int
    failures: int = 0

    @property
    def mean(self) -> float:
        """The mean of the returns."""
        return float(self.returns.mean())

    @property
    def standard_error(self) -> float:
        """The standard error of the mean, sd / sqrt(n); NaN of a single episode."""
        n = len(self.returns)
        return float(self.returns.std(ddof=1) / math.sqrt(n)) if n > 1 else math.nan

    def parts(self) -> list[str | Table]:
        """Return a table of one row."""
        return Compared({self.target: self}).parts()

    def to_json(self) -> dict[str, Any]:
        """Return all results as JSON.

        Returns
        -------
        dict
            All results.
        """
        error = self.standard_error
        return {
            "target": self.target,
            "episodes": len(self.returns),
            "mean": self.mean,
            "standard_error": error if math.isfinite(error) else None,
            "returns": self.returns.tolist(),
            "lengths": self.lengths.tolist(),
            "steps": self.steps,
            "failed_simulations": self.failures,
        }


@dataclass(frozen=True, repr=False)
class Compared(Report):
    """A table of the returns of several evaluations.

    Attributes
    ----------
    found : dict of str to Returns
        The returns of each row, by its title.
    warnings : tuple of str
        Further warnings, a sentence each.
    """

    found: dict[str, Returns]
    warnings: tuple[str, ...] = ()

    def parts(self) -> list[str | Table]:
        """Return a table with a row for each evaluation, and the warnings."""
        head = ("on", "episodes", "return", "se", "lowest", "highest", "steps", "not ended early")
        rows = []
        warnings = []
        for title, found in self.found.items():
            rows.append((title, *_row(found)))
            if found.failures:
                warnings.append(f"{title}: {broken(found.failures)}")
        warnings += self.warnings
        return [Table("", head, tuple(rows)), *(f"warning: {text}" for text in warnings)]


def broken(count: int) -> str:
    """Say how many draws broke the simulation.

    Parameters
    ----------
    count : int
        The number.

    Returns
    -------
    str
        A sentence without a full stop.
    """
    return f"{count} draws of the parameters broke the simulation and were drawn again"


def _row(found: Returns) -> tuple[str, ...]:
    """Returns the entries of a table's row."""
    return (
        str(len(found.returns)),
        number(found.mean, 5),
        number(found.standard_error, 2),
        number(float(found.returns.min()), 5),
        number(float(found.returns.max()), 5),
        number(float(found.lengths.mean())),
        f"{(found.lengths == found.steps).mean():.0%}",
    )


def evaluate(
    policy: Policy,
    target: Target,
    *,
    distribution: ParameterDistribution | None = None,
    episodes: int = 100,
    steps: int | None = None,
    noise: ArrayLike | None = None,
    rng: np.random.Generator | int = 0,
    threads: int = 1,
    batch_size: int = 32,
) -> Returns:
    """Evaluate a policy on a target in independent episodes.

    The same `rng` gives every policy the same draws and starts.

    Parameters
    ----------
    policy : Policy
        A policy of `train` or `load_policy`.
    target : Problem, str or Path
        A problem with a task, its name or file, or the id of a Gymnasium MuJoCo environment.
    distribution : ParameterDistribution, optional
        What the target's parameters are drawn from. By default they are a problem's true ones where
        they are known, else those of the model.
    episodes : int
        Number of episodes.
    steps : int, optional
        Steps of an episode, by default those that the policy was trained with.
    noise : float or (p,) array, optional
        Variances of the measurement noise, one or one a signal; by default those that a fit
        learned, 0 for none.
    rng : numpy.random.Generator or int
        Source of the episodes' seeds, or its seed.
    threads : int
        Number of threads, 0 for all cores.
    batch_size : int
        Maximum number of episodes that are simulated together. The returns do not depend on it.

    Returns
    -------
    The returns of the episodes.

    Raises
    ------
    BadArgument
        If `episodes` or `batch_size` is below 1, or `noise` cannot be used.
    UnknownName
        If there is no such target.
    Incompatible
        If the policy or the distribution does not fit the target.
    SimulationFailed
        If the simulation diverges under draw after draw.
    """
    require(episodes >= 1, "episodes", "at least 1", episodes, "evaluate")
    require(batch_size >= 1, "batch_size", "at least 1", batch_size, "evaluate")
    count = min(episodes, batch_size)
    env = _env_for(policy, target, distribution, count, steps, noise, threads)
    seeds = draw_seeds(np.random.default_rng(rng), episodes)
    try:
        found = rollout_many(env, lambda observations, ids: policy(observations), seeds)
        return Returns(env.name, found.returns, found.lengths, env.length, env.failures)
    finally:
        env.close()


def _env_for(
    policy: Policy,
    target: Target,
    distribution: ParameterDistribution | None,
    count: int,
    steps: int | None,
    noise: ArrayLike | None,
    threads: int,
) -> BatchedEnv:
    """Returns environments of the target, in which the policy is checked to fit."""
    target = resolve(target)
    if distribution is not None:
        distribution = full_width(distribution)
    elif isinstance(target, Problem) and target.truth is not None:
        distribution = _true_parameters(target, target.truth)
    steps = steps or policy.about.get("steps")
    env = batched_env(target, distribution, count, noise=noise, steps=steps, threads=threads)
    policy.check(env.observations, env.limits, repr(env.name))
    return env


def _true_parameters(problem: Problem, truth: Mapping[str, float]) -> Point:
    """Returns a problem's true parameters, and the nominal ones of which the truth says nothing."""
    nominal = problem.simulator.nominal
    if nominal is None:
        nominal = np.full(len(problem.space), math.nan)
    values = dict(zip(problem.space.names, nominal.tolist(), strict=True))
    return Point(problem.space, problem.space.vector({**values, **truth}))


def motion(
    policy: Policy, target: Target, *, steps: int | None = None, rng: np.random.Generator | int = 0
) -> tuple[Array, Any, float]:
    """Run one episode for display.

    Parameters
    ----------
    policy : Policy
        A policy of `train` or `load_policy`.
    target : Problem, str or Path
        A problem with a task, its name or file, or the id of a Gymnasium MuJoCo environment.
    steps : int, optional
        Steps of the episode, by default those that the policy was trained with.
    rng : numpy.random.Generator or int
        Source of the episode's seed, or its seed.

    Returns
    -------
    qpos : (L + 1, nq) array
        Joint positions, from the start on.
    model : mujoco.MjModel
        The simulated model.
    control_step : float
        Time between positions [s].

    Raises
    ------
    UnknownName
        If there is no such target.
    Incompatible
        If the policy does not fit the target.
    SimulationFailed
        If the simulation diverges.
    """
    env = _env_for(policy, target, None, 1, steps, None, 1)
    ids = np.zeros(1, dtype=np.int64)
    observations = env.reset(ids, draw_seeds(np.random.default_rng(rng), 1).tolist())
    states = [env.episodes.states(ids)[0]]
    ended = False
    while not ended:
        outcome = env.step(ids, policy(observations))
        if outcome.broken[0]:
            raise SimulationFailed(f"The simulation of {env.name} diverged under the policy.")
        observations = outcome.observations
        ended = bool(outcome.ended[0])
        states.append(env.episodes.states(ids)[0])
    simulator = env.episodes.simulator
    env.close()
    return np.array(states)[:, : simulator.model.nq], simulator.model, simulator.control_step
