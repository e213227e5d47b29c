"""The contract of samplers: a log density in, draws out; and what draws say about themselves."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import ndtri
from scipy.stats import rankdata

from dropo.core.checks import Array, check_shape, float_array, require
from dropo.core.errors import DropoError
from dropo.core.parameters import ParameterSpace
from dropo.core.table import number, text_table

Density = Callable[[Array], Array]
Evaluate = Callable[[Array, Density], Array]


def directly(points: Array, function: Density) -> Array:
    """function(points), recorded nowhere."""
    return function(points)


class ChainTooShort(DropoError, RuntimeError):
    """The chain is too short to tell its own autocorrelation time; `estimate` (d,) is what it says so far, too low as a rule."""

    def __init__(self, message: str, estimate: Array):
        super().__init__(message)
        self.estimate = estimate


@dataclass(frozen=True)
class Draws:
    """The states of W walkers over S steps.

    chain: (S, W, d) in the parameters' own units; log_density: (S, W), up to a constant; names: of the d parameters.
    """

    chain: Array
    log_density: Array
    names: tuple[str, ...]

    def __post_init__(self) -> None:
        chain = float_array("chain", self.chain, (None, None, len(self.names)), "Draws")
        require(chain.shape[0] >= 4 and chain.shape[1] >= 1, "chain", "of 4 steps and 1 walker, or more", chain.shape, "Draws")
        object.__setattr__(self, "chain", chain)
        object.__setattr__(self, "log_density", float_array("log_density", self.log_density, chain.shape[:2], "Draws"))

    def flat(self, discard: int = 0, thin: int = 1) -> Array:
        """(K, d) the draws of all walkers, step by step; without the first so many steps, every so manyth of the others."""
        require(0 <= discard < len(self.chain), "discard", f"in 0 ... {len(self.chain) - 1}", discard, "Draws.flat")
        require(thin >= 1, "thin", "at least 1", thin, "Draws.flat")
        flat: Array = self.chain[discard::thin].reshape(-1, len(self.names))
        return flat

    def autocorrelation_time(self, *, least: float = 50.0) -> Array:
        """(d,) integrated autocorrelation time of a walker [steps] (Goodman and Weare 2010), with Sokal's window.

        least: the shortest chain to trust, in autocorrelation times (emcee's rule); 0 takes any.
        """
        times = np.array([_integrated_time(self.chain[:, :, i]) for i in range(len(self.names))])
        if len(self.chain) < least * times.max():
            worst = self.names[int(times.argmax())]
            raise ChainTooShort(
                f"{len(self.chain)} steps are fewer than {least:g} autocorrelation times of {worst!r} (about {times.max():.3g} steps each)."
                f" Take at least {int(np.ceil(least * times.max()))} steps.", times,
            )  # fmt: skip
        return times

    def effective_sample_size(self) -> Array:
        """(d,) how many independent draws tell the mean as well: S W / autocorrelation time."""
        return np.asarray(self.log_density.size / self.autocorrelation_time(least=0))

    def split_r_hat(self) -> Array:
        """(d,) rank-normalised split R-hat, the larger of bulk and folded (Vehtari et al. 2021, section 4); 1 where converged."""
        half = len(self.chain) // 2
        halves = np.concatenate([self.chain[:half], self.chain[-half:]], axis=1)  # (half, 2 W, d)
        folded = np.abs(halves - np.median(halves, axis=(0, 1)))
        return np.array([max(_r_hat(_normal_scores(x[:, :, i])) for x in (halves, folded)) for i in range(len(self.names))])

    def summary(self) -> str:
        """A table: mean, standard deviation, quantiles and the diagnostics of each parameter."""
        flat, times, ess, r_hat = self.flat(), self.autocorrelation_time(least=0), self.effective_sample_size(), self.split_r_hat()
        columns = [flat.mean(axis=0), flat.std(axis=0), *np.quantile(flat, [0.05, 0.5, 0.95], axis=0), times, ess, r_hat]
        rows = [[name, *(number(column[i]) for column in columns)] for i, name in enumerate(self.names)]
        return text_table(["parameter", "mean", "sd", "5 %", "median", "95 %", "autocorr.", "ESS", "R-hat"], rows)


def _integrated_time(x: Array, window: float = 5.0) -> float:
    """1 + 2 sum_t rho_t of walkers (S, W), cut at the first t >= window * itself (Sokal 1989).

    Walkers are compared with the mean of all, so that walkers which do not mix give a long time.
    """
    steps = len(x)
    spectrum = np.fft.rfft(x - x.mean(), n=2 * steps, axis=0)
    covariance = np.fft.irfft(np.abs(spectrum) ** 2, axis=0)[:steps].mean(axis=1) / steps  # (S,)
    if covariance[0] <= 0:
        return float(steps)  # nothing ever moved
    times = 2 * np.cumsum(covariance / covariance[0]) - 1
    enough = np.arange(steps) >= window * times
    return max(1.0, float(times[int(enough.argmax()) if enough.any() else -1]))


def _normal_scores(x: Array) -> Array:
    """Normal scores of the ranks (Vehtari et al. 2021, eq. 14)."""
    ranks = rankdata(x).reshape(x.shape)
    return np.asarray(ndtri((ranks - 3 / 8) / (x.size + 1 / 4)))


def _r_hat(x: Array) -> float:
    """sqrt(var+ / W) of chains (S, M) (Gelman et al. 2013, eq. 11.4)."""
    within = x.var(axis=0, ddof=1).mean()
    between = x.mean(axis=0).var(ddof=1)
    return float(np.sqrt((len(x) - 1) / len(x) + between / within)) if within > 0 else np.inf


@dataclass(frozen=True)
class Sampler(ABC):
    """Settings of a sampler. A plug-in writes `_sample`, in the unit box, and `evaluations`."""

    def sample(
        self, log_density: Density, space: ParameterSpace, *, rng: np.random.Generator, evaluate: Evaluate = directly,
        start: ArrayLike | None = None, spread: ArrayLike = 0.1,
    ) -> Draws:  # fmt: skip
        """Draws from the density on the space's box.

        log_density: points (W, d) in the space's own units -> (W,), NaN or -inf where the density is 0. It is a density over
        the unit box, so for a parameter on a log scale one over its logarithm: a constant is flat in the logarithm.
        evaluate(points of the unit box, function) -> function(points): where every batch passes, for example `Run.evaluate`.
        start, spread: (d,) middle and width of the first positions, in unit-box coordinates; the middle by default.
        """
        caller, d = f"{type(self).__name__}.sample", len(space)
        start = float_array("start", np.full(d, 0.5) if start is None else start, (d,), caller)
        require(bool((start >= 0).all() and (start <= 1).all()), "start", "inside [0, 1]", start, caller)
        spread = float_array("spread", np.broadcast_to(spread, (d,)), (d,), caller)
        require(bool((spread > 0).all()), "spread", "positive", spread, caller)
        chain, values = self._sample(_in_unit_box(log_density, space, evaluate, caller), rng, start, spread)
        return Draws(space.from_unit(chain), values, space.names)

    @abstractmethod
    def evaluations(self, dimension: int) -> int:
        """About how many points of d dimensions one run evaluates, for progress."""

    @abstractmethod
    def _sample(self, density: Density, rng: np.random.Generator, start: Array, spread: Array) -> tuple[Array, Array]:
        """Chain (S, W, d) in the unit box and its log densities (S, W).

        density: (W, d) -> (W,) log density, -inf outside the unit box and never NaN.
        """


def _in_unit_box(log_density: Density, space: ParameterSpace, evaluate: Evaluate, caller: str) -> Density:
    def function(points: Array) -> Array:
        values = np.asarray(log_density(space.from_unit(points)), dtype=float)
        check_shape("log density", values, (len(points),), caller)
        return values

    def density(points: Array) -> Array:
        points = np.asarray(points, dtype=float)
        out = np.full(len(points), -np.inf)
        inside = ((points >= 0) & (points <= 1)).all(axis=1)
        if inside.any():
            out[inside] = evaluate(points[inside], function)
        require(not np.isposinf(out).any(), "log density", "below infinity", "inf", caller)
        return np.where(np.isnan(out), -np.inf, out)

    return density


def first_positions(
    density: Density, rng: np.random.Generator, start: Array, spread: Array, walkers: int, *, attempts: int = 20
) -> tuple[Array, Array]:
    """Walkers (W, d) around `start`, where the density is positive, and their log densities (W,).

    Normal with standard deviation `spread`, inside the unit box; positions of density 0 are drawn again, ever closer to
    the start.
    """
    points, values = np.empty((walkers, len(start))), np.full(walkers, -np.inf)
    for attempt in range(attempts):
        bad = ~np.isfinite(values)
        if not bad.any():
            return points, values
        points[bad] = _reflect(start + 0.7**attempt * spread * rng.standard_normal((int(bad.sum()), len(start))))
        values[bad] = density(points[bad])
    require(bool(np.isfinite(values).all()), "start", "where the density is positive", start, "first_positions")
    return points, values


def _reflect(points: Array) -> Array:
    """Points folded into [0, 1] at its ends."""
    return 1 - np.abs(1 - points % 2)
