"""What a policy is trained on: a target with a law of its parameters."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from numpy.typing import ArrayLike

from dropo.simulators.mujoco.worker import Present
from dropo.training.batched_env import Arena
from dropo.training.distributions import Law, full
from dropo.training.environments import Target, arena, randomize

Progress = Callable[[float, str], None]
"""progress(share, text), as the command line draws it."""


@dataclass(frozen=True, eq=False)
class Stage:
    """Everything that decides what a policy meets in training; as for `randomize`."""

    target: Target
    law: Law | None
    noise: ArrayLike | None = None
    effects: Present = ()
    steps: int | None = None
    threads: int = 1

    def arena(self, count: int, *, whole: bool = False) -> Arena:
        """So many environments side by side; whole: under the law at its full width."""
        law = full(self.law) if whole else self.law
        return arena(self.target, law, count, noise=self.noise, effects=self.effects, steps=self.steps, threads=self.threads)

    def env(self) -> Any:
        """One gymnasium.Env."""
        return randomize(self.target, self.law, noise=self.noise, effects=self.effects, steps=self.steps)
