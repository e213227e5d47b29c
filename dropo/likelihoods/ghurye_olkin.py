"""An unbiased estimate of a Gaussian density from few simulations."""

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from dropo.core.contracts.family import Family
from dropo.core.contracts.likelihood import LogLikelihood
from dropo.core.contracts.noise import Epsilon
from dropo.core.contracts.sampled_likelihood import SampledLikelihood
from dropo.core.contracts.simulator import Simulator
from dropo.core.numerics.array_api import namespace
from dropo.core.records.trajectories import Segments
from dropo.core.services.validation import Array, require
from dropo.likelihoods.support.sample_moments import (
    cholesky_rows,
    log_determinant,
    sample_moments,
    square_distance,
)


@dataclass(frozen=True)
class GhuryeOlkin(SampledLikelihood):
    """The unbiased estimator of a normal density from K > p + 3 independent samples of each row.

    Its mean over samples is N(y; mean, covariance) exactly if predictions are normal; the density
    is unbiased, its logarithm is not. epsilon enters as noise added to the predictions, so that the
    samples carry it.

    A row with q >= 1 is -inf: a target some sqrt(K) standard deviations away has no density, so
    start a search where the spread covers the data, or take more draws.

    Notes
    -----
    With n = K, M = (n - 1) Cov and q = (y - m)' M^-1 (y - m) / (1 - 1/n), the estimate is
    Gamma((n-1)/2) / Gamma((n-p-1)/2) (pi (1 - 1/n))^(-p/2) |M|^(-1/2) max(0, 1 - q)^((n-p-3)/2),
    the ratio of constants in its source [1]_ put together, with |M - u u'| = |M| (1 - u' M^-1 u).

    References
    ----------
    .. [1] Ghurye, Olkin, "Unbiased estimation of some multivariate probability densities", Annals
       of Mathematical Statistics 40 (1969).
    .. [2] Price, Drovandi, Lee, Nott, "Bayesian synthetic likelihood", Journal of Computational and
       Graphical Statistics 27 (2018).
    """

    independent: ClassVar[bool] = True

    def bind(
        self,
        simulator: Simulator,
        segments: Segments,
        family: Family,
        epsilon: Epsilon,
        rng: np.random.Generator,
    ) -> LogLikelihood:
        """Return the log-likelihood of the segments; BadArgument with too few draws."""
        _require_draws(self.draws, len(simulator.signals))
        return super().bind(simulator, segments, family, epsilon, rng)

    def _log_density(
        self, predictions: Array, targets: Array, epsilon: Array, noise: Array | None
    ) -> Array:
        xp = namespace(predictions)
        n, _, p = predictions.shape
        _require_draws(n, p)
        if (epsilon > 0).any():
            caller = "GhuryeOlkin.log_density"
            require(noise is not None, "noise", "given where epsilon is not 0", None, caller)
            predictions = predictions + xp.sqrt(epsilon) * noise
        mean, covariance = sample_moments(predictions)
        factor = cholesky_rows((n - 1) * covariance)  # of M
        q = square_distance(factor, targets - mean) / (1 - 1 / n)
        constant = (
            math.lgamma((n - 1) / 2)
            - math.lgamma((n - p - 1) / 2)
            - 0.5 * p * math.log(math.pi * (1 - 1 / n))
        )
        log_distance = xp.log(xp.where(q < 1, 1 - q, 0.0))
        density: Array = constant - 0.5 * log_determinant(factor) + 0.5 * (n - p - 3) * log_distance
        return density


def _require_draws(draws: int, signals: int) -> None:
    """Raise BadArgument if there are too few draws for so many signals."""
    rule = f"above p + 3 = {signals + 3}, for p = {signals} signals"
    require(draws > signals + 3, "draws", rule, draws, "GhuryeOlkin")
