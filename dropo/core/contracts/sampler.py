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
"""A log density: points (W, d) to values (W,)."""
Evaluate = Callable[[Array, Density], Array]
"""Calls a function at points, and may record its values."""


def directly(points: Array, function: Density) -> Array:
    """Evaluate a function without a record of it.

    Parameters
    ----------
    points : (W, d) array
        Where.
    function : callable
        What to evaluate.

    Returns
    -------
    array
        function(points).
    """
    return function(points)


class Chains(NamedTuple):
    """What a sampler made, in the unit box.

    Attributes
    ----------
    chain : (S, W, d) array
        The states of W walkers over S steps.
    log_density : (S, W) array
        Their log densities.
    diverging : (S, W) array of bool, or None
        The steps at which the sampler's trajectory diverged, where it has such.
    notes : tuple of str
        What speaks against the draws, a sentence each.
    interrupted : bool
        Whether these are the steps until Ctrl-C.
    """

    chain: Array
    log_density: Array
    diverging: NDArray[np.bool_] | None = None
    notes: tuple[str, ...] = ()
    interrupted: bool = False


@dataclass(frozen=True)
class Sampler(ABC):
    """The settings of a sampler.

    A plug-in writes `_sample`, which works in the unit box, and `evaluations`.

    Attributes
    ----------
    needs_gradients : bool
        Whether it takes only densities with a gradient: those with a method
        `value_score_information`, from points (W, d) to values (W,) and gradients (W, d).
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
        """Draw from a density on the box of a space.

        Parameters
        ----------
        log_density : callable
            Points (W, d) in the space's own units to (W,) values, NaN or -inf where the density is
            0. It is a density over the unit box; for a parameter on a log scale that is one over
            its logarithm, so a constant is flat in the logarithm.
        space : ParameterSpace
            The d parameters.
        rng : numpy.random.Generator
            For the walkers.
        evaluate : callable
            evaluate(points of the unit box, function) gives function(points). Every batch passes
            through it, so that it can be recorded, for example by `Run.evaluate`.
        start : (d,) array_like, optional
            Middle of the first positions in the unit box; its middle by default.
        spread : float or (d,) array_like
            Standard deviation of the first positions in the unit box.

        Returns
        -------
        Draws
            In the parameters' own units.

        Raises
        ------
        BadArgument
            If the start is outside the box or where the density is 0, the spread is not positive,
            or the density is infinite or of another shape.
        Incompatible
            If the sampler needs gradients and the density has none.
        """
        caller = f"{type(self).__name__}.sample"
        d = len(space)
        start = float_array("start", np.full(d, 0.5) if start is None else start, (d,), caller)
        inside = bool((start >= 0).all() and (start <= 1).all())
        require(inside, "start", "inside [0, 1]", start, caller)
        spread = float_array("spread", np.broadcast_to(spread, (d,)), (d,), caller)
        require(bool((spread > 0).all()), "spread", "positive", spread, caller)
        density = self._in_unit_box(log_density, space, evaluate)
        made = Chains(*self._sample(density, rng, start, spread))
        values = space.from_unit(made.chain)
        return Draws(
            values,
            made.log_density,
            space.names,
            made.diverging,
            made.notes,
            made.interrupted,
        )

    @abstractmethod
    def evaluations(self, dimension: int) -> int:
        """Say about how many points one run evaluates, for progress.

        Parameters
        ----------
        dimension : int
            Number m of unknowns.

        Returns
        -------
        int
            Evaluations of the log density, of all chains together.
        """

    @abstractmethod
    def _sample(
        self, density: Density, rng: np.random.Generator, start: Array, spread: Array
    ) -> Chains | tuple[Array, Array]:
        """Make the chain (S, W, d) in the unit box and its log densities (S, W), or `Chains`.

        The density takes points (W, d) and gives log densities (W,), -inf outside the unit box and
        never NaN. If the sampler needs gradients it gives (W, 1 + d): the log density, then its
        gradient over the unit box, 0 where the density is 0.
        """

    def _in_unit_box(self, log_density: Any, space: ParameterSpace, evaluate: Evaluate) -> Density:
        """The density as `_sample` takes it, of points of the unit box."""
        caller = f"{type(self).__name__}.sample"
        function = _values(log_density, space, caller)
        columns = 1
        if self.needs_gradients:
            if not hasattr(log_density, "value_score_information"):
                raise Incompatible(
                    f"{type(self).__name__} needs the gradient of the log density, and this one "
                    "comes without. Use likelihood 'emulated' or 'linear', or sampler 'emcee'."
                )
            function = _with_gradients(log_density, space, caller)
            columns = 1 + len(space)

        def density(points: Array) -> Array:
            points = np.asarray(points, dtype=float)
            out = np.zeros((len(points), columns))
            inside = ((points >= 0) & (points <= 1)).all(axis=1)
            if inside.any():
                out[inside] = evaluate(points[inside], function).reshape(-1, columns)
            out[:, 0] = np.where(inside & ~np.isnan(out[:, 0]), out[:, 0], -np.inf)
            infinite = np.isposinf(out[:, 0]).any()
            require(not infinite, "log density", "below infinity", "inf", caller)
            out[~np.isfinite(out).all(axis=1), 1:] = 0.0
            return out if self.needs_gradients else out[:, 0]

        return density


def _values(log_density: Density, space: ParameterSpace, caller: str) -> Density:
    """The log densities (W,) of points (W, d) of the unit box."""

    def function(points: Array) -> Array:
        values = np.asarray(log_density(space.from_unit(points)), dtype=float)
        check_shape("log density", values, (len(points),), caller)
        return values

    return function


def _with_gradients(log_density: Any, space: ParameterSpace, caller: str) -> Density:
    """The log densities and gradients over the unit box in one array (W, 1 + d), to be recorded."""

    def function(points: Array) -> Array:
        at = space.from_unit(points)
        found = log_density.value_score_information(at)
        values, gradients = (np.asarray(part, dtype=float) for part in found)
        check_shape("log density", values, (len(points),), caller)
        check_shape("gradient", gradients, points.shape, caller)
        return np.column_stack([values, gradients * _slopes(space, at)])

    return function


def _slopes(space: ParameterSpace, values: Array) -> Array:
    """Derivative of each parameter by its unit coordinate, at values (..., d)."""
    ratio = space.high / np.where(space.is_log, space.low, 1.0)
    logarithmic = values * np.log(np.where(space.is_log, ratio, math.e))
    return np.where(space.is_log, logarithmic, space.high - space.low)


def first_positions(
    density: Density,
    rng: np.random.Generator,
    start: Array,
    spread: Array,
    walkers: int,
    *,
    attempts: int = 20,
) -> tuple[Array, Array]:
    """Draw the first positions of walkers, where the density is positive.

    They are normal about the start, reflected into the unit box. Positions of density 0 are drawn
    again, ever closer to the start.

    Parameters
    ----------
    density : callable
        Points (W, d) of the unit box to log densities (W,).
    rng : numpy.random.Generator
        For the positions.
    start : (d,) array
        Their middle.
    spread : (d,) array
        Their standard deviation.
    walkers : int
        W, how many.
    attempts : int
        How often they are drawn at most.

    Returns
    -------
    points : (W, d) array
        In the unit box.
    values : (W,) array
        Their log densities.

    Raises
    ------
    BadArgument
        If a walker finds no position of positive density.
    """
    points = np.empty((walkers, len(start)))
    values = np.full(walkers, -np.inf)
    for attempt in range(attempts):
        bad = ~np.isfinite(values)
        if not bad.any():
            return points, values
        normal = rng.standard_normal((int(bad.sum()), len(start)))
        points[bad] = _reflect(start + 0.7**attempt * spread * normal)
        values[bad] = density(points[bad])
    found = bool(np.isfinite(values).all())
    require(found, "start", "where the density is positive", start, "first_positions")
    return points, values


def _reflect(points: Array) -> Array:
    """Points reflected into [0, 1] at its ends."""
    return 1 - np.abs(1 - points % 2)
