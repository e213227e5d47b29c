"""Likelihoods that draw parameters of a member of the family and simulate each draw."""

import hashlib
from abc import abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike

from dropo.core.contracts.family import Family
from dropo.core.contracts.likelihood import Likelihood, LogLikelihood
from dropo.core.contracts.noise import Epsilon, Noise, NoiseModel
from dropo.core.contracts.simulator import WITHOUT_GRADIENTS, Simulator
from dropo.core.numerics.array_api import constant, namespace, plain, together
from dropo.core.records.parameters import ParameterSpace
from dropo.core.records.trajectories import Segments
from dropo.core.services.errors import BadArgument, Incompatible
from dropo.core.services.validation import Array, check_shape, require


@dataclass(frozen=True)
class SampledLikelihood(Likelihood):
    """A likelihood from K draws of the member and their predictions.

    A plug-in writes `_log_density` alone. The base points of the draws are fixed when the
    likelihood is bound, or belong to phi, so the log-likelihood is a deterministic function of phi.

    Attributes
    ----------
    draws : int
        K, at least 2.
    redraw : bool
        Whether every evaluated phi has independent draws of its own, as in the thesis, whose search
        sees the noise of K draws. By default all share one Sobol set.
    independent : bool
        Whether the density holds for independent samples alone. The base points are then
        independent instead of a Sobol set, and samples can carry noise: a number of its own for
        each draw and row, since a chance covariance that is the same in every row would not
        average out over the rows.

    Raises
    ------
    BadArgument
        If there are fewer than 2 draws.
    """

    draws: int = 100
    redraw: bool = False
    independent: ClassVar[bool] = False

    def __post_init__(self) -> None:
        rule = "at least 2, to have a covariance"
        require(self.draws >= 2, "draws", rule, self.draws, type(self).__name__)

    def log_density(
        self,
        predictions: ArrayLike,
        targets: ArrayLike,
        epsilon: ArrayLike,
        noise: Array | None = None,
    ) -> Array:
        """Evaluate the log density of measured rows, given predictions under K draws.

        Parameters
        ----------
        predictions : (K, R, p) array_like
            What the simulator gives under each draw.
        targets : (R, p) array_like
            What was measured.
        epsilon : (p,) array_like
            Noise variances [signal unit^2].
        noise : (K, R, p) array, optional
            Standard normal numbers that stay fixed, where the density is `independent`.

        Returns
        -------
        (R,) array
            In nats; -inf on rows with a failed prediction, and where no epsilon is 0 also on rows
            without a density (whose K predictions do not span p dimensions). A torch tensor with
            its history if an argument is one.

        Raises
        ------
        BadArgument
            If the predictions have another shape, or if a row has no density and an epsilon is 0.
        """
        caller = f"{type(self).__name__}.log_density"
        samples, measured, variance = together(predictions, targets, epsilon)
        check_shape("predictions", samples, (None, *measured.shape), caller)
        xp = namespace(samples)
        variance = xp.broadcast_to(variance, measured.shape[1:])
        good = xp.all(xp.isfinite(samples), axis=(0, 2))
        out = constant(np.full(len(measured), -np.inf), measured)
        if good.any():
            rows = slice(None) if good.all() else good  # a slice copies nothing
            numbers = None if noise is None else constant(noise, measured)[:, rows]
            # log 0 = -inf and 0 / 0 = NaN are valid results here.
            with np.errstate(divide="ignore", invalid="ignore"):
                out[rows] = self._log_density(samples[:, rows], measured[rows], variance, numbers)
        singular = xp.isnan(out)
        if singular.any() and (variance == 0).any():
            k, _, p = samples.shape
            row = int(np.argmax(plain(singular)))
            raise BadArgument(
                f"The covariance of the K = {k} predictions at row {row} is singular in p = {p} "
                "signals, and an epsilon is 0. Give epsilon > 0 (the variance of the measurement "
                "noise), or more draws."
            )
        density: Array = xp.where(singular, -np.inf, out)
        return density

    @abstractmethod
    def _log_density(
        self, predictions: Array, targets: Array, epsilon: Array, noise: Array | None
    ) -> Array:
        """The log densities (R,) [nats], NaN on rows without a density.

        Predictions (K, R, p), targets (R, p), epsilon (p,) and noise (K, R, p) or None are finite,
        and arrays or tensors.
        """

    def with_degrees(self, degrees: float) -> Self:
        """Make the same likelihood with a Student t in place of the Gaussian, where it has one.

        Parameters
        ----------
        degrees : float
            Degrees of freedom.

        Returns
        -------
        SampledLikelihood

        Raises
        ------
        Incompatible
            If the likelihood has no such form.
        """
        raise Incompatible(
            f"{type(self).__name__} knows no noise with long tails. Leave out degrees = "
            f"{degrees:g}, or use 'monte-carlo'."
        )

    def bind(
        self,
        simulator: Simulator,
        segments: Segments,
        family: Family,
        epsilon: Epsilon,
        rng: np.random.Generator,
    ) -> LogLikelihood:
        """Make the log-likelihood of given segments, with base points from `rng`.

        Raises
        ------
        BadArgument
            If epsilon is not valid.
        Incompatible
            If the likelihood or the simulator knows no noise of this kind.
        """
        degrees = epsilon.degrees if isinstance(epsilon, Noise) else None
        settings = self if degrees is None else self.with_degrees(degrees)
        return _SampledLogLikelihood(settings, simulator, segments, family, epsilon, rng)


