"""How well a policy does on a target."""

import math
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
from dropo.training.distributions import ParameterDistribution, Point, full
from dropo.training.environments import Target, batched_env, resolve
from dropo.training.policy import Policy
from dropo.training.rollouts import rollout_many, seeds_from

TOGETHER = 32


@dataclass(frozen=True, eq=False, repr=False)
class Returns(Report):
    """Returns (n,) of n independent episodes, their mean and its standard error, sd / sqrt(n);
    lengths: (n,) in steps.

    target: its name; steps: of a whole episode; failures: draws that broke the simulation, and were
    drawn again.
    """

    target: str
    returns: Array
    lengths: Ints
    steps: int
    failures: int = 0

    @property
    def mean(self) -> float:
        """The mean return."""
        return float(self.returns.mean())

    @property
    def standard_error(self) -> float:
        """Of the mean; NaN of a single episode."""
        return (
            float(self.returns.std(ddof=1) / math.sqrt(len(self.returns)))
            if len(self.returns) > 1
            else math.nan
        )

    def parts(self) -> list[str | Table]:
        """A table of one row."""
        return Compared({self.target: self}).parts()

    def to_json(self) -> dict[str, Any]:
        """Everything."""
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
    """Returns by what they are of; warnings: what else is to be said, a sentence each."""

    found: dict[str, Returns]
    warnings: tuple[str, ...] = ()

    def parts(self) -> list[str | Table]:
        """A table with a row for each."""
        rows = tuple((name, *_row(found)) for name, found in self.found.items())
        said = [
            f"{name}: {broken(found.failures)}"
            for name, found in self.found.items()
            if found.failures
        ]
        return [
            Table(
                "",
                ("on", "episodes", "return", "se", "lowest", "highest", "steps", "not ended early"),
                rows,
            ),
            *(f"warning: {text}" for text in (*said, *self.warnings)),
        ]


def broken(count: int) -> str:
    """A sentence on so many draws."""
    return f"{count} draws of the parameters broke the simulation and were drawn again"


def _row(found: Returns) -> tuple[str, ...]:
    spread = (
        found.mean,
        found.standard_error,
        float(found.returns.min()),
        float(found.returns.max()),
    )
    mean, error, lowest, highest = (
        number(value, digits) for value, digits in zip(spread, (5, 2, 5, 5), strict=True)
    )
    whole = f"{(found.lengths == found.steps).mean():.0%}"
    return (
        str(len(found.returns)),
        mean,
        error,
        lowest,
        highest,
        number(float(found.lengths.mean())),
        whole,
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
) -> Returns:
    """Plays a policy on a target in so many independent episodes; the same `rng` gives every policy
    the same draws and starts.

    policy: what `train` or `load_policy` gave; target: a Problem, its name or file, or the id of a
    Gymnasium environment. law: what its parameters are drawn from; None: a problem's true ones
    where they are known, else its model as it is. steps: of an episode; None: those that the policy
    was trained on. noise: as for `randomize`; threads: 0 for all cores.
    """
    require(episodes >= 1, "episodes", "at least 1", episodes, "evaluate")
    made = setup(policy, target, distribution, min(episodes, TOGETHER), steps, noise, threads)
    try:
        found = rollout_many(
            made,
            lambda observed, ids: policy(observed),
            seeds_from(np.random.default_rng(rng), episodes),
        )
        return Returns(made.name, found.returns, found.lengths, made.length, made.failures)
    finally:
        made.close()


def setup(
    policy: Policy,
    target: Target,
    distribution: ParameterDistribution | None,
    count: int,
    steps: int | None,
    noise: ArrayLike | None,
    threads: int,
) -> BatchedEnv:
    """The target as an arena that the policy fits."""
    target = resolve(target)
    if distribution is None and isinstance(target, Problem) and target.truth is not None:
        distribution = Point(
            target.space,
            target.space.vector(
                {**dict(zip(target.space.names, _nominal(target), strict=True)), **target.truth}
            ),
        )
    made = batched_env(
        target,
        full(distribution),
        count,
        noise=noise,
        steps=steps or policy.about.get("steps"),
        threads=threads,
    )
    policy.check(made.observations, made.limits, repr(made.name))
    return made


def _nominal(problem: Problem) -> list[float]:
    nominal = problem.simulator.nominal
    return [math.nan] * len(problem.space) if nominal is None else nominal.tolist()


def motion(
    policy: Policy, target: Target, *, steps: int | None = None, rng: np.random.Generator | int = 0
) -> tuple[Array, Any, float]:
    """One episode to look at: joint positions (L + 1, nq), the MuJoCo model that moved, and the
    seconds between them.
    """
    made = setup(policy, target, None, 1, steps, None, 1)
    one = np.zeros(1, dtype=np.int64)
    observed = made.reset(one, seeds_from(np.random.default_rng(rng), 1).tolist())
    states = [made.episodes.states(one)[0]]
    ended = False
    while not ended:
        found = made.step(one, policy(observed))
        if found.broken[0]:
            raise SimulationFailed(f"The simulation of {made.name} diverged under the policy.")
        observed = found.observations
        ended = bool(found.ended[0])
        states.append(made.episodes.states(one)[0])
    simulator = made.episodes.simulator
    made.close()
    return np.array(states)[:, : simulator.model.nq], simulator.model, simulator.control_step
