"""The contract of likelihoods: the log density of measured segments under a member of a family."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from dropo.core.checks import Array, float_array, require
from dropo.core.data import Segments
from dropo.core.errors import Incompatible
from dropo.core.family import Family
from dropo.core.parameters import Parameter, ParameterSpace
from dropo.core.simulator import Simulator

Epsilon = float | Array | Literal["learn"]


class LogLikelihood(ABC):
    """The log-likelihood of phi (m,) = the family's unknowns, then the likelihood's own: sums the R compared rows."""

    unknowns: ParameterSpace
    has_gradients = False

    def __call__(self, phi: ArrayLike) -> float:
        """log L(phi) = sum of the rows [nats] (thesis, eq. 5.6); -inf where a simulation failed."""
        rows = self.rows(phi)
        return float(rows.sum()) if np.isfinite(rows).all() else -np.inf

    def rows(self, phi: ArrayLike) -> Array:
        """(R,) log density of each compared row [nats]; -inf where one of its simulations failed."""
        return self._rows(float_array("phi", phi, (len(self.unknowns),), type(self).__name__))

    def gradient(self, phi: ArrayLike) -> Array:
        """(m,) d log L / d phi, where `has_gradients`."""
        raise Incompatible(f"{type(self).__name__} gives no gradients. Use an optimizer without, such as 'cma-es' or 'nlopt-sbplx'.")

    @abstractmethod
    def _rows(self, phi: Array) -> Array:
        """(m,) -> (R,)."""

    @abstractmethod
    def epsilon(self, phi: Array) -> Array:
        """(p,) the noise variance of each signal."""

    @abstractmethod
    def mean(self, phi: Array) -> Array:
        """(R, p) the mean prediction under phi, for the mean squared error."""


class Likelihood(ABC):
    """Settings of a likelihood; `bind` makes it a function of phi for given data."""

    @abstractmethod
    def bind(self, simulator: Simulator, segments: Segments, family: Family, epsilon: Epsilon, rng: np.random.Generator) -> LogLikelihood:
        """The log-likelihood of the segments. epsilon: noise variance, one or (p,) [signal unit^2], or "learn"."""


@dataclass(frozen=True)
class SampledLikelihood(Likelihood):
    """Likelihoods from K draws of the member and their predictions. A plug-in writes `_log_density` alone.

    draws: K. The base points are fixed when bound, so the log-likelihood is a deterministic function of phi.
    """

    draws: int = 100

    def __post_init__(self) -> None:
        require(self.draws >= 2, "draws", "at least 2, to have a covariance", self.draws, type(self).__name__)

    def log_density(self, predictions: ArrayLike, targets: ArrayLike, epsilon: ArrayLike, noise: Array) -> Array:
        """(R,) log density of the targets (R, p), given K predictions (K, R, p); -inf on rows with a failed one.

        epsilon: (p,) noise variance; noise: (K, p) standard normal numbers, fixed, for densities that need samples with noise.
        """
        predictions, targets = np.asarray(predictions, dtype=float), np.asarray(targets, dtype=float)
        good = np.isfinite(predictions).all(axis=(0, 2))
        out = np.full(len(targets), -np.inf)
        if good.any():
            out[good] = self._log_density(predictions[:, good], targets[good], np.asarray(epsilon, dtype=float), noise)
        return out

    @abstractmethod
    def _log_density(self, predictions: Array, targets: Array, epsilon: Array, noise: Array) -> Array:
        """(K, R, p), (R, p), (p,), (K, p), all finite -> (R,) [nats]."""

    def bind(self, simulator: Simulator, segments: Segments, family: Family, epsilon: Epsilon, rng: np.random.Generator) -> LogLikelihood:
        return _Sampled(self, simulator, segments, family, epsilon, rng)


class _Sampled(LogLikelihood):
    """Draws, predicts, and asks the plug-in for the density."""

    def __init__(self, recipe: SampledLikelihood, simulator: Simulator, segments: Segments, family: Family, epsilon: Epsilon, rng: np.random.Generator):
        self.recipe, self.simulator, self.segments, self.family = recipe, simulator, segments, family
        base, noise = rng.spawn(2)
        self.base = family.base(recipe.draws, base)
        self.noise = noise.standard_normal((recipe.draws, len(simulator.signals)))
        self.targets = simulator.targets(segments)
        self.noise_model = NoiseModel(epsilon, len(simulator.signals))
        self.unknowns = ParameterSpace((*family.unknowns, *self.noise_model.unknowns))

    def _rows(self, phi: Array) -> Array:
        return self.recipe.log_density(self._predictions(phi), self.targets, self.epsilon(phi), self.noise)

    def _predictions(self, phi: Array) -> Array:
        values = self.family.draw(phi[: len(self.family.unknowns)], self.base)
        return self.simulator.predict(values, self.segments)

    def mean(self, phi: Array) -> Array:
        return self._predictions(phi).mean(axis=0)

    def epsilon(self, phi: Array) -> Array:
        return self.noise_model.epsilon(phi[len(self.family.unknowns) :])


class NoiseModel:
    """epsilon as given, or learned: one number in [1e-14, 1], in the square of the signals' units, as an unknown."""

    def __init__(self, epsilon: Epsilon, signals: int):
        self.learned = isinstance(epsilon, str)
        if self.learned:
            require(epsilon == "learn", "epsilon", "a variance, one for each signal, or 'learn'", epsilon, "Likelihood")
            self.unknowns: tuple[Parameter, ...] = (Parameter("epsilon", 1e-14, 1.0, scale="log"),)
            self.shape = np.ones(signals)
            return
        array = np.asarray(epsilon, dtype=float)
        require(array.shape in ((), (signals,)), "epsilon", f"one number, or one for each of the {signals} signals", array.shape, "Likelihood")
        require(bool(np.isfinite(array).all() and (array >= 0).all()), "epsilon", "a finite variance, not negative", epsilon, "Likelihood")
        self.unknowns = ()
        self.shape = np.broadcast_to(array, (signals,)).astype(float)

    def epsilon(self, own: Array) -> Array:
        """(p,) from the likelihood's own unknowns, (1,) or (0,)."""
        return self.shape * own[0] if self.learned else self.shape
