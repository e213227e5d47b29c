"""What a policy is trained on: a target with a distribution of its parameters."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from numpy.typing import ArrayLike

from dropo.core.contracts.effect import ActiveEffects
from dropo.training.batched_env import BatchedEnv
from dropo.training.distributions import ParameterDistribution, full_width
from dropo.training.environments import Target, batched_env, randomize

Progress = Callable[[float, str], None]
"""Called with the fraction of the training that is done, and a text about it."""


@dataclass(frozen=True, eq=False)
class TrainingSetup:
    """Everything that decides which environments a policy is trained in.

    Attributes
    ----------
    target : Target
        A problem with a task, or the id of a Gymnasium MuJoCo environment.
    distribution : ParameterDistribution or None
        Distribution of the parameters; None for the model as it is.
    noise : float or (p,) array, optional
        Variances of the measurement noise; by default those that a fit learned.
    effects : sequence of (EffectInstance, array)
        Effects that a Gymnasium environment's robot has beside its model.
    steps : int, optional
        Steps of an episode, by default the target's.
    threads : int
        Number of threads, 0 for all cores.
    """

    target: Target
    distribution: ParameterDistribution | None
    noise: ArrayLike | None = None
    effects: ActiveEffects = ()
    steps: int | None = None
    threads: int = 1

    def batched_env(self, count: int, *, at_full_width: bool = False) -> BatchedEnv:
        """Make environments that are simulated together.

        Parameters
        ----------
        count : int
            Number of environments.
        at_full_width : bool
            Whether a curriculum is replaced by the distribution that it grows to.

        Returns
        -------
        BatchedEnv
            The environments.

        Raises
        ------
        Refused
            As for `dropo.training.environments.batched_env`.
        """
        distribution = self.distribution
        if at_full_width and distribution is not None:
            distribution = full_width(distribution)
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
        """Make an environment of Gymnasium's kind.

        Returns
        -------
        gymnasium.Env
            One environment.
        """
        return randomize(
            self.target, self.distribution, noise=self.noise, effects=self.effects, steps=self.steps
        )
