"""Stochastic variational inference with Pyro."""

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from dropo.core.contracts.sampler import Chains, Density, Sampler
from dropo.core.services.errors import InvalidInput
from dropo.core.services.isolated_torch import isolated_torch
from dropo.core.services.optional_dependencies import need
from dropo.core.services.validation import Array, require
from dropo.optimizers.support.real_line import RealLine

CHAINS = 4
"""The draws are returned as so many chains, so that diagnostics of chains apply."""


@dataclass(frozen=True)
class PyroSvi(Sampler):
    """An approximation: draws from the Gaussian nearest the posterior on the real line.

    Nearest is meant by Kullback-Leibler divergence. The approximation (the guide, Pyro's
    AutoMultivariateNormal) is exact where the posterior is Gaussian on the real line, and too
    narrow where it is not. The notes of the draws report an ELBO that still rises, and a guide
    whose importance weights leave few draws effective. A mode that the guide never reached is not
    noticed.

    Attributes
    ----------
    draws : int
        Number of draws in all.
    steps : int
        Number of steps of Adam.
    learning_rate : float
        Learning rate of the first step.
    particles : int
        Number of draws of the guide in each step.
    rate_decay : float
        Last learning rate, as a fraction of the first.
    max_rise : float
        Gain of the ELBO over the last steps, in nats, above which a note is written.
    min_effective : float
        Effective fraction of the importance-weighted draws below which a note is written.

    Raises
    ------
    MissingPackage
        If torch or Pyro is not installed.
    BadArgument
        If `draws` is below 16, `steps` below 8 or `particles` below 1, or `learning_rate` is not
        positive.
    Refused
        In `sample`, if the ELBO is infinite.

    References
    ----------
    Kucukelbir et al. (2017), "Automatic differentiation variational inference", Journal of Machine
    Learning Research 18.
    Bingham et al. (2019), "Pyro: deep universal probabilistic programming", Journal of Machine
    Learning Research 20.
    """

    draws: int = 4000
    steps: int = 2000
    learning_rate: float = 0.1
    particles: int = 8
    rate_decay: float = 0.005
    max_rise: float = 0.01
    min_effective: float = 0.1
    needs_gradients: ClassVar[bool] = True

    def __post_init__(self) -> None:
        need("torch", "pyro", extra="posterior", caller="Sampler pyro-svi")
        require(self.draws >= 4 * CHAINS, "draws", f"at least {4 * CHAINS}", self.draws, "PyroSvi")
        require(self.steps >= 8, "steps", "at least 8", self.steps, "PyroSvi")
        require(self.learning_rate > 0, "learning_rate", "positive", self.learning_rate, "PyroSvi")
        require(self.particles >= 1, "particles", "at least 1", self.particles, "PyroSvi")

    def evaluations(self, dimension: int) -> int:
        """Returns the number of gradients and values that a run evaluates, for any `dimension`."""
        return self.steps * self.particles + self.draws

    def _sample(
        self, density: Density, rng: np.random.Generator, start: Array, spread: Array
    ) -> Chains:
        line = RealLine(density, start, spread)
        w, elbo, log_guide, log_target = self._fit(
            line, line.head(rng, 1)[0], int(rng.integers(2**63))
        )
        chain = line.unit(w).reshape(-1, CHAINS, len(start))
        # from the density over the real line back to that over the box
        values = log_target + 0.5 * ((line.origin + line.scale * w) ** 2).sum(axis=1)
        notes = (
            *_rising(elbo, self.max_rise),
            *_too_few(log_target - log_guide, self.min_effective),
        )
        return Chains(chain, values.reshape(-1, CHAINS), None, notes)

    def _fit(self, line: RealLine, first: Array, seed: int) -> tuple[Array, Array, Array, Array]:
        """Fits the guide; returns its draws (K, d), the ELBO (steps,) and two log densities (K,).

        These are the log density of the guide at its draws, and that of the target.
        """
        import pyro
        import torch
        from pyro.infer import SVI, Trace_ELBO

        with isolated_torch(seed), pyro.get_param_store().scope():
            model, guide = _model_and_guide(line, first)
            adam = pyro.optim.ClippedAdam(
                {"lr": self.learning_rate, "lrd": self.rate_decay ** (1 / self.steps)}
            )
            loss = Trace_ELBO(
                num_particles=self.particles, vectorize_particles=True, max_plate_nesting=0
            )
            svi = SVI(model, guide, adam, loss)
            elbo = np.array([-svi.step() for _ in range(self.steps)])
            if not np.isfinite(elbo).all():
                raise InvalidInput(
                    "PyroSvi: the guide reaches where the density is 0, so its ELBO is "
                    "infinite. Use sampler 'pyro-nuts'."
                )
            with torch.no_grad():
                posterior = guide.get_posterior()
                w = posterior.sample((CHAINS * (self.draws // CHAINS),))
                return w.numpy(), elbo, posterior.log_prob(w).numpy(), line.log_density(w).numpy()


def _model_and_guide(line: RealLine, first: Array) -> tuple[Any, Any]:
    """Returns the density as a Pyro model, and its guide: N(`first`, I) at the beginning."""
    import pyro
    import torch
    from pyro import distributions
    from pyro.infer.autoguide import AutoMultivariateNormal, init_to_value

    flat = distributions.ImproperUniform(
        distributions.constraints.real, torch.Size(), torch.Size([len(first)])
    )

    def model() -> None:
        pyro.factor("log density", line.log_density(pyro.sample("w", flat)))

    at = {"w": torch.as_tensor(first, dtype=torch.float64)}
    return model, AutoMultivariateNormal(
        model, init_loc_fn=init_to_value(values=at), init_scale=1.0
    )


def _rising(elbo: Array, max_rise: float) -> list[str]:
    """Returns a note if the ELBO still rises.

    That is if its mean over the last eighth of the steps is above that over the eighth before by
    more than `max_rise` and four standard errors.
    """
    before, last = np.array_split(elbo[-(len(elbo) // 4) :], 2)
    gain = last.mean() - before.mean()
    error = np.hypot(*(part.std() / np.sqrt(len(part)) for part in (before, last)))
    if gain <= max(max_rise, 4 * error):
        return []
    return [f"the ELBO still rises, by {gain:.3g} nat over the last steps: take more steps"]


def _too_few(log_weights: Array, min_effective: float) -> list[str]:
    """Returns a note if importance weights leave too few of the draws effective.

    The effective number is (sum w)^2 / sum w^2 (Owen 2013, "Monte Carlo theory, methods and
    examples", section 9.3).
    """
    w = np.exp(log_weights - log_weights.max())
    fraction = w.sum() ** 2 / (len(w) * (w**2).sum())
    if fraction >= min_effective:
        return []
    note = (
        f"the guide does not fit the posterior: weighted, {fraction:.1%} of its draws are "
        "effective; take sampler 'pyro-nuts'"
    )
    return [note]
