"""A local likelihood around its own maximum, wide enough for the posterior."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from dropo.core.contracts.estimator import Run
from dropo.core.contracts.family import Family
from dropo.core.contracts.local_likelihood import LocalLikelihood, LocalLogLikelihood
from dropo.core.contracts.noise import Noise, NoiseModel
from dropo.core.contracts.problem import Problem
from dropo.core.records.draws import Draws
from dropo.core.records.fit import Fit
from dropo.core.records.parameters import ParameterSpace
from dropo.core.services.validation import Array
from dropo.estimators.dropo import DROPO
from dropo.estimators.support.posterior_targets import Local

REACH = 3.0  # a model is as wide as so many standard errors, and trusted to twice its width
# widths as shares of the box: the least, the largest at first, and at all
NARROWEST = 1e-4
FIRST = 1 / 6
WIDEST = 1 / 4
# more than 1 % of the draws in the last 2.5 % of a trusted interval: the model is too narrow
EDGE = 0.025
FEW = 0.01


@dataclass
class AroundMaximum:
    """Builds the local likelihood, where DROPO finds its maximum; `space` is what the unknowns are
    called in, without spread.
    """

    problem: Problem
    run: Run
    family: Family
    family_name: str
    likelihood: LocalLikelihood
    noise: Noise
    space: ParameterSpace | None = None

    def __post_init__(self) -> None:
        self.box = self.problem.space.high - self.problem.space.low

    def head(self) -> Local:
        """Around the maximum; as wide as the law and `REACH` standard errors of its means, by the
        Fisher information.
        """
        found = self._maximum()
        self.centre, self.best = (
            found.mean,
            np.concatenate([found.phi, self._factors(found.epsilon)]),
        )
        self.width = self._limited(np.maximum(2 * found.sd, REACH * np.nan_to_num(found.mean_se)))
        self.width = self._limited(
            np.maximum(2 * found.sd, REACH * self._errors(self._build().bound))
        )
        return self._build()

    def wider(self, draws: Draws, edges: list[str]) -> Local:
        """Around the draws' means, twice as wide in the parameters whose draws met an edge."""
        flat = draws.flat()
        names = self.problem.space.names
        self.best = flat[int(draws.log_density.argmax())]
        means = flat[
            :, [draws.names.index(name if self.space else f"mean.{name}") for name in names]
        ]
        met = np.array(
            [
                any(edge in (name, f"mean.{name}", f"scale.{name}") for edge in edges)
                for name in names
            ]
        )
        self.centre, self.width = (
            means.mean(axis=0),
            np.minimum(np.where(met, 2, 1) * self.width, WIDEST * self.box),
        )
        return self._build()

    def edges(self, draws: Draws, target: Local) -> list[str]:
        """The unknowns of which more than `FEW` draws lie at an end of where the model is trusted,
        that is not the search's own.
        """
        own = self.family.unknowns
        trusted = target.unknowns
        share = (draws.flat() - trusted.low) / (trusted.high - trusted.low)
        out = []
        for i, p in enumerate(own):
            low = (share[:, i] < EDGE).mean() if trusted.low[i] > p.low else 0.0
            high = (share[:, i] > 1 - EDGE).mean() if trusted.high[i] < p.high else 0.0
            out += [trusted.names[i]] if low + high > FEW else []
        return out

    def _maximum(self) -> Fit:
        noise = self.noise
        count = len(self.problem.simulator.signals)
        epsilon: Any = (
            "learn" if noise.learned else tuple(np.broadcast_to(noise.variance, count).tolist())
        )
        settings = DROPO(
            likelihood=self.likelihood,
            family=self.family_name,
            epsilon=epsilon,
            start_noise=noise.start,
            degrees=noise.degrees,
        )
        return settings._fit(self.problem, self.run)

    def _build(self) -> Local:
        with self.run.counting(evaluations=1):
            bound = self.likelihood.linearize_at(
                self.problem.simulator,
                self.problem.segments,
                self.family,
                self.noise,
                self.centre,
                self.width,
                self.run.rng.spawn(1)[0],
            )
        local = Local(bound, self.best)
        if self.space:
            local.rename(self.space)
        return local

    def _errors(self, bound: LocalLogLikelihood) -> Array:
        """(d,) standard errors of the means, with a flat prior's information on the box added."""
        d = len(self.box)
        information = bound.value_score_information(
            np.clip(self.best, bound.unknowns.low, bound.unknowns.high)
        )[2][:d, :d]
        return np.sqrt(np.abs(np.diagonal(np.linalg.inv(information + np.diag(12 / self.box**2)))))

    def _limited(self, width: Array) -> Array:
        return np.clip(width, NARROWEST * self.box, FIRST * self.box)

    def _factors(self, epsilon: Array) -> Array:
        """The likelihood's own unknowns at the noise variances that were found (p,)."""
        model = NoiseModel(self.noise, len(epsilon))
        unknowns = ParameterSpace(model.unknowns)
        factors = epsilon / model.shape
        own = (
            factors
            if len(unknowns) == len(factors)
            else np.full(len(unknowns), np.exp(np.log(factors).mean()))
        )
        return np.clip(own, unknowns.low, unknowns.high)


def unit_spread(target: Local) -> Array:
    """(m,) widths in the unit box by the Fisher information at the best point, each with the other
    unknowns held fixed.
    """
    space = target.unknowns
    best = target.best
    with np.errstate(divide="ignore"):
        error = 1 / np.sqrt(np.diagonal(target.bound.value_score_information(best)[2]))
    above, below = (
        space.to_unit(np.clip(best + sign * error, space.low, space.high)) for sign in (1, -1)
    )
    return np.clip((above - below) / 2, 1e-9, 0.1)
