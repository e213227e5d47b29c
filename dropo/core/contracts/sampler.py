"""The contract of samplers: a log density in, draws out."""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dropo.core.records.draws import Draws
from dropo.core.records.parameters import ParameterSpace
from dropo.core.services.errors import Incompatible
from dropo.core.services.validation import Array, check_shape, float_array, require

Density = Callable[[Array], Array]
Evaluate = Callable[[Array, Density], Array]


def directly(points: Array, function: Density) -> Array:
    """function(points), recorded nowhere."""
    return function(points)


class Chains(NamedTuple):
    """What a sampler made: chain (S, W, d) in the unit box, its log densities (S, W), and what else
    there is to tell of `Draws`.
    """

    chain: Array
    log_density: Array
    diverging: NDArray[np.bool_] | None = None
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Sampler(ABC):
    """Settings of a sampler. A plug-in writes `_sample`, in the unit box, and `evaluations`.

    needs_gradients: whether it takes only densities that come with their gradient, by a method
    `expand`: points (W, m) -> (values (W,), gradients (W, m)).
    """

    needs_gradients: ClassVar[bool] = False

    def sample(
        self,
        log_density: Density,
        space: ParameterSpace,
        *,
        rng: np.random.Generator,
        evaluate: Evaluate = directly,
        start: ArrayLike | None = None,
        spread: ArrayLike = 0.1,
    ) -> Draws:
        """Draws from the density on the space's box.

        log_density: points (W, d) in the space's own units -> (W,), NaN or -inf where the density
        is 0. It is a density over the unit box, so for a parameter on a log scale one over its
        logarithm: a constant is flat in the logarithm. evaluate(points of the unit box, function)
        -> function(points): where every batch passes, for example `Run.evaluate`.
        start, spread: (d,) middle and width of the first positions, in unit-box coordinates; the
        middle by default.
        """
        caller = f"{type(self).__name__}.sample"
        d = len(space)
        start = float_array("start", np.full(d, 0.5) if start is None else start, (d,), caller)
        require(
            bool((start >= 0).all() and (start <= 1).all()), "start", "inside [0, 1]", start, caller
        )
        spread = float_array("spread", np.broadcast_to(spread, (d,)), (d,), caller)
        require(bool((spread > 0).all()), "spread", "positive", spread, caller)
        made = Chains(
            *self._sample(self._in_unit_box(log_density, space, evaluate), rng, start, spread)
        )
        return Draws(
            space.from_unit(made.chain), made.log_density, space.names, made.diverging, made.notes
        )

    @abstractmethod
    def evaluations(self, dimension: int) -> int:
        """About how many points of d dimensions one run evaluates, for progress."""

    @abstractmethod
    def _sample(
        self, density: Density, rng: np.random.Generator, start: Array, spread: Array
    ) -> Chains | tuple[Array, Array]:
        """Chain (S, W, d) in the unit box and its log densities (S, W); Chains, where there is more
        to tell.

        density: (W, d) -> (W,) log density, -inf outside the unit box and never NaN; where the
        sampler needs gradients, (W, 1 + d): behind the log density its gradient over the unit box,
        0 where the density is 0.
        """

    def _in_unit_box(self, log_density: Any, space: ParameterSpace, evaluate: Evaluate) -> Density:
        caller = f"{type(self).__name__}.sample"
        if self.needs_gradients and not hasattr(log_density, "value_score_information"):
            raise Incompatible(
                f"{type(self).__name__} needs the gradient of the log density, and this "
                "one comes without."
                " Use likelihood 'emulated' or 'linear', or sampler 'emcee'."
            )
        function = (
            _with_gradients(log_density, space, caller)
            if self.needs_gradients
            else _values(log_density, space, caller)
        )
        columns = 1 + len(space) if self.needs_gradients else 1

        def density(points: Array) -> Array:
            points = np.asarray(points, dtype=float)
            out = np.zeros((len(points), columns))
            inside = ((points >= 0) & (points <= 1)).all(axis=1)
            if inside.any():
                out[inside] = evaluate(points[inside], function).reshape(-1, columns)
            out[:, 0] = np.where(inside & ~np.isnan(out[:, 0]), out[:, 0], -np.inf)
            require(
                not np.isposinf(out[:, 0]).any(), "log density", "below infinity", "inf", caller
            )
            out[~np.isfinite(out).all(axis=1), 1:] = 0.0
            return out if self.needs_gradients else out[:, 0]

        return density


def _values(log_density: Density, space: ParameterSpace, caller: str) -> Density:
    def function(points: Array) -> Array:
        values = np.asarray(log_density(space.from_unit(points)), dtype=float)
        check_shape("log density", values, (len(points),), caller)
        return values

    return function


def _with_gradients(log_density: Any, space: ParameterSpace, caller: str) -> Density:
    """(W, 1 + d): the log density and its gradient over the unit box, in one array, so that both
    are recorded.
    """

    def function(points: Array) -> Array:
        at = space.from_unit(points)
        values, gradients = (
            np.asarray(part, dtype=float) for part in log_density.value_score_information(at)
        )
        check_shape("log density", values, (len(points),), caller)
        check_shape("gradient", gradients, points.shape, caller)
        return np.column_stack([values, gradients * _slopes(space, at)])

    return function


def _slopes(space: ParameterSpace, values: Array) -> Array:
    """D value / d unit coordinate of each parameter, at values (..., d)."""
    ratio = space.high / np.where(space.is_log, space.low, 1.0)
    return np.where(
        space.is_log, values * np.log(np.where(space.is_log, ratio, math.e)), space.high - space.low
    )


def first_positions(
    density: Density,
    rng: np.random.Generator,
    start: Array,
    spread: Array,
    walkers: int,
    *,
    attempts: int = 20,
) -> tuple[Array, Array]:
    """Walkers (W, d) around `start`, where the density is positive, and their log densities (W,).

    Normal with standard deviation `spread`, inside the unit box; positions of density 0 are drawn
    again, ever closer to the start.
    """
    points = np.empty((walkers, len(start)))
    values = np.full(walkers, -np.inf)
    for attempt in range(attempts):
        bad = ~np.isfinite(values)
        if not bad.any():
            return points, values
        points[bad] = _reflect(
            start + 0.7**attempt * spread * rng.standard_normal((int(bad.sum()), len(start)))
        )
        values[bad] = density(points[bad])
    require(
        bool(np.isfinite(values).all()),
        "start",
        "where the density is positive",
        start,
        "first_positions",
    )
    return points, values


def _reflect(points: Array) -> Array:
    """Points folded into [0, 1] at its ends."""
    return 1 - np.abs(1 - points % 2)
