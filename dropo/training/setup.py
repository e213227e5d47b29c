"""What a policy is trained on: a target with a law of its parameters."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from numpy.typing import ArrayLike

from dropo.core.contracts.effect import ActiveEffects
from dropo.training.batched_env import BatchedEnv
from dropo.training.distributions import ParameterDistribution, full
from dropo.training.environments import Target, batched_env, randomize

Progress = Callable[[float, str], None]
"""progress(share, text), as the command line draws it."""


@dataclass(frozen=True, eq=False)
class TrainingSetup:
    """Everything that decides what a policy meets in training; as for `randomize`."""

    target: Target
    distribution: ParameterDistribution | None
    noise: ArrayLike | None = None
    effects: ActiveEffects = ()
    steps: int | None = None
    threads: int = 1

    def batched_env(self, count: int, *, whole: bool = False) -> BatchedEnv:
        """So many environments side by side; whole: under the law at its full width."""
        distribution = full(self.distribution) if whole else self.distribution
        return batched_env(
            self.target,
            distribution,
            count,
            noise=self.noise,
            effects=self.effects,
            steps=self.steps,
            threads=self.threads,
        )

    def env(self) -> Any:
        """One gymnasium.Env."""
        return randomize(
            self.target, self.distribution, noise=self.noise, effects=self.effects, steps=self.steps
        )
