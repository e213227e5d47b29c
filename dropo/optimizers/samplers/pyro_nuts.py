"""The No-U-Turn sampler of Pyro."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from dropo.core.contracts.sampler import Chains, Density, Sampler
from dropo.core.services.isolated_torch import isolated_torch
from dropo.core.services.optional_dependencies import need
from dropo.core.services.validation import Array, require
from dropo.optimizers.support.real_line import RealLine


@dataclass(frozen=True)
class PyroNuts(Sampler):
    """The No-U-Turn sampler, with a full mass matrix.

    Divergent steps are counted and reported in the notes of the draws.

    Attributes
    ----------
    draws : int
        Number of draws S that each chain keeps.
    warmup : int
        Number of steps before them, which adapt the step size and the mass matrix.
    chains : int
        Number of chains W.
    target_acceptance : float
        Acceptance probability in (0, 1) that the step size is adapted to. A higher one is slower
        and safer.
    gradients_per_draw : int
        Expected number of gradients for one draw, for the estimate of the cost only.

    Raises
    ------
    MissingPackage
        If torch or Pyro is not installed.
    BadArgument
        If `draws` is below 4, `warmup` or `chains` is below 1, or `target_acceptance` is not
        between 0 and 1.

    References
    ----------
    Hoffman and Gelman (2014), "The No-U-Turn sampler", Journal of Machine Learning Research 15.
    Bingham et al. (2019), "Pyro: deep universal probabilistic programming", Journal of Machine
    Learning Research 20.
    """

    draws: int = 1000
    warmup: int = 500
    chains: int = 4
    target_acceptance: float = 0.8
    needs_gradients: ClassVar[bool] = True
    gradients_per_draw: ClassVar[int] = 8

    def __post_init__(self) -> None:
        need("torch", "pyro", extra="posterior", caller="Sampler pyro-nuts")
        require(self.draws >= 4, "draws", "at least 4", self.draws, "PyroNuts")
        require(self.warmup >= 1, "warmup", "at least 1", self.warmup, "PyroNuts")
        require(self.chains >= 1, "chains", "at least 1", self.chains, "PyroNuts")
        require(
            0 < self.target_acceptance < 1,
            "target_acceptance",
            "between 0 and 1",
            self.target_acceptance,
            "PyroNuts",
        )

    def evaluations(self, dimension: int) -> int:
        """Returns about how many gradients a run evaluates, for any `dimension`."""
        return self.gradients_per_draw * self.chains * (self.warmup + self.draws)

    def _sample(
        self, density: Density, rng: np.random.Generator, start: Array, spread: Array
    ) -> Chains:
        line = RealLine(density, start, spread)
        first = line.head(rng, self.chains)
        seeds = rng.integers(2**63, size=self.chains)
        runs = [self._run_chain(line, w, int(seed)) for w, seed in zip(first, seeds, strict=True)]
        chain = line.unit(np.stack([states for states, _ in runs], axis=1))
        diverging = np.stack([diverged for _, diverged in runs], axis=1)
        values = density(chain.reshape(-1, len(start)))[:, 0].reshape(chain.shape[:2])
        count = int(diverging.sum())
        notes = []
        if count:
            notes.append(
                f"{count} of {diverging.size} steps diverged, so that parts of the "
                "posterior may be missed: raise target_acceptance, or take sampler 'emcee'"
            )
        return Chains(chain, values, diverging, tuple(notes))

    def _run_chain(
        self, line: RealLine, first: Array, seed: int
    ) -> tuple[Array, NDArray[np.bool_]]:
        """Returns states (S, d) on the real line from `first` (d,), and which diverged (S,)."""
        import torch
        from pyro.infer import NUTS

        with isolated_torch(seed):
            kernel = NUTS(
                potential_fn=lambda at: -line.log_density(at["w"]),
                full_mass=True,
                target_accept_prob=self.target_acceptance,
            )
            state = {"w": torch.as_tensor(first, dtype=torch.float64)}
            kernel.initial_params = state
            kernel.setup(self.warmup)
            states = np.empty((self.warmup + self.draws, len(first)))
            for step in range(len(states)):
                state = kernel.sample(state)
                states[step] = state["w"].detach().numpy()
            diverging = np.zeros(self.draws, dtype=bool)
            diverging[kernel.diagnostics()["divergences"]] = True
            kernel.cleanup()
        return states[self.warmup :], diverging
