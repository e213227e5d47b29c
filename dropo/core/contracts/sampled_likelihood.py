"""Likelihoods from draws of the member and their simulations."""

from abc import abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar, Self

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
    """Likelihoods from K draws of the member and their predictions.

    A plug-in writes `_log_density` alone.

    draws: K. The base points are fixed when bound, so the log-likelihood is a deterministic
    function of phi.
    independent: whether the density is sound for independent samples alone. Then the base points
    are independent instead of a Sobol set, and samples can carry noise: a number of its own for
    each draw and row, else its chance covariance would be the same in every row and would not
    average out over them.
    """

    draws: int = 100
    independent: ClassVar[bool] = False

    def __post_init__(self) -> None:
        require(
            self.draws >= 2,
            "draws",
            "at least 2, to have a covariance",
            self.draws,
            type(self).__name__,
        )

    def log_density(
        self,
        predictions: ArrayLike,
        targets: ArrayLike,
        epsilon: ArrayLike,
        noise: Array | None = None,
    ) -> Array:
        """(R,) log density of the targets (R, p), given K predictions (K, R, p); -inf on rows with
        a failed one.

        Where one of the arguments is a torch tensor, so is the density, with its history.
        epsilon: (p,) noise variance; noise: (K, R, p) standard normal numbers, fixed, where the
        density is `independent`. A row without a density (its K predictions do not span p
        dimensions) is refused where an epsilon is 0, else -inf.
        """
        samples, measured, variance = together(predictions, targets, epsilon)
        check_shape(
            "predictions", samples, (None, *measured.shape), f"{type(self).__name__}.log_density"
        )
        xp = namespace(samples)
        variance = xp.broadcast_to(variance, measured.shape[1:])
        good = xp.all(xp.isfinite(samples), axis=(0, 2))
        out = constant(np.full(len(measured), -np.inf), measured)
        if good.any():
            pick = slice(None) if good.all() else good  # a slice copies nothing
            rest = None if noise is None else constant(noise, measured)[:, pick]
            with np.errstate(
                divide="ignore", invalid="ignore"
            ):  # log 0 = -inf and 0 / 0 = NaN are answers here
                out[pick] = self._log_density(samples[:, pick], measured[pick], variance, rest)
        lost = xp.isnan(out)
        if lost.any() and (variance == 0).any():
            (k, _, p), row = samples.shape, int(np.argmax(plain(lost)))
            raise BadArgument(
                f"The covariance of the K = {k} predictions at row {row} is singular in p "
                f"= {p} signals,"
                " and an epsilon is 0. Give epsilon > 0 (the variance of the measurement "
                "noise), or more draws."
            )
        density: Array = xp.where(lost, -np.inf, out)
        return density

    @abstractmethod
    def _log_density(
        self, predictions: Array, targets: Array, epsilon: Array, noise: Array | None
    ) -> Array:
        """(K, R, p), (R, p), (p,), (K, R, p) or None, all finite, arrays or tensors -> (R,) [nats],
        NaN on rows without a density.
        """

    def with_degrees(self, degrees: float) -> Self:
        """The same likelihood with a Student t of so many degrees of freedom in the Gaussian's
        place, where it has one.
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
        degrees = epsilon.degrees if isinstance(epsilon, Noise) else None
        recipe = self if degrees is None else self.with_degrees(degrees)
        return _Sampled(recipe, simulator, segments, family, epsilon, rng)


class _Sampled(LogLikelihood):
    """Draws, predicts, and asks the plug-in for the density; with gradients where the simulator has
    them.

    Where the noise is on the start states too, each draw starts every segment from its own
    perturbed state.
    """

    def __init__(
        self,
        recipe: SampledLikelihood,
        simulator: Simulator,
        segments: Segments,
        family: Family,
        epsilon: Epsilon,
        rng: np.random.Generator,
    ):
        self.recipe = recipe
        self.simulator = simulator
        self.segments = segments
        self.family = family
        self.has_gradients = simulator.has_gradients
        base, noise, start = rng.spawn(3)
        self.base = family.base(recipe.draws, base, independent=recipe.independent)
        self.targets = simulator.targets(segments)
        self.noise = (
            noise.standard_normal((recipe.draws, *self.targets.shape))
            if recipe.independent
            else None
        )
        self.noise_model = NoiseModel(epsilon, len(simulator.signals))
        self.unknowns = ParameterSpace((*family.unknowns, *self.noise_model.unknowns))
        self.start_noise = self._start_noise(start) if self.noise_model.noise.start else None

    def _start_noise(self, rng: np.random.Generator) -> Array:
        """(K, N, p) standard normal numbers, fixed."""
        p = len(self.simulator.signals)
        s = self.simulator.start_size
        if s != p:
            raise Incompatible(
                f"{type(self.simulator).__name__} starts from {s} numbers and gives {p} "
                "signals, so that noise on the start states is"
                " not known. Use a simulator that observes its whole state, or Noise(start=False)."
            )
        return rng.standard_normal((self.recipe.draws, len(self.segments), s))

    def _rows(self, phi: Array) -> Array:
        return self.recipe.log_density(
            self._predictions(phi), self.targets, self.epsilon(phi), self.noise
        )

    def _predictions(self, phi: Array) -> Array:
        values = self.family.draw(phi[: len(self.family.unknowns)], self.base)
        if self.start_noise is None:
            return self.simulator.predict(values, self.segments)
        epsilon = self.epsilon(phi)
        offsets = namespace(epsilon).sqrt(epsilon) * constant(self.start_noise, epsilon)
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
        mean: Array = self._predictions(phi).mean(axis=0)
        return mean

    def epsilon(self, phi: Array) -> Array:
        return self.noise_model.epsilon(phi[len(self.family.unknowns) :])
