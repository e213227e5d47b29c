"""The affine-invariant ensemble sampler emcee (Foreman-Mackey et al. 2013, arXiv:1202.3665)."""

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from dropo.core.contracts.sampler import Density, Sampler, first_positions
from dropo.core.services.validation import Array, known, require


@dataclass(frozen=True)
class Emcee(Sampler):
    """walkers: how many, by default 4 d and at least 32; steps: those kept, of each walker, after
    `burn_in` others.

    moves: "differential", differential evolution with snooker steps (ter Braak and Vrugt 2008), a
    third of the autocorrelation time on Gaussians of 2 to 8 dimensions; or "stretch" (Goodman and
    Weare 2010).
    """

    walkers: int | None = None
    steps: int = 2000
    burn_in: int = 1000
    moves: Literal["stretch", "differential"] = "differential"

    def __post_init__(self) -> None:
        require(
            self.walkers is None or self.walkers >= 4,
            "walkers",
            "at least 4",
            self.walkers,
            "Emcee",
        )
        require(self.steps >= 4, "steps", "at least 4", self.steps, "Emcee")
        require(self.burn_in >= 0, "burn_in", "0 or more", self.burn_in, "Emcee")
        known("moves", self.moves, ("stretch", "differential"))

    def evaluations(self, dimension: int) -> int:
        return self._count(dimension) * (1 + self.burn_in + self.steps)

    def _count(self, dimension: int) -> int:
        return self.walkers or max(32, 4 * dimension)

    def _sample(
        self, density: Density, rng: np.random.Generator, start: Array, spread: Array
    ) -> tuple[Array, Array]:
        import emcee

        d = len(start)
        walkers = self._count(d)
        require(
            walkers >= 2 * d,
            "walkers",
            f"at least {2 * d}, twice the {d} parameters",
            walkers,
            "Emcee",
        )
        points, values = first_positions(density, rng, start, spread, walkers)
        seed = np.random.RandomState(
            rng.integers(2**32, size=8, dtype=np.uint32)
        ).get_state()  # emcee takes no newer generator
        sampler = emcee.EnsembleSampler(
            walkers, d, density, moves=_moves(self.moves), vectorize=True
        )
        sampler.run_mcmc(
            emcee.State(points, log_prob=values, random_state=seed), self.burn_in + self.steps
        )
        return sampler.get_chain(discard=self.burn_in), sampler.get_log_prob(discard=self.burn_in)


def _moves(name: str) -> list[tuple[Any, float]]:
    from emcee import moves

    return (
        [(moves.StretchMove(), 1.0)]
        if name == "stretch"
        else [(moves.DEMove(), 0.8), (moves.DESnookerMove(), 0.2)]
    )  # emcee's advice
