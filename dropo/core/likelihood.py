"""The contract of likelihoods: the log density of measured segments under a member of a family."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dropo.core.checks import Array, check_shape, float_array, require
from dropo.core.data import Segments
from dropo.core.errors import BadArgument, Incompatible
from dropo.core.family import Family
from dropo.core.parameters import Parameter, ParameterSpace
from dropo.core.simulator import Simulator


@dataclass(frozen=True, eq=False)
class Learned:
    """Epsilon to be found: a factor in [1e-8, 1e4] on the given noise variances (p,), one for all signals, or each its own."""

    shape: Array
    each: bool = False


Epsilon = float | Array | Learned


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
        """The log-likelihood of the segments. epsilon: noise variance, one or (p,) [signal unit^2], or Learned."""


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


class NoiseModel:
    """epsilon as given, or its factor as an unknown of the likelihood's own."""

    def __init__(self, epsilon: Epsilon, signals: int):
        given = epsilon.shape if isinstance(epsilon, Learned) else epsilon
        array = np.asarray(given, dtype=float)
        require(array.shape in ((), (signals,)), "epsilon", f"one number, or one for each of {signals} signals", array.shape, "Likelihood")
        require(bool(np.isfinite(array).all() and (array >= 0).all()), "epsilon", "a finite variance, not negative", given, "Likelihood")
        self.shape = np.broadcast_to(array, (signals,)).astype(float)
        own = [f"epsilon[{i}]" for i in range(signals)] if isinstance(epsilon, Learned) and epsilon.each else ["epsilon"]
        self.unknowns = tuple(Parameter(name, 1e-8, 1e4, scale="log") for name in own) if isinstance(epsilon, Learned) else ()

    def positive(self, caller: str) -> "NoiseModel":
        """Itself, where no epsilon is 0: a local model's own error must not pass for the noise."""
        if (self.shape <= 0).any():
            raise BadArgument(
                f"The epsilon of {caller} must be positive for every signal: without noise its covariance is singular."
                " Give epsilon > 0 (the variance of the measurement noise), or 'learn'."
            )
        return self

    def epsilon(self, own: Array) -> Array:
        """(p,) from the likelihood's own unknowns, (p,), (1,) or (0,)."""
        return self.shape * own if self.unknowns else self.shape

    def slopes(self) -> Array:
        """d epsilon / d own unknown (n, p)."""
        n = len(self.unknowns)
        return np.diag(self.shape) if n == len(self.shape) else np.repeat(self.shape[None], n, axis=0)


class LocalLogLikelihood(LogLikelihood):
    """Sound near where it was built alone; `unknowns` are bounded by that region."""

    @abstractmethod
    def expand(self, phi: Array) -> tuple[float, Array, Array]:
        """The value, the scores of the rows (R, m), or of the groups where they share draws, and the Fisher information (m, m)."""

    @abstractmethod
    def predict(self, values: Array) -> Array:
        """What the local model has in the simulator's place: (K, d) -> (K, R, p)."""


class LocalLikelihood(Likelihood):
    """A likelihood from a local model of the simulator: an estimator builds it again where it finds the maximum."""

    @abstractmethod
    def around(
        self, simulator: Simulator, segments: Segments, family: Family, epsilon: Epsilon, centre: Array, width: Array,
        rng: np.random.Generator, *, rough: bool = False,
    ) -> LocalLogLikelihood:  # fmt: skip
        """The log-likelihood of members with means near centre (d,) and scales up to about width (d,); cheaper where `rough`."""

    def bind(
        self, simulator: Simulator, segments: Segments, family: Family, epsilon: Epsilon, rng: np.random.Generator
    ) -> LocalLogLikelihood:
        space = simulator.space
        return self.around(simulator, segments, family, epsilon, (space.low + space.high) / 2, (space.high - space.low) / 6, rng)
