"""Likelihoods from draws of the member and their simulations."""

from abc import abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dropo.core.checks import Array, check_shape, require
from dropo.core.data import Segments
from dropo.core.errors import BadArgument
from dropo.core.family import Family
from dropo.core.likelihood import Likelihood, LogLikelihood
from dropo.core.noise import Epsilon, NoiseModel
from dropo.core.parameters import ParameterSpace
from dropo.core.simulator import Simulator


@dataclass(frozen=True)
class SampledLikelihood(Likelihood):
    """Likelihoods from K draws of the member and their predictions. A plug-in writes `_log_density` alone.

    draws: K. The base points are fixed when bound, so the log-likelihood is a deterministic function of phi.
    independent: whether the density is sound for independent samples alone. Then the base points are independent instead
    of a Sobol set, and samples can carry noise: a number of its own for each draw and row, else its chance covariance
    would be the same in every row and would not average out over them.
    """

    draws: int = 100
    independent: ClassVar[bool] = False

    def __post_init__(self) -> None:
        require(self.draws >= 2, "draws", "at least 2, to have a covariance", self.draws, type(self).__name__)

    def log_density(self, predictions: ArrayLike, targets: ArrayLike, epsilon: ArrayLike, noise: Array | None = None) -> Array:
        """(R,) log density of the targets (R, p), given K predictions (K, R, p); -inf on rows with a failed one.

        epsilon: (p,) noise variance; noise: (K, R, p) standard normal numbers, fixed, where the density is `independent`.
        A row without a density (its K predictions do not span p dimensions) is refused where an epsilon is 0, else -inf.
        """
        predictions, targets = np.asarray(predictions, dtype=float), np.asarray(targets, dtype=float)
        check_shape("predictions", predictions, (None, *targets.shape), f"{type(self).__name__}.log_density")
        variance = np.broadcast_to(np.asarray(epsilon, dtype=float), targets.shape[1:])
        good = np.isfinite(predictions).all(axis=(0, 2))
        out = np.full(len(targets), -np.inf)
        if good.any():
            pick: slice | NDArray[np.bool_] = slice(None) if good.all() else good  # a slice copies nothing
            rest = None if noise is None else noise[:, pick]
            with np.errstate(divide="ignore", invalid="ignore"):  # log 0 = -inf and 0 / 0 = NaN are answers here
                out[pick] = self._log_density(predictions[:, pick], targets[pick], variance, rest)
        lost = np.isnan(out)
        if lost.any() and (variance == 0).any():
            k, _, p = predictions.shape
            raise BadArgument(f"The covariance of the K = {k} predictions at row {int(lost.argmax())} is singular in p = {p} signals,"
                              " and an epsilon is 0. Give epsilon > 0 (the variance of the measurement noise), or more draws.")  # fmt: skip
        out[lost] = -np.inf
        return out

    @abstractmethod
    def _log_density(self, predictions: Array, targets: Array, epsilon: Array, noise: Array | None) -> Array:
        """(K, R, p), (R, p), (p,), (K, R, p) or None, all finite -> (R,) [nats], NaN on rows that have no density."""

    def bind(self, simulator: Simulator, segments: Segments, family: Family, epsilon: Epsilon, rng: np.random.Generator) -> LogLikelihood:
        return _Sampled(self, simulator, segments, family, epsilon, rng)


class _Sampled(LogLikelihood):
    """Draws, predicts, and asks the plug-in for the density."""

    def __init__(
        self, recipe: SampledLikelihood, simulator: Simulator, segments: Segments, family: Family, epsilon: Epsilon,
        rng: np.random.Generator,
    ):  # fmt: skip
        self.recipe, self.simulator, self.segments, self.family = recipe, simulator, segments, family
        base, noise = rng.spawn(2)
        self.base = family.base(recipe.draws, base, independent=recipe.independent)
        self.targets = simulator.targets(segments)
        self.noise = noise.standard_normal((recipe.draws, *self.targets.shape)) if recipe.independent else None
        self.noise_model = NoiseModel(epsilon, len(simulator.signals))
        self.unknowns = ParameterSpace((*family.unknowns, *self.noise_model.unknowns))

    def _rows(self, phi: Array) -> Array:
        return self.recipe.log_density(self._predictions(phi), self.targets, self.epsilon(phi), self.noise)

    def _predictions(self, phi: Array) -> Array:
        values = self.family.draw(phi[: len(self.family.unknowns)], self.base)
        return self.simulator.predict(values, self.segments)

    def mean(self, phi: Array) -> Array:
        mean: Array = self._predictions(phi).mean(axis=0)
        return mean

    def epsilon(self, phi: Array) -> Array:
        return self.noise_model.epsilon(phi[len(self.family.unknowns) :])