class _Numbers(NamedTuple):
    """Random numbers of an evaluation: base points (1 + redraws, K, d) of the draws; standard
    normal ones (K, R, p) that samples carry, and (K, N, s) of the start states, where there are.
    """

    base: Array
    noise: Array | None
    start: Array | None


class _SampledLogLikelihood(LogLikelihood):
    """Draws, predicts, and evaluates the density; with gradients where the simulator has them.

    Where the noise is on the start states too, each draw starts every segment from its own
    perturbed state.
    """

    simulator: Simulator

    def __init__(
        self,
        settings: SampledLikelihood,
        simulator: Simulator,
        segments: Segments,
        family: Family,
        epsilon: Epsilon,
        rng: np.random.Generator,
    ):
        self.settings = settings
        self.simulator = simulator
        self.segments = segments
        self.family = family
        self.has_gradients = simulator.has_gradients
        self.targets = simulator.targets(segments)
        self.noise_model = NoiseModel(epsilon, len(simulator.signals))
        self.unknowns = ParameterSpace((*family.unknowns, *self.noise_model.unknowns))
        self.seed = int(rng.spawn(1)[0].integers(2**63)) if settings.redraw else None
        self.fixed = self._drawn(rng, independent=settings.independent or settings.redraw)

    def _drawn(self, rng: np.random.Generator, *, independent: bool) -> _Numbers:
        """All random numbers of an evaluation."""
        base_rng, noise_rng, start_rng = rng.spawn(3)
        draws = self.settings.draws
        base = self.family.base(draws, base_rng, independent=independent)
        noise = None
        if self.settings.independent:
            noise = noise_rng.standard_normal((draws, *self.targets.shape))
        start = self._draw_start_noise(start_rng) if self.noise_model.noise.start else None
        return _Numbers(base, noise, start)

    def _numbers(self, phi: Array) -> _Numbers:
        """The random numbers of phi (m,): those of all, or its own, whenever it is evaluated."""
        if self.seed is None:
            return self.fixed
        digest = hashlib.sha256(np.ascontiguousarray(plain(phi), dtype=float).tobytes()).digest()
        words = np.frombuffer(digest, dtype=np.uint32).tolist()
        return self._drawn(np.random.default_rng([self.seed, *words]), independent=True)

    def _draw_start_noise(self, rng: np.random.Generator) -> Array:
        """Standard normal numbers (K, N, p)."""
        p = len(self.simulator.signals)
        s = self.simulator.start_size
        if s != p:
            raise Incompatible(
                f"{type(self.simulator).__name__} starts from {s} numbers and gives {p} signals, "
                "so that noise on the start states is not known. Use a simulator that observes "
                "its whole state, or Noise(start=False)."
            )
        return rng.standard_normal((self.settings.draws, len(self.segments), s))

    def _rows(self, phi: Array) -> Array:
        numbers = self._numbers(phi)
        predictions = self._predict(phi, numbers)
        epsilon = self.epsilon(phi)
        return self.settings.log_density(predictions, self.targets, epsilon, numbers.noise)

    def _predict(self, phi: Array, numbers: _Numbers) -> Array:
        """Predictions (K, R, p) under the draws of the member that phi (m,) names."""
        values = self.family.draw(phi[: len(self.family.unknowns)], numbers.base)
        if numbers.start is None:
            return self.simulator.predict(values, self.segments)
        epsilon = self.epsilon(phi)
        offsets = namespace(epsilon).sqrt(epsilon) * constant(numbers.start, epsilon)
        return self.simulator.predict(values, self.segments, offsets=offsets)

    def gradient(self, phi: ArrayLike) -> Array:
        if not self.has_gradients:
            raise Incompatible(
                f"{type(self.simulator).__name__} gives no gradients. {WITHOUT_GRADIENTS}"
            )
        import torch

        leaf = torch.tensor(phi, dtype=torch.float64, requires_grad=True)
        rows: Any = self.rows(leaf)
        return plain(torch.autograd.grad(rows.sum(), leaf)[0])

    def mean(self, phi: Array) -> Array:
        mean: Array = self._predict(phi, self._numbers(phi)).mean(axis=0)
        return mean

    def epsilon(self, phi: Array) -> Array:
        return self.noise_model.epsilon(phi[len(self.family.unknowns) :])
