"""The No-U-Turn sampler of Pyro (Hoffman and Gelman 2014, JMLR 15; Bingham et al. 2019, JMLR 20)."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from dropo.core.contracts.sampler import Chains, Density, Sampler
from dropo.core.services.isolated_torch import isolated_torch
from dropo.core.services.optional_dependencies import need
from dropo.core.services.validation import Array, require
from dropo.optimizers.support.real_line import RealLine

LEAPS = 8  # gradients a draw, about


@dataclass(frozen=True)
class PyroNuts(Sampler):
    """chains of so many `draws` each, after `warmup` steps that adapt the step size and a full mass
    matrix.

    target_acceptance: what the step size is adapted to; higher is slower and safer. Divergences are
    counted and told.
    """

    draws: int = 1000
    warmup: int = 500
    chains: int = 4
    target_acceptance: float = 0.8
    needs_gradients: ClassVar[bool] = True

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
        return LEAPS * self.chains * (self.warmup + self.draws)

    def _sample(
        self, density: Density, rng: np.random.Generator, start: Array, spread: Array
    ) -> Chains:
        line = RealLine(density, start, spread)
        first = line.head(rng, self.chains)
        seeds = rng.integers(2**63, size=self.chains)
        runs = [self._chain(line, w, int(seed)) for w, seed in zip(first, seeds, strict=True)]
        chain = line.unit(np.stack([states for states, _ in runs], axis=1))
        diverging = np.stack([diverged for _, diverged in runs], axis=1)
        values = density(chain.reshape(-1, len(start)))[:, 0].reshape(chain.shape[:2])
        count = int(diverging.sum())
        notes = []
        if count:
            notes.append(
                f"{count} of {diverging.size} steps diverged, so that parts of the "
                "posterior may be missed:"
                " raise target_acceptance, or take sampler 'emcee'"
            )
        return Chains(chain, values, diverging, tuple(notes))

    def _chain(self, line: RealLine, first: Array, seed: int) -> tuple[Array, NDArray[np.bool_]]:
        """States (S, d) on the real line from `first` (d,), and which steps diverged (S,)."""
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
