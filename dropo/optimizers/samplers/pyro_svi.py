"""Stochastic variational inference with Pyro (Kucukelbir et al. 2017, JMLR 18; Bingham et al. 2019,
JMLR 20).
"""

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from dropo.core.contracts.sampler import Chains, Density, Sampler
from dropo.core.services.errors import InvalidInput
from dropo.core.services.isolated_torch import isolated_torch
from dropo.core.services.optional_dependencies import need
from dropo.core.services.validation import Array, require
from dropo.optimizers.support.real_line import RealLine

ROWS = 4  # the draws come as so many walkers, so that diagnostics of chains apply
SLOWEST = 0.005  # the learning rate falls to this share of itself
RISE = 0.01  # what the ELBO may still gain in the last quarter [nats]
USABLE = 0.1  # the least effective share of importance-weighted draws


@dataclass(frozen=True)
class PyroSvi(Sampler):
    """Approximate: the Gaussian on the real line that is nearest the posterior by Kullback-Leibler
    divergence, and draws from it.

    It is exact where the posterior is Gaussian there, and too narrow where it is not. draws: in
    all; steps: of Adam, with `particles` draws of the guide (AutoMultivariateNormal) each and a
    learning rate that falls from `learning_rate` to a two-hundredth of it. Told are an ELBO that
    still rises, and a guide whose importance weights leave few draws effective; a mode that the
    guide never met is not.
    """

    draws: int = 4000
    steps: int = 2000
    learning_rate: float = 0.1
    particles: int = 8
    needs_gradients: ClassVar[bool] = True

    def __post_init__(self) -> None:
        need("torch", "pyro", extra="posterior", caller="Sampler pyro-svi")
        require(self.draws >= 4 * ROWS, "draws", f"at least {4 * ROWS}", self.draws, "PyroSvi")
        require(self.steps >= 8, "steps", "at least 8", self.steps, "PyroSvi")
        require(self.learning_rate > 0, "learning_rate", "positive", self.learning_rate, "PyroSvi")
        require(self.particles >= 1, "particles", "at least 1", self.particles, "PyroSvi")

    def evaluations(self, dimension: int) -> int:
        return self.steps * self.particles + self.draws

    def _sample(
        self, density: Density, rng: np.random.Generator, start: Array, spread: Array
    ) -> Chains:
        line = RealLine(density, start, spread)
        w, elbo, log_guide, log_target = self._fit(
            line, line.head(rng, 1)[0], int(rng.integers(2**63))
        )
        chain = line.unit(w).reshape(-1, ROWS, len(start))
        values = log_target + 0.5 * ((line.origin + line.scale * w) ** 2).sum(
            axis=1
        )  # over the box again
        return Chains(
            chain,
            values.reshape(-1, ROWS),
            None,
            (*_rising(elbo), *_too_few(log_target - log_guide)),
        )

    def _fit(self, line: RealLine, first: Array, seed: int) -> tuple[Array, Array, Array, Array]:
        """Draws (K, d) of the guide, the ELBO (steps,), and the log densities (K,) of the guide and
        of the target.
        """
        import pyro
        import torch
        from pyro.infer import SVI, Trace_ELBO

        with isolated_torch(seed), pyro.get_param_store().scope():
            model, guide = _model_and_guide(line, first)
            adam = pyro.optim.ClippedAdam(
                {"lr": self.learning_rate, "lrd": SLOWEST ** (1 / self.steps)}
            )
            svi = SVI(
                model,
                guide,
                adam,
                Trace_ELBO(
                    num_particles=self.particles, vectorize_particles=True, max_plate_nesting=0
                ),
            )
            elbo = np.array([-svi.step() for _ in range(self.steps)])
            if not np.isfinite(elbo).all():
                raise InvalidInput(
                    "PyroSvi: the guide reaches where the density is 0, so its ELBO is "
                    "infinite. Use sampler 'pyro-nuts'."
                )
            with torch.no_grad():
                found = guide.get_posterior()
                w = found.sample((ROWS * (self.draws // ROWS),))
                return w.numpy(), elbo, found.log_prob(w).numpy(), line.log_density(w).numpy()


def _model_and_guide(line: RealLine, first: Array) -> tuple[Any, Any]:
    """The density as a Pyro model, and a multivariate normal guide that begins at `first` (d,) with
    unit width.
    """
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


def _rising(elbo: Array) -> list[str]:
    """A sentence, where the ELBO of the last eighth is above that of the one before by more than
    chance and `RISE`.
    """
    before, last = np.array_split(elbo[-(len(elbo) // 4) :], 2)
    gain = last.mean() - before.mean()
    error = np.hypot(*(part.std() / np.sqrt(len(part)) for part in (before, last)))
    return (
        [f"the ELBO still rises, by {gain:.3g} nat over the last steps: take more steps"]
        if gain > max(RISE, 4 * error)
        else []
    )


def _too_few(log_weights: Array) -> list[str]:
    """A sentence, where importance weights leave few of the draws effective, (sum w)^2 / sum w^2
    (Owen 2013, section 9.3).
    """
    w = np.exp(log_weights - log_weights.max())
    share = w.sum() ** 2 / (len(w) * (w**2).sum())
    if share >= USABLE:
        return []
    return [
        (
            f"the guide does not fit the posterior: weighted, {share:.1%} of its draws are "
            "effective; take sampler 'pyro-nuts'"
        )
    ]
