"""The affine-invariant ensemble sampler emcee."""

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from dropo.core.contracts.sampler import Chains, Density, Sampler, first_positions
from dropo.core.services.validation import Array, known, require

FEWEST = 8
"""Steps before which an interrupted run has no draws: half of them are dropped at the least."""


@dataclass(frozen=True)
class Emcee(Sampler):
    """The affine-invariant ensemble sampler emcee.

    Attributes
    ----------
    walkers : int, optional
        Number of walkers W, by default 4 d and at least 32. At least twice the d parameters are
        needed.
    steps : int
        Number of steps S that each walker keeps.
    burn_in : int
        Number of steps before them, which are dropped.
    moves : {"differential", "stretch"}
        "differential" is differential evolution with snooker steps, whose autocorrelation time on
        Gaussians of 2 to 8 dimensions is a third of that of "stretch".

    Raises
    ------
    BadArgument
        If `walkers` or `steps` is below 4 or `burn_in` is negative; in `sample`, if there are fewer
        than 2 d walkers.
    UnknownName
        If there are no such `moves`.

    References
    ----------
    Foreman-Mackey, Hogg, Lang and Goodman (2013), "emcee: the MCMC hammer", arXiv:1202.3665.
    Ter Braak and Vrugt (2008), "Differential evolution Markov chain with snooker updater and fewer
    chains", Statistics and Computing 18.
    Goodman and Weare (2010), "Ensemble samplers with affine invariance", Communications in Applied
    Mathematics and Computational Science 5.
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
        """Returns the number of density evaluations in so many dimensions (`dimension`)."""
        return self._walkers(dimension) * (1 + self.burn_in + self.steps)

    def _walkers(self, dimension: int) -> int:
        """Returns the number of walkers in so many dimensions."""
        return self.walkers or max(32, 4 * dimension)

    def _sample(
        self, density: Density, rng: np.random.Generator, start: Array, spread: Array
    ) -> Chains:
        import emcee

        d = len(start)
        walkers = self._walkers(d)
        require(
            walkers >= 2 * d,
            "walkers",
            f"at least {2 * d}, twice the {d} parameters",
            walkers,
            "Emcee",
        )
        points, values = first_positions(density, rng, start, spread, walkers)
        # emcee takes only NumPy's older generator
        seed = rng.integers(2**32, size=8, dtype=np.uint32)
        random_state = np.random.RandomState(seed).get_state()
        first = emcee.State(points, log_prob=values, random_state=random_state)
        sampler = emcee.EnsembleSampler(
            walkers, d, density, moves=_moves(self.moves), vectorize=True
        )
        # emcee's own wrapper prints whatever is raised, Ctrl-C too, before it raises it
        sampler.log_prob_fn = density
        discard = self.burn_in
        interrupted = False
        try:
            sampler.run_mcmc(first, self.burn_in + self.steps)
        except KeyboardInterrupt:
            if sampler.iteration < FEWEST:
                raise
            discard = min(discard, sampler.iteration // 2)
            interrupted = True
        chain = sampler.get_chain(discard=discard)
        values = sampler.get_log_prob(discard=discard)
        return Chains(chain, values, interrupted=interrupted)


def _moves(name: str) -> list[tuple[Any, float]]:
    """Returns emcee's moves with their probabilities, as its documentation advises."""
    from emcee import moves

    if name == "stretch":
        return [(moves.StretchMove(), 1.0)]
    return [(moves.DEMove(), 0.8), (moves.DESnookerMove(), 0.2)]
